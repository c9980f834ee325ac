"""Loads ECU classes by name, and creates an ECU on its buses."""

import importlib
import importlib.util
import sys
import traceback
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from bench.bus.codec import Codec
from bench.bus.link.base import Link
from bench.bus.network import EcuSlot
from bench.ecu.base import Ecu
from bench.ecu.runtime import EcuNode
from bench.errors import BadInput
from bench.faults.plan import FaultPlan
from bench.scenario import Scenario

DEFAULT_ECUS: Mapping[str, str] = {
    "planner": "bench.ecu.planner:PlannerEcu",
    "tracker": "bench.ecu.tracker:TrackerEcu",
}
"""The ECUs of a vehicle: role and class, in the syntax of `load_class`."""


def load_class(spec: str) -> Any:
    """Return an ECU's class.

    Args:
        spec: `package.module:Class`, or `path/to/file.py:Class`.

    Raises:
        BadInput: no such module, file or class, the module cannot be loaded, or the class is not an ECU.
    """
    place, _, name = spec.rpartition(":")
    if not (place and name):
        raise BadInput(f"ECU {spec!r}: write package.module:Class or path/to/file.py:Class")
    try:
        module = _load_file(Path(place)) if place.endswith(".py") else importlib.import_module(place)
    except (Exception, SystemExit) as error:
        where = traceback.extract_tb(error.__traceback__)[-1]
        raise BadInput(
            f"ECU {spec!r} cannot be loaded: {type(error).__name__}: {error} ({where.filename}, line {where.lineno})"
        ) from error
    found = getattr(module, name, None)
    if not isinstance(found, type):
        raise BadInput(f"ECU {spec!r}: {place} has no class {name}")
    if not callable(getattr(found, "step", None)):
        raise BadInput(f"ECU {spec!r}: the class {name} is not an ECU: it has no method step; see bench.ecu.base.Ecu")
    if missing := sorted(getattr(found, "__abstractmethods__", ())):
        raise BadInput(f"ECU {spec!r}: the class {name} lacks the method {', '.join(missing)}")
    return found


def load_classes(specs: Iterable[str]) -> None:
    """Load ECU classes and call their `warm_up`, so that the first step is not slow.

    Raises:
        BadInput: see `load_class`.
    """
    for spec in specs:
        warm_up = getattr(load_class(spec), "warm_up", None)
        if warm_up is not None:
            warm_up()


def _load_file(path: Path) -> Any:
    name = f"ecu {path.resolve()}"
    if name in sys.modules:
        return sys.modules[name]
    spec = importlib.util.spec_from_file_location(name, path)
    if spec is None or spec.loader is None or not path.is_file():
        raise FileNotFoundError(f"no file {path}")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    return module


def make_node(
    spec: str,
    slot: EcuSlot,
    scenario: Scenario,
    links: Mapping[str, Link],
    codecs: Mapping[str, Codec],
    plan: FaultPlan,
) -> tuple[EcuNode, Ecu]:
    """Create an ECU of the class `spec` in its slot and connect it to its links.

    Raises:
        BadInput: the class cannot be loaded, or has inputs that are not on its buses.
    """
    ecu: Ecu = load_class(spec)(slot.vehicle, scenario)
    return EcuNode(slot.name, ecu, links, codecs, slot.sends(codecs), plan), ecu
