"""Loads ECU classes by name, and creates an ECU on its buses."""

import importlib
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

from bench.bus.codec import Codec
from bench.bus.link.base import Link
from bench.bus.network import EcuSlot
from bench.ecu.base import Ecu
from bench.ecu.checks import check_class, created
from bench.ecu.own_folder import load_file, shadowed
from bench.ecu.runtime import EcuNode
from bench.ecu.sent_values import Note
from bench.ecu.user_code import described
from bench.errors import BadInput
from bench.faults.plan import FaultPlan
from bench.scenario import Scenario
from bench.scenario.errors import closest

DEFAULT_ECUS: Mapping[str, str] = {
    "planner": "bench.ecu.planner:PlannerEcu",
    "tracker": "bench.ecu.tracker:TrackerEcu",
}
"""The ECUs of a vehicle: role and class, in the syntax of `load_class`."""


def load_class(spec: str, role: str | None = None) -> Any:
    """Return an ECU's class.

    Args:
        spec: `package.module:Class`, or `path/to/file.py:Class`. The file may import what is beside it, see
            `bench.ecu.own_folder`.
        role: what it is to be used as; None to accept any.

    Raises:
        BadInput: no such module, file or class, the module cannot be loaded, or the class is not an ECU of this role.
    """
    place, _, name = spec.rpartition(":")
    if not (place and name):
        raise BadInput(f"ECU {spec!r}: write package.module:Class or path/to/file.py:Class{_classes_hint(spec)}")
    module = _module(spec, place)
    found = getattr(module, name, None)
    if not isinstance(found, type):
        near = closest(name, _ecu_classes(module))
        meant = f"; did you mean {near}?" if near else ""
        known = ", ".join(_ecu_classes(module))
        raise BadInput(f"ECU {spec!r}: {place} has no class {name}{meant}{f' Its ECUs: {known}' if known else ''}")
    check_class(found, spec, role)
    return found


def load_classes(specs: Iterable[str]) -> None:
    """Load ECU classes and call their `warm_up`, so that the first step is not slow.

    Raises:
        BadInput: see `load_class`; or `warm_up` fails.
    """
    for spec in specs:
        warm_up = getattr(load_class(spec), "warm_up", None)
        if warm_up is None:
            continue
        try:
            warm_up()
        except (Exception, SystemExit) as error:
            raise BadInput(f"ECU {spec!r}: its warm_up failed: {described(error)}") from error


def _module(spec: str, place: str) -> ModuleType:
    is_file = place.endswith(".py")
    try:
        return load_file(Path(place)) if is_file else importlib.import_module(place)
    except (Exception, SystemExit) as error:
        hint = _import_hint(error, Path(place)) if is_file else _file_hint(place, spec)
        raise BadInput(f"ECU {spec!r} cannot be loaded: {described(error)}{hint}") from error


def _import_hint(error: BaseException, file: Path) -> str:
    """Explain an import that did not find a module beside the ECU file, or found another one than that."""
    if not isinstance(error, (ImportError, AttributeError)):
        return ""
    name = (getattr(error, "name_from", None) and error.name) or getattr(error, "name", None) or ""
    unused = shadowed(str(name).partition(".")[0], file) if isinstance(error, ImportError) and name else None
    if unused is not None:
        return f"\n{unused} is not used, as another module has that name; rename it"
    if not isinstance(error, ModuleNotFoundError) or not file.parent.is_dir():
        return ""
    modules = [path.stem for path in file.parent.glob("*.py")]
    near = closest(str(name), modules)
    return f"\ndid you mean {near}, beside {file.name}?" if near else ""


def _file_hint(place: str, spec: str) -> str:
    """Explain a module that does not exist where a file of that name does."""
    file = Path(*place.split(".")).with_suffix(".py")
    return f"; for the file write {file}:{spec.rpartition(':')[2]}" if file.is_file() else ""


def _classes_hint(spec: str) -> str:
    """Name the ECUs of a file that was given without a class."""
    file = Path(spec.rstrip(":"))
    if file.suffix != ".py" or not file.is_file():
        return ""
    known = _ecu_classes(_module(spec, str(file)))
    return f"; {file} has the ECUs {', '.join(known)}" if known else f"; {file} has no ECU"


def _ecu_classes(module: ModuleType) -> list[str]:
    """Return the names of the ECU classes that a module defines."""
    return [
        name
        for name, each in vars(module).items()
        if isinstance(each, type) and each.__module__ == module.__name__ and callable(getattr(each, "step", None))
    ]


def make_node(
    spec: str,
    slot: EcuSlot,
    scenario: Scenario,
    links: Mapping[str, Link],
    codecs: Mapping[str, Codec],
    plan: FaultPlan,
    note: Note | None = None,
) -> tuple[EcuNode, Ecu]:
    """Create an ECU of the class `spec` in its slot and connect it to its links; `note` as of `EcuNode`.

    Raises:
        BadInput: the class cannot be loaded or created, or has inputs that are not on its buses.
    """
    ecu = created(load_class(spec, slot.role), spec, slot, scenario, codecs)
    return EcuNode(slot.name, ecu, links, codecs, slot.sends(codecs), plan, note=note), ecu
