"""What every kind of fault has, and what it can do: the hooks through which the bench asks it.

A kind is one class in one of this package's files. It overrides the hooks of what it does and inherits that nothing
happens for all others. A fault is frozen; what it has to remember from frame to frame is kept by whoever asks it, in
the `memory` that comes with each question. Whatever is random is drawn from `FrameContext.dice`, which depends on
nothing but the scenario's seed, the fault and the frame: so every process of a bench finds the same.
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
"""What a fault remembers of one message or one vehicle; empty when it begins."""

Problem = tuple[tuple[str, ...], str]
"""Path of a key of a fault, and what is wrong with its value."""


class Bench(Protocol):
    """What a fault's target is checked against."""

    @property
    def vehicles(self) -> int:
        """How many vehicles there are."""

    @property
    def buses(self) -> Sequence[str]:
        """Names of all buses."""

    def senders(self, bus: str) -> Mapping[str, str]:
        """Return which process sends each message on a bus, by the message's name, without the conductor's."""

    def signals(self, bus: str, message: str) -> Sequence[str]:
        """Return the names of a message's signals, without CRC and counter."""

    def has_counter(self, bus: str, message: str) -> bool:
        """Return whether a message carries an alive counter."""


@dataclass(frozen=True, slots=True)
class FrameContext:
    """A frame that a fault is asked about.

    Attributes:
        bus: the bus it goes to.
        can_id: its identifier.
        cycle: the cycle it is sent in.
        first: the cycle in which the fault began.
        dice: returns a new source of chance, which always gives the same numbers for this fault and frame.
    """

    bus: str
    can_id: int
    cycle: int
    first: int
    dice: Callable[[], Random]


class Passage(NamedTuple):
    """How a frame gets to the bus.

    Attributes:
        late: how many cycles late; None where it does not go out, or only behind a later one.
        behind: frames that go out right behind it.
    """

    late: int | None = 0
    behind: tuple[bytes, ...] = ()


ON_TIME = Passage()
LOST = Passage(late=None)


class Condition(IntEnum):
    """What state an ECU's process is in; of several that faults want, the greatest holds."""

    RUNNING = 0
    STOPPED = 1
    DEAD = 2


class Outage(NamedTuple):
    """An ECU whose process does not run, and in what condition it is instead."""

    ecu: str
    condition: Condition


class Fault(BaseModel):
    """What all faults have.

    Attributes:
        at_s: simulated time at which it begins (s); it takes hold with the cycle that begins then.
        for_s: how long it lasts (s); to the end of the run where it is None.
    """

    model_config = STRICT

    at_s: Annotated[float, Field(ge=0, le=300)]
    for_s: Annotated[float, Field(gt=0, le=300)] | None = None

    @classmethod
    def name(cls) -> str:
        """Return what the kind is called."""
        return str(cls.model_fields["kind"].default)

    def parameters(self) -> dict[str, Any]:
        """Return what is given of it beside its kind and its time."""
        return self.model_dump(exclude_none=True, exclude={"kind", "at_s", "for_s"})

    def problems(self, bench: Bench) -> list[Problem]:
        """Return what is wrong with its target on a bench; empty where all is well."""
        return []

    def hits(self, bus: str, message: str) -> bool:
        """Return whether it is done to the frames of this message."""
        return False

    def on_values(self, values: dict[str, float], frame: FrameContext, memory: Memory) -> None:
        """Change the values that a message is sent with, by signal; CRC and counter will be good."""

    def counter(self, frame: FrameContext) -> int | None:
        """Return the cycle whose alive counter the frame carries, under a good CRC; None where it keeps its own."""
        return None

    def on_bytes(self, data: bytes, frame: FrameContext) -> bytes:
        """Return what the frame's bytes become after its CRC was made."""
        return data

    def passage(self, data: bytes, frame: FrameContext, memory: Memory) -> Passage:
        """Return how the frame gets to the bus."""
        return ON_TIME

    def extra(self, frame: FrameContext) -> int:
        """Return how many frames of the message the cycle brings beyond the one that is due, after that."""
        return 0

    def cuts(self, node: str, bus: str) -> bool:
        """Return whether the node takes no part on a bus, neither sending nor receiving."""
        return False

    def identifiers(self, node: str) -> tuple[tuple[str, int], ...]:
        """Return bus and identifier of the frames of its own that it makes the node send."""
        return ()

    def payloads(self, dice: Random) -> list[bytes]:
        """Return the data of the frames that it makes a node send in a cycle with one of `identifiers`."""
        return []

    def starved(self, bus: str, can_ids: Sequence[int], room: int) -> frozenset[int]:
        """Return which identifiers of a bus find no room in a cycle, which has `room` frames of the greatest length."""
        return frozenset()

    @property
    def outage(self) -> Outage | None:
        """What it does to an ECU's process; None where it does nothing."""
        return None

    def on_actuators(self, vehicle: int, before: Mapping[str, float], memory: Memory) -> dict[str, float]:
        """Return what actuators of a vehicle apply, whatever they are commanded.

        Args:
            vehicle: its number.
            before: what they applied in the cycle before: `steering_angle` in rad, `torque_fl` ... in N m.
            memory: what the fault remembers of this vehicle.
        """
        return {}

    def on_vehicle(self, vehicle: int) -> dict[str, float]:
        """Return the inputs of a vehicle's FMU that it sets, by name."""
        return {}


class Window:
    """In which cycles a fault is at work: from `first` to before `end`, which is None where it never ends."""

    __slots__ = ("end", "first")

    def __init__(self, fault: Fault, cycle_s: float) -> None:
        """Find the cycles of `cycle_s` s in which `fault` is at work; it lasts at least one."""
        self.first = round(fault.at_s / cycle_s)
        self.end = None if fault.for_s is None else max(self.first + 1, round((fault.at_s + fault.for_s) / cycle_s))

    def __contains__(self, cycle: int) -> bool:
        """Whether the fault is at work in a cycle."""
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
