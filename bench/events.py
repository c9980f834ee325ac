"""The events of a run: each kind with its named fields, level, source and text for people.

A log has kind and fields for programs (`platoon.Event` on the topic `/events/data`) and the text for people
(`foxglove.Log` on `/events`). The text is generated here from the fields, and no program reads it. Old logs must stay
readable: a recorded kind keeps its name, and its fields keep their meaning. To add a kind, add its class.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from dataclasses import fields as fields_of
from enum import StrEnum
from typing import Any, ClassVar, Literal, Protocol

from bench.counts import counted
from bench.names import ACTUATORS, CONDUCTOR, vehicle_of

Level = Literal["debug", "info", "warning", "error", "fatal"]

FAULT, BUS = "fault", "bus"
"""Sources that are neither process nor bus of the run: the faults, the bus analysis before the run."""

OTHER = "other"
"""The kind of an event in an older log whose text is not recognised: no fields."""


class Event(Protocol):
    """An event for the log: one of the kinds below, or one read from another log."""

    @property
    def kind(self) -> str:
        """Name of the kind."""

    @property
    def level(self) -> str:
        """Severity, one of `Level`."""

    @property
    def source(self) -> str:
        """Source of the event: an ECU or another process, `veh1.actuators`, a bus, `conductor`, `fault`."""

    @property
    def text(self) -> str:
        """Text of the event."""

    @property
    def fields(self) -> Mapping[str, Any]:
        """The fields of the kind, by name, as JSON values."""


@dataclass(frozen=True)
class _Kind:
    """Base class of all kinds.

    Attributes:
        kind: name of the kind.
    """

    kind: ClassVar[str]

    @property
    def fields(self) -> dict[str, Any]:
        """See `Event`."""
        return {each.name: getattr(self, each.name) for each in fields_of(self) if each.name not in ("level", "source")}


def _fault_sentence(what: str, parameters: Mapping[str, Any], *more: str) -> str:
    """Return `v2v_outage begins: vehicle 3, until 4.5 s`."""
    said = [*(f"{name} {value}" for name, value in parameters.items()), *more]
    return f"{what}: {', '.join(said)}" if said else what


@dataclass(frozen=True)
class _OfFault(_Kind):
    """Base class of all events of a fault.

    Attributes:
        fault: kind of the fault, as in a scenario.
        parameters: its parameters in a scenario, without kind, `at_s` and `for_s`.
    """

    level: ClassVar[Level] = "warning"
    source: ClassVar[str] = FAULT
    fault: str
    parameters: Mapping[str, Any]


@dataclass(frozen=True)
class FaultBegins(_OfFault):
    """A fault begins.

    Attributes:
        until_s: simulated time in s at which it ends; None if it lasts to the end of the run.
    """

    kind: ClassVar[str] = "fault_begins"
    until_s: float | None

    @property
    def text(self) -> str:
        """See `Event`."""
        until = "the end" if self.until_s is None else f"{self.until_s:g} s"
        return _fault_sentence(f"{self.fault} begins", self.parameters, f"until {until}")


@dataclass(frozen=True)
class FaultEnds(_OfFault):
    """A fault ends."""

    kind: ClassVar[str] = "fault_ends"

    @property
    def text(self) -> str:
        """See `Event`."""
        return _fault_sentence(f"{self.fault} ends", self.parameters)


@dataclass(frozen=True)
class FaultRequested(_Kind):
    """A person has injected a fault into the running bench.

    Attributes:
        fault: its complete table, as in a scenario.
    """

    kind: ClassVar[str] = "fault_requested"
    level: ClassVar[Level] = "info"
    source: ClassVar[str] = CONDUCTOR
    fault: Mapping[str, Any]

    @property
    def text(self) -> str:
        """See `Event`."""
        fault = {key: value for key, value in self.fault.items() if value is not None}
        kind, at_s, for_s = (fault.pop(key, None) for key in ("kind", "at_s", "for_s"))
        begins = "now" if at_s is None else f"from {at_s:g} s"
        lasts = "to the end" if for_s is None else f"for {for_s:g} s"
        return _fault_sentence(f"{kind} is injected", fault, f"{begins} {lasts}")


@dataclass(frozen=True)
class _OfState(_Kind):
    """Base class of the changes in an ECU's status: one event for each frame that differs from the one before."""

    level: str
    source: str

    @property
    def fields(self) -> dict[str, Any]:
        """See `Event`; besides the kind's own, the number of the vehicle, and the ECU's name if it is one."""
        ecu = {} if self.source.endswith(f".{ACTUATORS}") else {"ecu": self.source}
        return {"vehicle": vehicle_of(self.source), **ecu, **super().fields}


