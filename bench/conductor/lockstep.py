"""The lockstep clock: a cycle is opened when all frames of the one before have come.

BenchSync goes out as soon as a cycle is complete; that cycle is recorded while the others work on the next one.
"""

import time
from collections.abc import Callable, Mapping, Sequence

from bench.bus.base import Link
from bench.bus.codec import Codec
from bench.bus.inbox import BENCH_SYNC, RUN, STOP
from bench.bus.ties import Truth
from bench.bus.topic import CYCLE_MS
from bench.conductor.crew import Crew, Ended
from bench.conductor.cycle import CycleFrames, frames_due
from bench.conductor.recorder import Recorder
from bench.errors import RunFailed

PROGRESS_CYCLES = 10
"""Cycles between two calls of the progress function."""


class Lockstep:
    """Conducts a run cycle by cycle. It is the crew's `Listener`.

    Attributes:
        cycle: number of the cycle under way.
        cycles: how many are complete.
        wall_s: wall-clock time in s from the first BenchSync to the end of the newest complete cycle.
    """

    def __init__(self, links: Mapping[str, Link], codecs: Mapping[str, Codec], vehicles: int, silence_s: float) -> None:
        """Conduct over `links` (by bus name), waiting at most `silence_s` s of wall-clock time for a frame."""
        self._links = links
        self._codecs = codecs
        self._silence_s = silence_s
        self._frames = CycleFrames(frames_due(codecs, vehicles))
        self._truth: list[Truth] = []
        self._words: list[tuple[str, str]] = []
        self.cycle = 0
        self.cycles = 0
        self.wall_s = 0.0

    @property
    def time_s(self) -> float:
        """Simulated time in s of the cycle under way."""
        return self.cycle * CYCLE_MS / 1000

    def run(self, crew: Crew, recorder: Recorder, cycles: int, on_progress: Callable[[float], None] | None) -> None:
        """Conduct `cycles` cycles, then stop the nodes.

        Args:
            crew: does the work.
            recorder: takes every complete cycle.
            cycles: how many.
            on_progress: called now and then with the simulated time in s.

        Raises:
            RunFailed: a process ended or fell silent; the message names it and the time.
            Interrupted: a signal has come.
        """
        started = time.perf_counter()
        self._frames.begin(0)
        sync = self._sync(RUN, 0)
        while True:
            self._await_complete(crew)
            self.wall_s = time.perf_counter() - started
            self.cycles = self.cycle + 1
            frames, truth = [*sync, *self._frames.ordered()], self._truth
            strays, words = self._frames.strays, self._words
            self._truth, self._words = [], []
            last = self.cycles == cycles
            done, self.cycle = self.cycle, self.cycle + 1
            self._frames.begin(self.cycle)
            # First of all, so that the nodes have work while this cycle is recorded.
            sync = self._sync(STOP if last else RUN, self.cycle)
            recorder.cycle(done, frames, truth, strays, words)
            if on_progress is not None and (last or done % PROGRESS_CYCLES == 0):
                on_progress(self.time_s)
            if last:
                recorder.cycle(self.cycle, sync, (), (), ())
                return

    def stop(self) -> None:
        """Tell the nodes to stop, before the end of the run."""
        self._sync(STOP, self.cycle)

    def frames(self, bus: str, frames: Sequence[tuple[int, bytes]]) -> None:
        """See `Listener`."""
        self._frames.take(bus, frames)

    def truth(self, row: Truth) -> None:
        """See `Listener`."""
        self._truth.append(row)

    def words(self, name: str, text: str) -> None:
        """See `Listener`."""
        self._words.append((name, text))

    def record_rest(self, recorder: Recorder) -> None:
        """Record what has come of a cycle that was not completed."""
        recorder.cycle(self.cycle, list(self._frames.ordered()), self._truth, self._frames.strays, self._words)
        self._truth, self._words = [], []

    def _sync(self, command: int, cycle: int) -> list[tuple[str, int, bytes]]:
        """Send BenchSync on all buses; return the frames, for the log."""
        values = {"Command": command, "Cycle": cycle, "Time": cycle * CYCLE_MS / 1000}
        sent = []
        for bus, link in self._links.items():
            can_id, data = self._codecs[bus].encode(BENCH_SYNC, values, cycle)
            link.send(can_id, data)
            sent.append((bus, can_id, data))
        return sent

    def _await_complete(self, crew: Crew) -> None:
        when = f"in cycle {self.cycle} (t = {self.time_s:.2f} s)"
        while not self._frames.complete:
            try:
                heard = crew.attend(self._silence_s)
            except Ended as error:
                raise Ended(f"{when} {error}") from error
            if not heard and not self._frames.complete:
                silent = self._frames.silent(crew.inputs)
                raise RunFailed(f"{when} {silent}; nothing was heard for {self._silence_s:g} s")
