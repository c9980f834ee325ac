"""The control channel between a process of a bench and its conductor: a lifeline and a pipe for reports.

The lifeline is the reading end of a pipe whose writing end only the conductor has: it becomes readable (end of file)
when the conductor ends, however that happens. Reports are records in a pipe that all processes of a bench share; POSIX
guarantees that writes of up to PIPE_BUF bytes are atomic, so records never mix.
"""

from __future__ import annotations

import json
import os
import select
import struct
from array import array
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from enum import IntEnum
from typing import Any, NamedTuple

from bench.bus.topic import Topic
from bench.events import ECU_NOTES, EcuNote
from bench.faults.plan import FaultBoard

_HEAD = struct.Struct("<BxH")
_TRUTH = struct.Struct("<HxxI")


class Kind(IntEnum):
    """The kinds of reports."""

    STARTED = 1
    """A process has been started: its name and process number."""
    READY = 2
    """A process is listening on its buses: its name and the inputs of its nodes."""
    ENDED = 3
    """A process has ended: its name and its exit code, the negated signal number if a signal ended it."""
    TRUTH = 4
    """A truth row: vehicle, cycle, values."""
    NOTE = 5
    """Something is wrong with the values that an ECU sends: the event's kind and all its fields."""


class Truth(NamedTuple):
    """One truth row of one vehicle."""

    vehicle: int
    cycle: int
    values: array[float]


@dataclass(frozen=True, slots=True)
class ControlChannel:
    """A process's ends of the pipes to its conductor.

    Attributes:
        lifeline: readable once the conductor has ended.
        reports: writing end of the pipe for reports.
        board: file descriptor of the fault board; -1 if there is none.
    """

    lifeline: int
    reports: int
    board: int = -1

    def fault_board(self) -> FaultBoard | None:
        """Return the board on which the conductor posts faults, None if there is none."""
        return FaultBoard(self.board) if self.board >= 0 else None

    def ready(self, name: str, inputs: Sequence[Topic]) -> None:
        """Report that the process `name` is listening on its buses for `inputs`."""
        self.report(Kind.READY, {"name": name, "inputs": [[topic.bus, topic.message] for topic in inputs]})

    def truth(self, vehicle: int, cycle: int, values: Sequence[float]) -> None:
        """Report a truth row."""
        self._write(Kind.TRUTH, _TRUTH.pack(vehicle, cycle) + array("d", values).tobytes())

    def note(self, event: EcuNote) -> None:
        """Report what is to be noted of the values that an ECU sends."""
        self.report(Kind.NOTE, {"kind": event.kind, "fields": asdict(event)})

    def report(self, kind: Kind, content: dict[str, Any]) -> None:
        """Report a single event.

        Raises:
            ValueError: the record is longer than PIPE_BUF, which a pipe accepts in one piece.
        """
        self._write(kind, json.dumps(content).encode())

    def _write(self, kind: Kind, payload: bytes) -> None:
        record = _HEAD.pack(kind, len(payload)) + payload
        if len(record) > select.PIPE_BUF:
            raise ValueError(f"report of {len(record)} bytes; a pipe accepts {select.PIPE_BUF} in one piece")
        os.write(self.reports, record)


class ReportReader:
    """Assembles the records read from the pipe."""

    def __init__(self) -> None:
        """Start with an empty buffer."""
        self._buffer = b""

    def feed(self, data: bytes) -> Iterator[tuple[Kind, bytes]]:
        """Yield kind and payload of each record that `data` completes."""
        buffer = self._buffer + data
        start = 0
        while len(buffer) - start >= _HEAD.size:
            kind, length = _HEAD.unpack_from(buffer, start)
            end = start + _HEAD.size + length
            if len(buffer) < end:
                break
            yield Kind(kind), buffer[start + _HEAD.size : end]
            start = end
        self._buffer = buffer[start:]


def read_truth(payload: bytes) -> Truth:
    """Return the truth row in a record's payload."""
    vehicle, cycle = _TRUTH.unpack_from(payload)
    return Truth(vehicle, cycle, array("d", payload[_TRUTH.size :]))


def read_note(payload: bytes) -> EcuNote:
    """Return the event in a record's payload."""
    content = json.loads(payload)
    return ECU_NOTES[content["kind"]](**content["fields"])
