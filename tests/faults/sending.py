"""What a tracker's outbox sends with faults at work, cycle by cycle."""

from random import Random

from bench.bus.codec import load_codecs
from bench.bus.link.address import Address
from bench.bus.link.opening import open_link
from bench.bus.outbox import Outbox
from bench.faults.base import Fault, FrameContext
from bench.faults.plan import FaultPlan

CODECS = load_codecs(2)
CODEC = CODECS["veh1"]
CYCLES = 30
START = 10
"""Cycle in which the faults begin."""

Sent = dict[int, list[tuple[str, dict[str, float], bytes]]]


def sent(*faults: Fault, node: str = "veh1.tracker", lockstep: bool = True, seed: int = 1) -> Sent:
    """Send a steering angle that grows with each cycle, and torques; return message, signals and data by cycle."""
    address = Address.parse("direct")
    far, near = open_link("veh1", address), open_link("veh1", address)
    outbox = Outbox(node, {"veh1": near}, CODECS, FaultPlan(faults, seed))
    came: Sent = {}
    for cycle in range(CYCLES):
        outbox.put("veh1", "SteeringCommand", {"SteeringAngle": cycle / 1000, "CommandState": 1})
        outbox.put("veh1", "TorqueCommandFront", {"TorqueFL": 1.0, "TorqueFR": 2.0})
        outbox.send(cycle, lockstep=lockstep)
        came[cycle] = []
        for can_id, data in far.receive():
            known = can_id in CODEC.can_ids
            name, values = CODEC.decode(can_id, data) if known else (f"0x{can_id:03X}", {})
            came[cycle].append((name, values, data))
    return came


def names(came: Sent, cycle: int) -> list[str]:
    return [name for name, _, _ in came[cycle]]


def angles(came: Sent, cycle: int) -> list[int]:
    """Cycle numbers that the steering angles of a cycle's frames tell."""
    return [round(1000 * values["SteeringAngle"]) for name, values, _ in came[cycle] if name == "SteeringCommand"]


def absences(came: Sent, cycle: int) -> list[int]:
    return [int(values["Identifier"]) for name, values, _ in came[cycle] if name == "BenchAbsent"]


def on(**changes: object) -> dict[str, object]:
    return {"at_s": START / 100, "bus": "veh1", "message": "SteeringCommand"} | changes


class Loaded(Random):
    """Dice that give the same number whenever they are thrown."""

    def __init__(self, number: float) -> None:
        super().__init__()
        self._number = number

    def random(self) -> float:
        return self._number


def frame(number: float, cycle: int = START) -> FrameContext:
    """A frame whose dice give this number."""
    return FrameContext(bus="veh1", can_id=0x300, cycle=cycle, first=START, dice=lambda: Loaded(number))
