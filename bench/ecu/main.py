"""Runs one ECU in this process: as a child of a bench, or alone on any host that the buses reach."""

import sys
from contextlib import ExitStack

from bench.bus.codec import load_codecs
from bench.bus.control_channel import ControlChannel
from bench.bus.link.address import Address
from bench.bus.link.opening import open_link
from bench.bus.network import EcuSlot
from bench.bus.node import read_up, serve
from bench.ecu.alone import await_bench
from bench.ecu.loading import load_classes, make_node
from bench.errors import BadInput
from bench.faults.plan import FaultPlan
from bench.scenario import Scenario

SILENCE_S = 10.0
"""Wall-clock time in s without any frame after which an ECU that runs alone gives up."""


def serve_ecu(
    channel: ControlChannel | None,
    spec: str,
    slot: EcuSlot,
    scenario: Scenario,
    address: Address,
) -> None:
    """Run one ECU in this process until the conductor stops it or exits.

    Args:
        channel: to the conductor that started this process; None if the ECU runs alone: it then waits for the first
            frame without a time limit, and later gives up after `SILENCE_S` without one.
        spec: the ECU's class, see `bench.ecu.loading.load_class`.
        slot: its ECU slot.
        scenario: the scenario of the run.
        address: where the buses are.

    Raises:
        BadInput: no such vehicle, bus or class.
        RunFailed: nothing was heard for `SILENCE_S`, or a bus went down.
    """
    vehicles = len(scenario.vehicles)
    if not 1 <= slot.vehicle <= vehicles:
        raise BadInput(f"--vehicle {slot.vehicle}: the scenario {scenario.name} has vehicles 1 to {vehicles}")
    codecs = load_codecs(vehicles)
    with ExitStack() as stack:
        links = {bus: stack.enter_context(open_link(bus, address)) for bus in slot.buses}
        plan = FaultPlan(scenario.faults, scenario.seed, channel.fault_board() if channel else None)
        note = channel.note if channel else None
        node, ecu = make_node(spec, slot, scenario, links, codecs, plan, note)
        if channel is None:
            there = ", ".join(f"{bus} at {address.place_of(bus)}" for bus in links)
            sys.stderr.write(f"{node.name} listens on {there}\n")
            sys.stderr.flush()
            await_bench(node, slot, links, codecs)
            serve([node], silence_s=SILENCE_S)
        else:
            # Once more in this process: memory shared with the fork server is copied when it is first written to.
            load_classes([spec])
            read_up([node])
            channel.ready(node.name, ecu.inputs)
            serve([node], channel.lifeline)
