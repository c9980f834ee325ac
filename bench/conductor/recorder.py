"""Passes complete cycles to the log and counts lost frames and E2E errors."""

import time
from collections.abc import Callable, Iterable, Mapping, Sequence

from bench import events
from bench.bus.codec import Codec
from bench.bus.control_channel import Truth
from bench.bus.frame import BusFrame
from bench.bus.wire.timing import BusTimeline
from bench.conductor.process_watch import ProcessWatch
from bench.conductor.stage import Stage
from bench.conductor.state_watch import StateWatch
from bench.cycle import CYCLE_NS
from bench.errors import RunFailed
from bench.record.writer import RunWriter

_LOST, _ERRORS = "FramesLost", "E2EErrors"


def open_recorder(stage: Stage, timeline: BusTimeline, watch: ProcessWatch, commit: str) -> "Recorder":
    """Begin the log of a run of this `commit`, its frames timed by `timeline`.

    Raises:
        RunFailed: it cannot be written.
    """
    writer = RunWriter(
        stage.options.out,
        codecs=stage.codecs,
        truth_names=stage.description.truth_names,
        truth_units=stage.description.truth_units,
        vehicles=stage.vehicles,
        metadata=stage.metadata(commit),
        attachments=stage.attachments(),
        timeline=timeline,
    )
    return Recorder(writer, stage.codecs, watch)


_COUNTS = (_LOST, _ERRORS)
"""The counters of the health messages; an increase means trouble."""


class Recorder:
    """Writes cycles in the order of the log: frames, truth, events.

    After a write error, which raises `RunFailed`, nothing more is written.

    Attributes:
        cpu_s: processor time in s that recording has taken.
    """

    def __init__(self, writer: RunWriter, codecs: Mapping[str, Codec], watch: ProcessWatch) -> None:
        """Record to `writer`, with the samples of `watch`."""
        self._writer = writer
        self._watch = watch
        self._codecs = codecs
        self._health_ids = {
            (bus, codec.can_id(name))
            for bus, codec in codecs.items()
            for name in codec.names
            if any(signal.name == _LOST for signal in codec.described(name).signals)
        }
        self._health: dict[tuple[str, int], bytes] = {}
        self._told: dict[tuple[str, int], dict[str, int]] = {}
        self._states = StateWatch(codecs)
        self._ids = {can_id for _, can_id in (*self._health_ids, *self._states.watched)}
        self._failed = False
        self.cpu_s = 0.0

    def cycle(
        self,
        number: int,
        frames: Iterable[BusFrame],
        due: Iterable[BusFrame],
        truth: Iterable[Truth],
        news: Iterable[events.Event],
        words: Sequence[events.Event],
        received_ns: Sequence[int] = (),
    ) -> None:
        """Record one cycle.

        Args:
            number: its number.
            frames: all its frames; also refused ones, which are not decoded here.
            due: of these the ones that were due.
            truth: its truth rows.
            news: events about refused frames.
            words: what processes have written or had noted.
            received_ns: arrival time of each frame (time.time_ns); if not given, now for all.

        Raises:
            RunFailed: the log cannot be written.
        """
        self._write(self._record_cycle, number * CYCLE_NS, frames, due, truth, (*news, *words), received_ns)

    def _record_cycle(
        self,
        time_ns: int,
        frames: Iterable[BusFrame],
        due: Iterable[BusFrame],
        truth: Iterable[Truth],
        told: Iterable[events.Event],
        received_ns: Sequence[int],
    ) -> None:
        writer = self._writer
        frames = list(frames)
        writer.frames(time_ns, frames, received_ns or [time.time_ns()] * len(frames))
        self._note_states(time_ns, due)
        for row in truth:
            writer.truth(row.vehicle, row.cycle * CYCLE_NS, row.values)
        for event in told:
            writer.event(time_ns, event)
        for name, usage in self._watch.samples():
            writer.process(name, time_ns, usage)

    def event(self, cycle: int, event: events.Event) -> None:
        """Record an event at the time of a cycle.

        Raises:
            RunFailed: the log cannot be written.
        """
        self._write(self._writer.event, cycle * CYCLE_NS, event)

    def close(self, result: Mapping[str, str]) -> None:
        """Close the log with the run's result."""
        self._writer.close(result)

    def frames_lost(self) -> int:
        """Frames that plant and ECUs have reported as lost."""
        return self._sum(_LOST)

    def e2e_errors(self) -> int:
        """E2E errors that plant and ECUs have reported."""
        return self._sum(_ERRORS)

    def _write(self, write: Callable[..., None], *arguments: object) -> None:
        """Call `write` unless the log cannot be written; note a write error, and the processor time used."""
        if self._failed:
            return
        begun_s = time.thread_time()
        try:
            write(*arguments)
        except RunFailed:
            self._failed = True
            raise
        finally:
            self.cpu_s += time.thread_time() - begun_s

    def _sum(self, signal: str) -> int:
        decoded = (self._codecs[bus].decode(can_id, data)[1] for (bus, can_id), data in self._health.items())
        return sum(int(values.get(signal, 0)) for values in decoded)

    def _note_states(self, time_ns: int, due: Iterable[BusFrame]) -> None:
        """Record changes of the senders' states and counters in due frames as events."""
        ids = self._ids
        found = [frame for frame in due if frame[1] in ids and self._is_changed(*frame)]
        # Sorted, so that the order of events does not depend on the order of arrival.
        found.sort()
        for bus, can_id, data in found:
            if (bus, can_id) in self._health_ids:
                self._note_health(bus, can_id, data, time_ns)
            else:
                for change in self._states.changes(bus, can_id, data):
                    self._writer.event(time_ns, change)

    def _is_changed(self, bus: str, can_id: int, data: bytes) -> bool:
        """Return whether a frame of the identifiers `_ids` may have another state or counter than the one before."""
        if (bus, can_id) in self._health_ids:
            return data != self._health.get((bus, can_id))
        return self._states.is_changed(bus, can_id, data)

    def _note_health(self, bus: str, can_id: int, data: bytes, time_ns: int) -> None:
        self._health[bus, can_id] = data
        name, counts = self._counts(bus, can_id, data)
        if counts != self._told.get((bus, can_id), dict.fromkeys(_COUNTS, 0)):
            self._told[bus, can_id] = counts
            self._writer.event(time_ns, events.ReceptionErrors(bus, name, counts[_LOST], counts[_ERRORS]))

    def _counts(self, bus: str, can_id: int, data: bytes) -> tuple[str, dict[str, int]]:
        """Return name and counters of a health message, without its reception states, which vary."""
        name, values = self._codecs[bus].decode(can_id, data)
        return name, {signal: int(values.get(signal, 0)) for signal in _COUNTS}
