"""The base class of all kinds of faults, with the hooks that the bench calls.

A kind is one class in one of this package's files. It overrides the hooks for its effects; the inherited hooks have
none. A fault is frozen; the caller keeps its state between frames in the `memory` passed to each hook. All random
numbers come from `FrameContext.dice`, which depends only on the scenario's seed, the fault and the frame: so all
processes of a bench draw the same.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from random import Random
from typing import Annotated, Any, NamedTuple, Protocol

from pydantic import BaseModel, Field

from bench.faults.profile import STRICT

BusName = Annotated[str, Field(pattern=r"^(v2v|veh[1-9][0-9]?)$")]
EcuName = Annotated[str, Field(pattern=r"^veh[1-9][0-9]?\.(planner|tracker)$")]
NodeName = Annotated[str, Field(pattern=r"^veh[1-9][0-9]?\.(planner|tracker|plant)$")]
VehicleNumber = Annotated[int, Field(ge=1, le=16)]
Probability = Annotated[float, Field(gt=0, le=1)]

Memory = dict[str, Any]
"""State of a fault for one message or one vehicle; empty when the fault begins."""

Problem = tuple[tuple[str, ...], str]
"""Path of a fault's key, and the problem with its value."""


class Bench(Protocol):
    """The bench against which a fault's target is checked."""

    @property
    def vehicles(self) -> int:
        """Number of vehicles."""

    @property
    def buses(self) -> Sequence[str]:
        """Names of all buses."""

    def senders(self, bus: str) -> Mapping[str, str]:
        """Return the process that sends each message on a bus, by message name; without the conductor's messages."""

    def signals(self, bus: str, message: str) -> Sequence[str]:
        """Return the names of a message's signals, without CRC and counter."""

    def has_counter(self, bus: str, message: str) -> bool:
        """Return whether a message carries an alive counter."""


@dataclass(frozen=True, slots=True)
class FrameContext:
    """The frame to which a fault applies.

    Attributes:
        bus: the bus it is sent to.
        can_id: its identifier.
        cycle: the cycle it is sent in.
        first: the cycle in which the fault began.
        dice: returns a new random generator, always with the same numbers for this fault and frame.
    """

    bus: str
    can_id: int
    cycle: int
    first: int
    dice: Callable[[], Random]


class Passage(NamedTuple):
    """How a frame is sent.

    Attributes:
        late: delay in cycles; None if it is not sent, or only after a later one.
        behind: frames sent directly after it.
    """

    late: int | None = 0
    behind: tuple[bytes, ...] = ()


ON_TIME = Passage()
LOST = Passage(late=None)


class Condition(IntEnum):
    """State of an ECU's process; if several faults demand one, the greatest holds."""

    RUNNING = 0
    STOPPED = 1
    DEAD = 2


class Outage(NamedTuple):
    """An ECU whose process is not running, and its condition."""

    ecu: str
    condition: Condition


class Fault(BaseModel):
    """Base class of all faults.

    Attributes:
        at_s: simulated time at which it begins (s); active from the cycle that begins then.
        for_s: duration (s); until the end of the run if not given.
    """

    model_config = STRICT

    at_s: Annotated[float, Field(ge=0, le=300)]
    for_s: Annotated[float, Field(gt=0, le=300)] | None = None

    @classmethod
    def name(cls) -> str:
        """Return the name of the kind."""
        return str(cls.model_fields["kind"].default)

    def parameters(self) -> dict[str, Any]:
        """Return its parameters, without kind and time."""
        return self.model_dump(exclude_none=True, exclude={"kind", "at_s", "for_s"})

    def problems(self, bench: Bench) -> list[Problem]:
        """Return the problems of its target on a bench; empty if there are none."""
        return []

    def hits(self, bus: str, message: str) -> bool:
        """Return whether it applies to the frames of this message."""
        return False

    def on_values(self, values: dict[str, float], frame: FrameContext, memory: Memory) -> None:
        """Change the values of a message to be sent, by signal; CRC and counter will be valid."""

    def counter(self, frame: FrameContext) -> int | None:
        """Return the cycle whose alive counter the frame carries, with a valid CRC; None to keep its own."""
        return None

    def on_bytes(self, data: bytes, frame: FrameContext) -> bytes:
        """Return the frame's bytes, changed after the CRC was computed."""
        return data

    def passage(self, data: bytes, frame: FrameContext, memory: Memory) -> Passage:
        """Return how the frame is sent."""
        return ON_TIME

    def extra(self, frame: FrameContext) -> int:
        """Return the number of frames of the message sent in the cycle in addition to the due one, after it."""
        return 0

    def cuts(self, node: str, bus: str) -> bool:
        """Return whether the node is cut off from a bus, neither sending nor receiving."""
        return False

    def identifiers(self, node: str) -> tuple[tuple[str, int], ...]:
        """Return bus and identifier of the additional frames that it makes the node send."""
        return ()

    def payloads(self, dice: Random) -> list[bytes]:
        """Return the data of the additional frames that a node sends in a cycle with one of `identifiers`."""
        return []

    def starved(self, bus: str, can_ids: Sequence[int], room: int) -> frozenset[int]:
        """Return the identifiers that do not fit on a bus in a cycle with room for `room` frames of maximum length."""
        return frozenset()

    @property
    def outage(self) -> Outage | None:
        """Its effect on an ECU's process; None if it has none."""
        return None

    def on_actuators(self, vehicle: int, before: Mapping[str, float], memory: Memory) -> dict[str, float]:
        """Return the values that actuators of a vehicle apply regardless of commands.

        Args:
            vehicle: its number.
            before: values applied in the cycle before: `steering_angle` in rad, `torque_fl` ... in N m.
            memory: state of the fault for this vehicle.
        """
        return {}

    def on_vehicle(self, vehicle: int) -> dict[str, float]:
        """Return the FMU inputs of a vehicle that it sets, by name."""
        return {}


class Window:
    """The cycles in which a fault is active: `first` up to, excluding, `end`; None if it never ends."""

    __slots__ = ("end", "first")

    def __init__(self, fault: Fault, cycle_s: float) -> None:
        """Return the cycles of `cycle_s` s in which `fault` is active, at least one."""
        self.first = round(fault.at_s / cycle_s)
        self.end = None if fault.for_s is None else max(self.first + 1, round((fault.at_s + fault.for_s) / cycle_s))

    def __contains__(self, cycle: int) -> bool:
        """Whether the fault is active in a cycle."""
        return self.first <= cycle and (self.end is None or cycle < self.end)


def no_vehicle(number: int | None, bench: Bench) -> list[Problem]:
    """Return the problem of a key `vehicle` whose vehicle does not exist."""
    if number is None or number <= bench.vehicles:
        return []
    return [(("vehicle",), f"= {number} does not exist; allowed: 1 to {bench.vehicles}")]


def no_node(key: str, name: str, bench: Bench) -> list[Problem]:
    """Return the problem of a `key` that names a node of a vehicle that does not exist."""
    if name.partition(".")[0] in bench.buses:
        return []
    return [((key,), f"= {name} does not exist; allowed: veh1 to veh{bench.vehicles}")]