@dataclass(frozen=True)
class StateChange(_OfState):
    """An ECU or the actuators of a vehicle change state; states in lower case.

    Attributes:
        level: info if the new state is normal, else warning.
        source: owner of the state, e.g. veh1.planner, veh1.actuators.
        before: the old state.
        after: the new state.
        cause: the cause by the DBC's value table; empty if none.
        cause_before: the cause in the old state; empty if none, None in logs without it.
    """

    kind: ClassVar[str] = "state_change"
    before: str
    after: str
    cause: str = ""
    cause_before: str | None = None

    @property
    def text(self) -> str:
        """See `Event`."""
        cause = _from_to(self.cause_before, self.cause) if self.cause_before else self.cause
        return f"{self.before} -> {self.after}" + (f" ({cause})" if cause else "")


@dataclass(frozen=True)
class CauseChange(_OfState):
    """The most serious cause that an ECU reports changes, its state does not.

    Attributes:
        level: warning if there is a new cause, info if there is none any more and in the initial state.
        source: the ECU, e.g. veh1.planner.
        state: its state, in lower case.
        cause: the new cause by the DBC's value table; empty if none.
        cause_before: the old one, likewise.
    """

    kind: ClassVar[str] = "cause_change"
    state: str
    cause: str
    cause_before: str

    @property
    def text(self) -> str:
        """See `Event`."""
        return f"{self.state}: {_from_to(self.cause_before, self.cause)}"


@dataclass(frozen=True)
class HardBraking(_OfState):
    """A planner brakes harder than is comfortable, to keep clear of a vehicle ahead, or does so no longer.

    Attributes:
        level: info.
        source: the ECU, e.g. veh1.planner.
        begins: whether it begins.
    """

    kind: ClassVar[str] = "hard_braking"
    begins: bool

    @property
    def text(self) -> str:
        """See `Event`."""
        if self.begins:
            return "brakes harder than is comfortable, to keep clear of a vehicle ahead"
        return "brakes comfortably again"


@dataclass(frozen=True)
class Uncomfortable(_OfState):
    """A vehicle's measured acceleration or jerk exceeds the limits of comfort, or does so no longer.

    Attributes:
        level: info.
        source: the planner that says so, e.g. veh1.planner.
        begins: whether it begins.
    """

    kind: ClassVar[str] = "uncomfortable"
    begins: bool

    @property
    def text(self) -> str:
        """See `Event`."""
        if self.begins:
            return "measures an acceleration or a jerk above the limits of comfort"
        return "measures accelerations within the limits of comfort again"


def _from_to(before: str, after: str) -> str:
    return after if before == after else f"{before or 'no cause'} -> {after or 'no cause'}"


@dataclass(frozen=True)
class NotANumber(_Kind):
    """An ECU's step has begun to return a value that is not a number; its message is not sent while that lasts.

    Attributes:
        source: the ECU.
        cycle: number of the cycle.
        message: name of the message in the DBC.
        signal: name of the signal.
        value: nan, inf or -inf.
        command: whether other nodes act on the message: it has E2E protection.
    """

    kind: ClassVar[str] = "not_a_number"
    source: str
    cycle: int
    message: str
    signal: str
    value: str
    command: bool

    @property
    def level(self) -> Level:
        """See `Event`."""
        return "error" if self.command else "warning"

    @property
    def text(self) -> str:
        """See `Event`."""
        return (
            f"{self.message}.{self.signal} = {self.value} is not a number; {self.message} is not sent until it is one"
        )


@dataclass(frozen=True)
class NumberAgain(_Kind):
    """A value of an ECU is a number again.

    Attributes:
        source, cycle, message, signal: as of `NotANumber`.
        cycles: number of cycles for which it was not.
    """

    kind: ClassVar[str] = "number_again"
    level: ClassVar[Level] = "info"
    source: str
    cycle: int
    message: str
    signal: str
    cycles: int

    @property
    def text(self) -> str:
        """See `Event`."""
        return f"{self.message}.{self.signal} is a number again after {self.cycles} cycles"


