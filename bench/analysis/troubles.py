"""What the events of a run report as wrong: its warnings, and commands that are not numbers."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from bench.cycle import CYCLE_S
from bench.events import FaultBegins, FaultEnds, NotANumber, NumberAgain
from bench.record import Event

_GRAVE = ("warning", "error", "fatal")
_ASKED_FOR = (FaultBegins.kind, FaultEnds.kind)


@dataclass(frozen=True)
class Warnings:
    """The warnings and errors of a run; faults that were asked for are none, but their consequences are.

    Attributes:
        count: their number.
        first_s: time of the first, s; None if there is none.
        first: its source and text; empty if there is none.
    """

    count: int
    first_s: float | None
    first: str

    def __str__(self) -> str:
        """Return number and first one: `49 warnings, first at 0.31 s: veh1.tracker: ...`."""
        if self.first_s is None:
            return "no warnings"
        number = f"{self.count} warning{'s' if self.count > 1 else ''}"
        return f"{number}, first at {self.first_s:.2f} s: {self.first}"


@dataclass(frozen=True)
class NotNumber:
    """A signal of a command that was not a number for some cycles on end.

    Attributes:
        ecu: the ECU that sent it.
        message: name of the message.
        signal: name of the signal.
        value: nan, inf or -inf.
        first_s: time of the first cycle, s.
        cycles: number of cycles; None to the end of the log.
    """

    ecu: str
    message: str
    signal: str
    value: str
    first_s: float
    cycles: int | None

    def __str__(self) -> str:
        """Return the sentence: which ECU, which signal, from when and how long."""
        till = "to the end" if self.cycles is None else f"for {self.cycles} cycle{'s' if self.cycles > 1 else ''}"
        what = f"{self.message}.{self.signal} = {self.value}, which is not a number"
        return f"{self.ecu} sent {what}, from {self.first_s:.2f} s {till}"


def has_fault(events: Iterable[Event]) -> bool:
    """Return whether a fault that was asked for began, planned or from outside."""
    return any(event.kind == FaultBegins.kind for event in events)


def warnings_of(events: Iterable[Event]) -> Warnings:
    """Return the warnings among the events of a run."""
    found = [event for event in events if event.level in _GRAVE and event.kind not in _ASKED_FOR]
    if not found:
        return Warnings(0, None, "")
    lines = found[0].text.strip().splitlines()
    return Warnings(len(found), found[0].time_s, f"{found[0].source}: {lines[0] if lines else ''}")


def not_numbers(events: Sequence[Event]) -> list[NotNumber]:
    """Return the commands among the events of a run that were not numbers, in order."""
    found = []
    for index, event in enumerate(events):
        fields = event.fields
        if event.kind != NotANumber.kind or not fields.get("command"):
            continue
        message, signal = fields["message"], fields["signal"]
        first_s = fields["cycle"] * CYCLE_S
        cycles = _cycles_until_again(events[index:], event.source, message, signal)
        found.append(NotNumber(event.source, message, signal, fields["value"], first_s, cycles))
    return found


def _cycles_until_again(events: Sequence[Event], source: str, message: str, signal: str) -> int | None:
    for event in events:
        if event.kind == NumberAgain.kind and event.source == source:
            fields = event.fields
            if (fields["message"], fields["signal"]) == (message, signal):
                return int(fields["cycles"])
    return None
