"""Runs one ECU in this process: as a child of a bench, or alone on any host that the buses reach."""

import importlib
import importlib.util
import sys
import traceback
from collections.abc import Iterable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from bench.bus.codec import Codec, load_codecs
from bench.bus.link.address import Address
from bench.bus.link.base import Link
from bench.bus.link.opening import open_link
from bench.bus.node import serve
from bench.bus.ties import Ties
from bench.bus.topic import V2V, Topic, vehicle_bus
from bench.ecu.alone import await_bench
from bench.ecu.base import Ecu
from bench.ecu.runtime import EcuNode
from bench.errors import BadInput
from bench.faults.plan import FaultPlan
from bench.scenario import Scenario

DEFAULT_ECUS: Mapping[str, str] = {
    "planner": "bench.ecu.planner:PlannerEcu",
    "tracker": "bench.ecu.tracker:TrackerEcu",
}
"""The ECUs of a vehicle: role and class, as `load_class` takes it."""

SILENCE_S = 10.0
"""Wall-clock time in s without any frame after which an ECU that runs alone gives up."""


def ecu_name(role: str, vehicle: int) -> str:
    """Name of an ECU, as in messages to a person: `veh1.planner`."""
    return f"{vehicle_bus(vehicle)}.{role}"


def buses_of(role: str, vehicle: int) -> tuple[str, ...]:
    """The buses an ECU is on: its vehicle's, and for the planner the radio too."""
    return (vehicle_bus(vehicle), V2V) if role == "planner" else (vehicle_bus(vehicle),)


def load_class(spec: str) -> Any:
    """Return an ECU's class.

    Args:
        spec: `package.module:Class`, or `path/to/file.py:Class`.

    Raises:
        BadInput: there is no such module, file or class, the module cannot be loaded, or the class is no ECU.
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
        raise BadInput(f"ECU {spec!r}: the class {name} is no ECU, it has no method step; see bench.ecu.base.Ecu")
    if missing := sorted(getattr(found, "__abstractmethods__", ())):
        raise BadInput(f"ECU {spec!r}: the class {name} lacks the method {', '.join(missing)}")
    return found


def load_classes(specs: Iterable[str]) -> None:
    """Load ECUs' classes and let them compile or load what takes time, so that no first step has to.

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
    role: str,
    vehicle: int,
    scenario: Scenario,
    links: Mapping[str, Link],
    codecs: Mapping[str, Codec],
    plan: FaultPlan,
) -> tuple[EcuNode, Ecu]:
    """Make an ECU and put it on its links.

    Raises:
        BadInput: the class cannot be loaded, or takes what is not on its buses.
    """
    ecu: Ecu = load_class(spec)(vehicle, scenario)
    return EcuNode(ecu_name(role, vehicle), ecu, links, codecs, sends_of(role, vehicle, codecs), plan), ecu


def sends_of(role: str, vehicle: int, codecs: Mapping[str, Codec]) -> list[Topic]:
    """What the DBC has an ECU of this role send: on its vehicle's bus, and the planner on v2v for its vehicle."""
    senders = {bus: f"Vehicle{vehicle}" if bus == V2V else role.capitalize() for bus in buses_of(role, vehicle)}
    return [
        Topic(bus, name)
        for bus, sender in senders.items()
        for name in codecs[bus].names
        if codecs[bus].message(name).senders[:1] == [sender]
    ]


def serve_ecu(
    ties: Ties | None,
    spec: str,
    role: str,
    vehicle: int,
    scenario: Scenario,
    address: Address,
) -> None:
    """Run one ECU in this process until the conductor stops it or is gone.

    Args:
        ties: to the conductor that started this process; None where the ECU runs alone, then it waits for the first
            frame as long as it takes, and gives up after `SILENCE_S` without one.
        spec: the ECU's class, see `load_class`.
        role: planner or tracker.
        vehicle: number of its vehicle, from 1.
        scenario: the scenario of the run.
        address: where the buses are.

    Raises:
        BadInput: no such vehicle, bus or class.
        RunFailed: nothing was heard for `SILENCE_S`, or a bus went down.
    """
    vehicles = len(scenario.vehicles)
    if not 1 <= vehicle <= vehicles:
        raise BadInput(f"--vehicle {vehicle}: the scenario {scenario.name} has vehicles 1 to {vehicles}")
    codecs = load_codecs(vehicles)
    with ExitStack() as stack:
        links = {bus: stack.enter_context(open_link(bus, address)) for bus in buses_of(role, vehicle)}
        plan = FaultPlan(scenario.faults, scenario.seed, ties.fault_board() if ties else None)
        node, ecu = make_node(spec, role, vehicle, scenario, links, codecs, plan)
        if ties is None:
            there = ", ".join(f"{bus} at {address.place_of(bus)}" for bus in links)
            sys.stderr.write(f"{node.name} listens on {there}\n")
            sys.stderr.flush()
            await_bench(node, role, vehicle, links, codecs)
            serve([node], silence_s=SILENCE_S)
        else:
            # Once more in this process: memory shared with the nursery is copied when it is first written to.
            load_classes([spec])
            ties.ready(node.name, ecu.inputs)
            serve([node], ties.lifeline)