@dataclass(frozen=True)
class Clipped(_Kind):
    """An ECU's value is outside its signal's range in the DBC; recorded once per run, ECU and signal.

    Attributes:
        source, cycle, message, signal: as of `NotANumber`.
        value: what the ECU's step has returned.
        sent: the end of the range, which is sent instead.
    """

    kind: ClassVar[str] = "clipped"
    level: ClassVar[Level] = "warning"
    source: str
    cycle: int
    message: str
    signal: str
    value: float
    sent: float

    @property
    def text(self) -> str:
        """See `Event`."""
        what = f"{self.message}.{self.signal} = {self.value:g}"
        return f"{what} is outside the range in the DBC and is sent as {self.sent:g}"


EcuNote = NotANumber | NumberAgain | Clipped
"""What the bench notes of the values that an ECU sends."""

ECU_NOTES: Mapping[str, type[EcuNote]] = {each.kind: each for each in (NotANumber, NumberAgain, Clipped)}
"""The kinds of `EcuNote`, by name."""


@dataclass(frozen=True)
class EcuFailed(_Kind):
    """ECUs have ended or fallen silent without a fault that causes it; the run continues without them.

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
    """A node's counts of lost or rejected frames have changed.

    Attributes:
        source: the bus of the node's health message.
        message: name of the health message in the DBC.
        frames_lost: number of frames it has lost in the run.
        e2e_errors: number of frames it has rejected in the run.
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


class Refusal(StrEnum):
    """Why the conductor refuses a frame; `REFUSAL_TEXTS` completes a sentence about it."""

    NOT_DUE = "not_due"
    """Whole, but not due in the cycle it came in, or it came twice."""
    UNKNOWN = "unknown_identifier"
    """The DBC file has no such identifier; so it is with all of 29 bits."""
    LENGTH = "wrong_length"
    """It does not have as many bytes as the DBC file gives its message."""
    DAMAGED = "wrong_crc"
    """Its CRC is wrong, or its alive counter is 15."""
    IMPLAUSIBLE = "implausible_sync"
    """A BenchSync whose cycle does not follow, or that only the conductor sends."""
    REMOTE = "remote_frame"
    ERROR = "error_frame"
    FD = "fd_frame"
    MALFORMED = "malformed"
    """Not a frame at all, such as any datagram on a UDP port."""


REFUSAL_TEXTS: Mapping[str, str] = {
    Refusal.NOT_DUE: "not due in the cycle it came in, or came twice",
    Refusal.UNKNOWN: "of an identifier that the bus does not have",
    Refusal.LENGTH: "of a wrong length",
    Refusal.DAMAGED: "with a wrong CRC or alive counter",
    Refusal.IMPLAUSIBLE: "a BenchSync of a cycle that does not follow",
    Refusal.REMOTE: "a remote frame",
    Refusal.ERROR: "an error frame",
    Refusal.FD: "a CAN FD frame",
    Refusal.MALFORMED: "not a CAN frame",
}

_REFUSAL_COUNTS: Mapping[str, tuple[str, str]] = {
    Refusal.NOT_DUE: ("not due in its cycle, or sent twice", "not due in their cycle, or sent twice"),
    Refusal.UNKNOWN: (REFUSAL_TEXTS[Refusal.UNKNOWN], "of identifiers that the bus does not have"),
    Refusal.LENGTH: (REFUSAL_TEXTS[Refusal.LENGTH], REFUSAL_TEXTS[Refusal.LENGTH]),
    Refusal.DAMAGED: (REFUSAL_TEXTS[Refusal.DAMAGED], REFUSAL_TEXTS[Refusal.DAMAGED]),
    Refusal.IMPLAUSIBLE: ("BenchSync of a cycle that does not follow", "BenchSync of cycles that do not follow"),
    Refusal.REMOTE: ("remote frame", "remote frames"),
    Refusal.ERROR: ("error frame", "error frames"),
    Refusal.FD: ("CAN FD frame", "CAN FD frames"),
    Refusal.MALFORMED: ("that is not a CAN frame", "that are not CAN frames"),
}
"""What follows a number of one, and of more, in a list of refused frames."""


