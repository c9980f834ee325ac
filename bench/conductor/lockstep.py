"""The lockstep clock: a cycle is opened when all frames of the one before have come.

BenchSync goes out as soon as a cycle is complete; that cycle is recorded while the others work on the next one. Time is
virtual and does not pass by itself, so for an ECU that is dead or stopped the conductor announces that its frames will
not come.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING

from bench.bus.codec import Codec
from bench.bus.inbox import BENCH_SYNC
from bench.bus.link.base import Link
from bench.bus.outbox import BENCH_ABSENT
from bench.bus.states import BenchCommand
from bench.bus.ties import Truth
from bench.conductor.crew import Crew, Ended
from bench.conductor.cycle import CycleFrames, frames_due
from bench.conductor.fault_desk import FaultDesk
from bench.conductor.free_slots import FreeSlots
from bench.conductor.outages import Outages
from bench.cycle import time_of
from bench.errors import RunFailed
from bench.events import EcuFailed
from bench.faults.plan import FaultPlan
from bench.names import PLANT

if TYPE_CHECKING:  # the recorder's imports take place while the processes start
    from bench.conductor.recorder import Recorder

PROGRESS_CYCLES = 10
"""Cycles between two calls of the progress function."""

SPOILED_S = 0.1
"""Wall-clock time in s without a frame after which one that came with a wrong CRC is taken to have been the one due."""

Sent = list[tuple[str, int, bytes]]


class Lockstep:
    """Conducts a run cycle by cycle. It is the crew's `Listener`.

    Attributes:
        cycle: number of the cycle under way.
        cycles: how many are complete.
        wall_s: wall-clock time in s from the first BenchSync to the end of the newest complete cycle.
    """

    def __init__(
        self,
        links: Mapping[str, Link],
        codecs: Mapping[str, Codec],
        vehicles: int,
        silence_s: float,
        desk: FaultDesk,
        free: FreeSlots,
        *,
        go_on: bool = False,
    ) -> None:
        """Conduct over `links` (by bus name).

        Args:
            links: the conductor's ends of the buses.
            codecs: codec of every bus.
            vehicles: how many.
            silence_s: longest wall-clock time in s without a frame.
            desk: where faults are taken in.
            free: the slots of ECUs that somebody starts by hand.
            go_on: whether the run goes on without an ECU that has failed.
        """
        self._links = links
        self._codecs = codecs
        self._silence_s = silence_s
        self._desk = desk
        self._free = free
        self._plan: FaultPlan = desk.plan
        self._outages = Outages(self._plan)
        self._go_on = go_on
        self._frames = CycleFrames(frames_due(codecs, vehicles), codecs, self._plan)
        self._truth: list[Truth] = []
        self._words: list[tuple[str, str]] = []
        self._sent: Sent = []
        self._failures: list[EcuFailed] = []
        self.cycle = 0
        self.cycles = 0
        self.wall_s = 0.0

    @property
    def time_s(self) -> float:
        """Simulated time in s of the cycle under way."""
        return time_of(self.cycle)

    def run(self, crew: Crew, recorder: "Recorder", cycles: int, on_progress: Callable[[float], None] | None) -> None:
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
        self._open(crew, recorder)
        while True:
            self._await_complete(crew)
            self.wall_s = time.perf_counter() - started
            self.cycles = self.cycle + 1
            frames, truth = [*self._sent, *self._frames.ordered()], self._truth
            strays, words = self._frames.strays, self._words
            failures, self._failures = self._failures, []
            self._truth, self._words = [], []
            last = self.cycles == cycles
            done, self.cycle = self.cycle, self.cycle + 1
            # First of all, so that the nodes have work while this cycle is recorded.
            if last:
                self._sent = self._sync(BenchCommand.STOP, self.cycle)
            else:
                self._open(crew, recorder)
            recorder.cycle(done, frames, truth, strays, words)
            for failure in failures:
                recorder.event(done, failure)
            if on_progress is not None and (last or done % PROGRESS_CYCLES == 0):
                on_progress(self.time_s)
            if last:
                recorder.cycle(self.cycle, self._sent, (), (), ())
                return

    def stop(self) -> None:
        """Tell the nodes to stop, before the end of the run."""
        self._sync(BenchCommand.STOP, self.cycle)

    def frames(self, bus: str, frames: Sequence[tuple[int, bytes]]) -> None:
        """See `Listener`."""
        if self._frames.number < 0:
            self._free.note(bus, frames)
            return
        self._frames.take(bus, self._free.without_signs(bus, frames))

    def truth(self, row: Truth) -> None:
        """See `Listener`."""
        self._truth.append(row)

    def words(self, name: str, text: str) -> None:
        """See `Listener`."""
        self._words.append((name, text))

    def record_rest(self, recorder: "Recorder") -> None:
        """Record what has come of a cycle that was not completed."""
        recorder.cycle(self.cycle, list(self._frames.ordered()), self._truth, self._frames.strays, self._words)
        self._truth, self._words = [], []

    def _open(self, crew: Crew, recorder: "Recorder") -> None:
        """Open the cycle: bring about its faults, send BenchSync, announce what will not come."""
        self._desk.open(self.cycle, recorder)
        self._outages.apply(self.cycle, crew)
        self._frames.begin(self.cycle)
        self._sent = self._sync(BenchCommand.RUN, self.cycle)
        for name in self._outages.absent:
            self._announce_absent([name])

    def _sync(self, command: BenchCommand, cycle: int) -> Sent:
        """Send BenchSync on all buses; return the frames, for the log."""
        values = {"Command": command, "Cycle": cycle, "Time": time_of(cycle)}
        return [self._send(bus, BENCH_SYNC, values) for bus in self._links]

    def _send(self, bus: str, message: str, values: Mapping[str, float]) -> tuple[str, int, bytes]:
        can_id, data = self._codecs[bus].encode(message, values, self.cycle)
        self._links[bus].send(can_id, data)
        return bus, can_id, data

    def _announce_absent(self, senders: Sequence[str]) -> None:
        for due in self._frames.missing():
            if due.sender in senders:
                self._give_up(due.bus, due.can_id)

    def _give_up(self, bus: str, can_id: int) -> None:
        self._sent.append(self._send(bus, BENCH_ABSENT, {"Identifier": can_id, "Cycle": self.cycle}))
        self._frames.give_up(bus, can_id)

    def _await_complete(self, crew: Crew) -> None:
        when = f"in cycle {self.cycle} (t = {self.time_s:.2f} s)"
        while not self._frames.complete:
            spoiled = self._frames.spoiled
            patience = SPOILED_S if spoiled else self._silence_s
            try:
                heard = crew.attend(patience)
            except Ended as error:
                if not self._goes_on_without(error.names, crew, f"{when} {error}"):
                    raise Ended(f"{when} {error}", error.names) from error
                continue
            if heard or self._frames.complete:
                continue
            if spoiled:
                for bus, can_id in sorted(spoiled):
                    self._give_up(bus, can_id)
                continue
            guilty = self._frames.guilty(crew.inputs)
            text = f"{when} {self._frames.silent(guilty)}; nothing was heard for {self._silence_s:g} s"
            if not self._goes_on_without(guilty, crew, text):
                raise RunFailed(text)

    def _goes_on_without(self, names: Sequence[str], crew: Crew, text: str) -> bool:
        """Whether the run goes on without ECUs that have failed; if so, sees to it."""
        if not self._go_on or not names or PLANT in names:
            return False
        for name in names:
            self._outages.failed(name, crew)
        self._failures.append(EcuFailed(names, text))
        self._announce_absent(names)
        return True
