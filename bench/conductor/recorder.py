"""Passes complete cycles to the log and keeps account of lost frames and E2E errors."""

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

from bench.bus.codec import Codec
from bench.bus.ties import Truth
from bench.bus.topic import CYCLE_MS
from bench.conductor.stage import Stage
from bench.errors import RunFailed
from bench.record.writer import RunWriter

CYCLE_NS = CYCLE_MS * 1_000_000
_LOST, _ERRORS = "FramesLost", "E2EErrors"


def open_recorder(out: Path, stage: Stage, command_line: Sequence[str]) -> "Recorder":
    """Begin the log of a run in the file `out`.

    Raises:
        RunFailed: it cannot be written.
    """
    writer = RunWriter(
        out,
        codecs=stage.codecs,
        truth_names=stage.description.truth_names,
        truth_units=stage.description.truth_units,
        vehicles=stage.vehicles,
        metadata=stage.metadata(command_line),
        attachments=stage.attachments(),
    )
    return Recorder(writer, stage.codecs)


class Recorder:
    """Writes cycles in the order of the log: frames, truth, events.

    Once the log cannot be written any more, which raises `RunFailed`, nothing more is.
    """

    def __init__(self, writer: RunWriter, codecs: Mapping[str, Codec]) -> None:
        """Record to `writer`."""
        self._writer = writer
        self._codecs = codecs
        self._health_ids = {
            (bus, codec.can_id(name))
            for bus, codec in codecs.items()
            for name in codec.names
            if any(signal.name == _LOST for signal in codec.message(name).signals)
        }
        self._health: dict[tuple[str, int], bytes] = {}
        self._failed = False
        self._strays: set[tuple[str, int]] = set()

    def cycle(
        self,
        number: int,
        frames: Iterable[tuple[str, int, bytes]],
        truth: Iterable[Truth],
        strays: Iterable[tuple[str, int]],
        words: Sequence[tuple[str, str]],
    ) -> None:
        """Record one cycle.

        Args:
            number: its number.
            frames: bus, identifier and data of all its frames.
            truth: its truth rows.
            strays: bus and identifier of frames that should not have come; each is noted once a run.
            words: what processes have written to their standard error, each with its name.

        Raises:
            RunFailed: the log cannot be written.
        """
        with self._unless_failed() as writable:
            if writable:
                self._cycle(number, frames, truth, strays, words)

    def _cycle(
        self,
        number: int,
        frames: Iterable[tuple[str, int, bytes]],
        truth: Iterable[Truth],
        strays: Iterable[tuple[str, int]],
        words: Sequence[tuple[str, str]],
    ) -> None:
        write, health_ids = self._writer.frame, self._health_ids
        time_ns, received_ns = number * CYCLE_NS, time.time_ns()
        for bus, can_id, data in frames:
            write(bus, time_ns, can_id, data, received_ns)
            if (bus, can_id) in health_ids:
                self._note_health(bus, can_id, data, time_ns)
        for row in truth:
            self._writer.truth(row.vehicle, row.cycle * CYCLE_NS, row.values)
        for stray in strays:
            if stray not in self._strays:
                self._strays.add(stray)
                text = f"frame 0x{stray[1]:03X} on {stray[0]} is not due in the cycle it came in, or came twice"
                self.event(number, "warning", "conductor", text)
        for name, text in words:
            self.event(number, "warning", name, text)

    def event(self, cycle: int, level: str, source: str, text: str) -> None:
        """Record an event at the time of a cycle.

        Raises:
            RunFailed: the log cannot be written.
        """
        with self._unless_failed() as writable:
            if writable:
                self._writer.event(cycle * CYCLE_NS, level, source, text)

    def close(self, result: Mapping[str, str]) -> None:
        """Close the log with the run's result."""
        self._writer.close(result)

    def frames_lost(self) -> int:
        """Frames that plant and ECUs have reported as lost."""
        return self._sum(_LOST)

    def e2e_errors(self) -> int:
        """E2E errors that plant and ECUs have reported."""
        return self._sum(_ERRORS)

    @contextmanager
    def _unless_failed(self) -> Iterator[bool]:
        """Give whether the log can be written, and note where this is the end of that."""
        try:
            yield not self._failed
        except RunFailed:
            self._failed = True
            raise

    def _sum(self, signal: str) -> int:
        decoded = (self._codecs[bus].decode(can_id, data)[1] for (bus, can_id), data in self._health.items())
        return sum(int(values.get(signal, 0)) for values in decoded)

    def _note_health(self, bus: str, can_id: int, data: bytes, time_ns: int) -> None:
        before = self._health.get((bus, can_id))
        self._health[bus, can_id] = data
        if data == before or (before is None and not any(data)):
            return
        name, values = self._codecs[bus].decode(can_id, data)
        counts = ", ".join(f"{signal} {value:g}" for signal, value in values.items())
        self._writer.event(time_ns, "warning", bus, f"{name}: {counts}")