@dataclass(frozen=True)
class StrayFrame(_Kind):
    """A frame arrived that does not belong to the run and is refused; the first of its bus, identifier and reason.

    Attributes:
        bus: the bus of the frame.
        can_id: its identifier, with bit 31 set if it is of 29 bits; None if it has none.
        why: why it is refused, a `Refusal`; logs of older versions have only those that are not due.
        length: its length in bytes; None if unknown.
    """

    kind: ClassVar[str] = "stray_frame"
    level: ClassVar[Level] = "warning"
    source: ClassVar[str] = CONDUCTOR
    bus: str
    can_id: int | None
    why: str = Refusal.NOT_DUE
    length: int | None = None

    @property
    def text(self) -> str:
        """See `Event`."""
        frame = "frame" if self.can_id is None else f"frame 0x{self.can_id:03X}"
        if self.why == Refusal.NOT_DUE:
            return f"{frame} on {self.bus} is not due in the cycle it came in, or came twice"
        size = "" if self.length is None else f" ({self.length} byte{'' if self.length == 1 else 's'})"
        return f"{frame} on {self.bus}{size} is refused: {REFUSAL_TEXTS.get(self.why, self.why)}"


@dataclass(frozen=True)
class FramesRefused(_Kind):
    """The run has ended, and the conductor has refused frames of a bus.

    Attributes:
        bus: the bus.
        counts: number of frames refused by reason, a `Refusal`.
        identifiers: the same by reason and identifier, 0x107; those without one, and those beyond the first few
            dozen identifiers, are "others".
    """

    kind: ClassVar[str] = "frames_refused"
    level: ClassVar[Level] = "warning"
    source: ClassVar[str] = CONDUCTOR
    bus: str
    counts: Mapping[str, int]
    identifiers: Mapping[str, Mapping[str, int]]

    @property
    def kinds(self) -> str:
        """The counts as text: `28,771 CAN FD frames, 1 of a wrong length`."""
        return ", ".join(counted(count, *_REFUSAL_COUNTS.get(why, (why, why))) for why, count in self.counts.items())

    @property
    def text(self) -> str:
        """See `Event`."""
        number = sum(self.counts.values())
        were = "was" if number == 1 else "were"
        return f"{counted(number, 'frame')} on {self.bus} {were} refused in the run: {self.kinds}"


@dataclass(frozen=True)
class FramesLost(_Kind):
    """The conductor has lost frames of a bus, which its receive queue had no room for: they are not in the log.

    Attributes:
        bus: the bus.
        frames_lost: number of frames it has lost in the run.
    """

    kind: ClassVar[str] = "frames_lost"
    level: ClassVar[Level] = "error"
    source: ClassVar[str] = CONDUCTOR
    bus: str
    frames_lost: int

    @property
    def text(self) -> str:
        """See `Event`."""
        they, are = ("it", "is") if self.frames_lost == 1 else ("they", "are")
        lost = counted(self.frames_lost, "frame")
        return f"{lost} on {self.bus} came faster than {they} could be read, and {are} not in the log"


@dataclass(frozen=True)
class ProcessOutput(_Kind):
    """A process has written to its standard output or error.

    Attributes:
        source: the process.
        output: the text written.
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
    """In real time: a node has missed the end of a cycle after meeting the one before.

    Attributes:
        source: the node: an ECU, or the plant on one bus (veh1.plant).
        late_ms: its lateness, ms; None if it sent nothing.
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
    """In real time: a node meets its deadlines again.

    Attributes:
        source: the node, as of `DeadlineMissed`.
        missed: number of consecutive deadlines missed before.
    """

    kind: ClassVar[str] = "deadline_met"
    level: ClassVar[Level] = "info"
    source: str
    missed: int

    @property
    def text(self) -> str:
        """See `Event`."""
        return f"in time again after {counted(self.missed, 'missed deadline')}"


@dataclass(frozen=True)
class ResponseBeyondPeriod(_Kind):
    """Before the run: the worst-case response time of a message exceeds its period.

    Attributes:
        bus: the bus of the message.
        message: its name in the DBC.
        can_id: its identifier.
        response_ms: its worst-case response time, ms; None if unbounded.
        period_ms: its period, ms.
        bit_rate: bit rate of the bus, bit/s.
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
    """In real time: the scheduling that the kernel has granted to the processes.

    Attributes:
        fifo: whether all processes have SCHED_FIFO.
        own_cores: whether each process has a core to itself.
        processes: number of processes; None in old logs without it.
        cores: number of cores they may use; likewise.
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
    """In real time: during the run the host of this virtual machine has given its processors to others.

    Attributes:
        stolen_s: processor time taken from the virtual machine, s.
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
    """The run has ended prematurely.

    Attributes:
        status: failed or interrupted.
        reason: the reason.
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
