"""What can happen in a run: every kind of event, with its named fields, its level, its source and its text for people.

A log has kind and fields for programs (`platoon.Event` on the topic `/events/data`) and the text for people
(`foxglove.Log` on `/events`). The text is made here, from the fields, and no program reads it. Logs are kept: a kind
that has been recorded keeps its name and its fields their meaning. To add a kind, add its class.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from dataclasses import fields as fields_of
from typing import Any, ClassVar, Literal, Protocol

Level = Literal["debug", "info", "warning", "error", "fatal"]

CONDUCTOR, FAULT, BUS = "conductor", "fault", "bus"
"""Sources that are no node and no bus of the run: who conducts it, its faults, what is said of its buses beforehand."""

OTHER = "other"
"""The kind of an event that an older log has and whose text says nothing known: no fields."""


class Event(Protocol):
    """What the log takes: one of the kinds below, or an event read from another log."""

    @property
    def kind(self) -> str:
        """Name of the kind."""

    @property
    def level(self) -> str:
        """How grave it is, one of `Level`."""

    @property
    def source(self) -> str:
        """Who says so: an ECU or another process, `veh1.actuators`, a bus, `conductor`, `fault`."""

    @property
    def text(self) -> str:
        """The event in words."""

    @property
    def fields(self) -> Mapping[str, Any]:
        """What the kind has beside, by name, as values that JSON takes."""


@dataclass(frozen=True)
class _Kind:
    """What all kinds have.

    Attributes:
        kind: name of the kind.
    """

    kind: ClassVar[str]

    @property
    def fields(self) -> dict[str, Any]:
        """See `Event`."""
        return {each.name: getattr(self, each.name) for each in fields_of(self) if each.name not in ("level", "source")}


@dataclass(frozen=True)
class _OfFault(_Kind):
    """What all events of a fault have.

    Attributes:
        fault: its kind, as in a scenario.
        parameters: what a scenario gives of it beside kind, `at_s` and `for_s`.
    """

    level: ClassVar[Level] = "warning"
    source: ClassVar[str] = FAULT
    fault: str
    parameters: Mapping[str, Any]

    def _named(self) -> str:
        parameters = ", ".join(f"{name} {value}" for name, value in self.parameters.items())
        return f"{self.fault}: {parameters}" if parameters else self.fault


@dataclass(frozen=True)
class FaultBegins(_OfFault):
    """A fault takes hold.

    Attributes:
        until_s: simulated time in s at which it ends; None where it lasts to the end of the run.
    """

    kind: ClassVar[str] = "fault_begins"
    until_s: float | None

    @property
    def text(self) -> str:
        """See `Event`."""
        until = "the end" if self.until_s is None else f"{self.until_s:g} s"
        return f"{self._named()} begins, until {until}"


@dataclass(frozen=True)
class FaultEnds(_OfFault):
    """A fault is over."""

    kind: ClassVar[str] = "fault_ends"

    @property
    def text(self) -> str:
        """See `Event`."""
        return f"{self._named()} ends"


@dataclass(frozen=True)
class FaultRequested(_Kind):
    """A person has brought a fault to the running bench.

    Attributes:
        fault: all of it, as a scenario would have it.
    """

    kind: ClassVar[str] = "fault_requested"
    level: ClassVar[Level] = "info"
    source: ClassVar[str] = CONDUCTOR
    fault: Mapping[str, Any]

    @property
    def text(self) -> str:
        """See `Event`."""
        return f"asked for while running: {json.dumps(self.fault)}"


@dataclass(frozen=True)
class StateChange(_Kind):
    """An ECU or the actuators of a vehicle go from one state to another; states in small letters.

    Attributes:
        level: info where the state after is no reason to worry, else warning.
        source: whose state it is: veh1.planner, veh1.actuators.
        before: the state until then.
        after: the state from then on.
        cause: why, as the DBC's value table names it; empty for no cause.
    """

    kind: ClassVar[str] = "state_change"
    level: str
    source: str
    before: str
    after: str
    cause: str = ""

    @property
    def text(self) -> str:
        """See `Event`."""
        return f"{self.before} -> {self.after}" + (f" ({self.cause})" if self.cause else "")


@dataclass(frozen=True)
class EcuFailed(_Kind):
    """ECUs have ended or fallen silent that no fault had told to, and the run goes on without them.

    Attributes:
        ecus: their names.
        reason: what happened, and when.
    """

    kind: ClassVar[str] = "ecu_failed"
    level: ClassVar[Level] = "error"
    source: ClassVar[str] = CONDUCTOR
    ecus: Sequence[str]
    reason: str

    @property
    def text(self) -> str:
        """See `Event`."""
        return f"{self.reason}; the run goes on without {', '.join(self.ecus)}"


@dataclass(frozen=True)
class ReceptionErrors(_Kind):
    """A node's counts of frames that it has lost or refused have changed.

    Attributes:
        source: the bus it says so on.
        message: its health message, as the DBC names it.
        frames_lost: frames that it has lost in the run.
        e2e_errors: frames that it has refused in the run.
    """

    kind: ClassVar[str] = "reception_errors"
    level: ClassVar[Level] = "warning"
    source: str
    message: str
    frames_lost: int
    e2e_errors: int

    @property
    def text(self) -> str:
        """See `Event`."""
        return f"{self.message}: FramesLost {self.frames_lost}, E2EErrors {self.e2e_errors}"


@dataclass(frozen=True)
class StrayFrame(_Kind):
    """A frame has come that is not due in its cycle, or twice; noted once a run for each bus and identifier.

    Attributes:
        bus: the bus it came on.
        can_id: its identifier.
    """

    kind: ClassVar[str] = "stray_frame"
    level: ClassVar[Level] = "warning"
    source: ClassVar[str] = CONDUCTOR
    bus: str
    can_id: int

    @property
    def text(self) -> str:
        """See `Event`."""
        return f"frame 0x{self.can_id:03X} on {self.bus} is not due in the cycle it came in, or came twice"


@dataclass(frozen=True)
class ProcessOutput(_Kind):
    """A process has written something to its standard output or error.

    Attributes:
        source: the process.
        output: what it has written.
    """

    kind: ClassVar[str] = "process_output"
    level: ClassVar[Level] = "warning"
    source: str
    output: str

    @property
    def text(self) -> str:
        """See `Event`."""
        return self.output


@dataclass(frozen=True)
class DeadlineMissed(_Kind):
    """In real time: a node has missed the end of a cycle, after one that it met.

    Attributes:
        source: the node: an ECU, or the plant on one bus (veh1.plant).
        late_ms: how late it was, ms; None where nothing has come of it.
    """

    kind: ClassVar[str] = "deadline_missed"
    level: ClassVar[Level] = "warning"
    source: str
    late_ms: float | None

    @property
    def text(self) -> str:
        """See `Event`."""
        late = "sent nothing" if self.late_ms is None else f"was {self.late_ms:.2f} ms late"
        return f"missed its deadline: {late}"


@dataclass(frozen=True)
class DeadlineMet(_Kind):
    """In real time: a node is in time again.

    Attributes:
        source: the node, as of `DeadlineMissed`.
        missed: how many deadlines in a row it has missed before.
    """

    kind: ClassVar[str] = "deadline_met"
    level: ClassVar[Level] = "info"
    source: str
    missed: int

    @property
    def text(self) -> str:
        """See `Event`."""
        return f"in time again after {self.missed} missed deadlines"


@dataclass(frozen=True)
class ResponseBeyondPeriod(_Kind):
    """Before the run: in the worst case a message takes longer than its period.

    Attributes:
        bus: the bus it is on.
        message: its name in the DBC.
        can_id: its identifier.
        response_ms: its worst-case response time, ms; None where it has no bound.
        period_ms: its period, ms.
        bit_rate: of the bus, bit/s.
    """

    kind: ClassVar[str] = "response_beyond_period"
    level: ClassVar[Level] = "warning"
    source: ClassVar[str] = BUS
    bus: str
    message: str
    can_id: int
    response_ms: float | None
    period_ms: float
    bit_rate: int

    @property
    def text(self) -> str:
        """See `Event`."""
        time = "without bound" if self.response_ms is None else f"up to {self.response_ms:.2f} ms"
        return (
            f"bus {self.bus}: in the worst case {self.message} (0x{self.can_id:03X}) takes {time} at "
            f"{self.bit_rate / 1000:g} kbit/s, longer than its period of {self.period_ms:g} ms"
        )


@dataclass(frozen=True)
class Scheduling(_Kind):
    """In real time: what the kernel has granted the processes.

    Attributes:
        fifo: whether all have SCHED_FIFO.
        own_cores: whether each is on a core of its own.
        processes: how many there are; None where an old log does not tell.
        cores: how many cores they may use; likewise.
    """

    kind: ClassVar[str] = "scheduling"
    source: ClassVar[str] = CONDUCTOR
    fifo: bool
    own_cores: bool
    processes: int | None
    cores: int | None

    @property
    def level(self) -> Level:
        """See `Event`."""
        return "info" if self.fifo else "warning"

    @property
    def text(self) -> str:
        """See `Event`."""
        shared = f"{self.processes} processes share {self.cores} cores"
        cores = "each on a core of its own" if self.own_cores else shared
        lacking = "" if self.fifo else " (it takes root, CAP_SYS_NICE or a limit set with ulimit -r)"
        return f"{'' if self.fifo else 'no '}SCHED_FIFO{lacking}, {cores}"


@dataclass(frozen=True)
class StolenTime(_Kind):
    """In real time: the host of this virtual machine has given others its processors during the run.

    Attributes:
        stolen_s: processor time taken from it, s.
    """

    kind: ClassVar[str] = "stolen_time"
    level: ClassVar[Level] = "info"
    source: ClassVar[str] = CONDUCTOR
    stolen_s: float

    @property
    def text(self) -> str:
        """See `Event`."""
        return f"the host of this virtual machine took {self.stolen_s:.2f} s of processor time from it meanwhile"


@dataclass(frozen=True)
class RunEnded(_Kind):
    """The run has ended before its time.

    Attributes:
        status: failed or interrupted.
        reason: why.
    """

    kind: ClassVar[str] = "run_ended"
    level: ClassVar[Level] = "fatal"
    source: ClassVar[str] = CONDUCTOR
    status: str
    reason: str

    @property
    def text(self) -> str:
        """See `Event`."""
        return self.reason
