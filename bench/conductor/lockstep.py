"""The lockstep clock: a cycle begins when all frames of the one before have arrived.

BenchSync is sent as soon as a cycle is complete; that cycle is recorded while the others work on the next one. Virtual
time does not pass by itself, so the conductor announces the absent frames of a dead or stopped ECU.
"""

import time
from collections.abc import Sequence
from typing import TYPE_CHECKING

from bench.bus.absence import BENCH_ABSENT
from bench.bus.control_channel import Truth
from bench.bus.frame import BusFrame, CanFrame
from bench.bus.states import BenchCommand
from bench.conductor.conducting import PROGRESS_CYCLES, Conductor, Means, OnProgress
from bench.conductor.crew import Crew, Ended
from bench.conductor.cycle import CycleFrames, frames_due
from bench.cycle import time_of
from bench.errors import RunFailed
from bench.events import EcuFailed

if TYPE_CHECKING:  # the recorder is imported while the processes start
    from bench.conductor.recorder import Recorder

SPOILED_S = 0.1
"""Wall-clock time in s without a due frame after which one received with a wrong CRC counts as the due one."""


class Lockstep(Conductor):
    """Conducts a run cycle by cycle: `cycle` is under way, those before it are complete."""

    def __init__(self, means: Means) -> None:
        """Conduct with `means`; no cycle has begun."""
        super().__init__(means)
        due = frames_due(means.codecs, means.vehicles)
        self._frames = CycleFrames(due, means.codecs, means.desk.plan, self._refusals)
        self._truth: list[Truth] = []
        self._sent: list[BusFrame] = []
        self._failures: list[EcuFailed] = []
        self._cycles = 0
        self._wall_s = 0.0

    @property
    def cycles(self) -> int:
        """See `Conductor`; those that are complete."""
        return self._cycles

    @property
    def wall_s(self) -> float:
        """See `Conductor`; the newest cycle that is complete."""
        return self._wall_s

    def run(self, crew: Crew, recorder: "Recorder", cycles: int, on_progress: OnProgress | None) -> None:
        """See `Conductor`."""
        started = time.perf_counter()
        self._open(crew, recorder)
        while True:
            self._await_complete(crew)
            self._wall_s = time.perf_counter() - started
            self._cycles = self.cycle + 1
            frames, truth = [*self._sent, *self._frames.ordered()], self._truth
            due, news, words = self._frames.due, self._refusals.news(), self._words
            failures, self._failures = self._failures, []
            self._truth, self._words = [], []
            last = self.cycles == cycles
            done, self.cycle = self.cycle, self.cycle + 1
            # First, so that the nodes have work while this cycle is recorded.
            if last:
                self._sent = self._sync(BenchCommand.STOP, self.cycle)
            else:
                self._open(crew, recorder)
            recorder.cycle(done, frames, due, truth, news, words)
            for failure in failures:
                recorder.event(done, failure)
            if on_progress is not None and (last or done % PROGRESS_CYCLES == 0):
                on_progress(time_of(self.cycle))
            if last:
                recorder.cycle(self.cycle, self._sent, (), (), (), ())
                return

    def stop(self) -> None:
        """See `Conductor`."""
        # The cycle after the newest one that has begun.
        self._sync(BenchCommand.STOP, self._frames.number + 1)

    @property
    def awaited(self) -> str | None:
        """See `Listener`."""
        return self._frames.awaited

    def frames(self, bus: str, frames: Sequence[CanFrame]) -> bool:
        """See `Listener`."""
        if self._frames.number < 0:
            return self._before(bus, frames)
        return self._frames.take(bus, self._free.without_signs(bus, frames))

    def truth(self, row: Truth) -> None:
        """See `Listener`."""
        self._truth.append(row)

    def record_rest(self, recorder: "Recorder") -> None:
        """See `Conductor`."""
        frames, news = list(self._frames.ordered()), self._refusals.news()
        recorder.cycle(self.cycle, frames, self._frames.due, self._truth, news, self._words)
        self._truth, self._words = [], []

    def _open(self, crew: Crew, recorder: "Recorder") -> None:
        """Begin the cycle: apply its faults, send BenchSync, announce absent frames."""
        self._desk.open(self.cycle, recorder)
        self._outages.apply(self.cycle, crew)
        self._frames.begin(self.cycle)
        self._sent = self._sync(BenchCommand.RUN, self.cycle)
        for name in self._outages.absent:
            self._announce_absent([name])

    def _announce_absent(self, senders: Sequence[str]) -> None:
        for due in self._frames.missing():
            if due.sender in senders:
                self._give_up(due.bus, due.can_id)

    def _give_up(self, bus: str, can_id: int) -> None:
        self._sent.append(self._send(bus, BENCH_ABSENT, {"Identifier": can_id, "Cycle": self.cycle}, self.cycle))
        self._frames.give_up(bus, can_id)

    def _await_complete(self, crew: Crew) -> None:
        when = self._when()
        while not self._frames.complete:
            hopeless = self._frames.hopeless if self._frames.spoiled else []
            patience = SPOILED_S if hopeless else self._silence_s
            try:
                heard = crew.attend(patience)
            except Ended as error:
                if not self._goes_on_without(error.names, crew, f"{when} {error}"):
                    raise Ended(f"{when} {error}", error.names) from error
                continue
            if heard or self._frames.complete:
                continue
            if hopeless:
                for bus, can_id in hopeless:
                    self._give_up(bus, can_id)
                continue
            guilty = self._frames.guilty(crew.inputs)
            text = f"{when} {self._frames.silent(guilty)}; no due frame was received for {self._silence_s:g} s"
            text += self._losses(crew)
            if not self._goes_on_without(guilty, crew, text):
                raise RunFailed(text)

    def _goes_on_without(self, names: Sequence[str], crew: Crew, text: str) -> bool:
        """Continue without ECUs that have failed if the run can; return whether it does."""
        failure = self._leave_out(names, crew, text)
        if failure is None:
            return False
        self._failures.append(failure)
        self._announce_absent(names)
        return True
