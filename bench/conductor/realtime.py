"""The conductor of a real-time run: it receives, records and checks deadlines, but no node waits for it.

The wall clock is a separate process (`clock`). In cycle k the plant publishes at BenchSync k, the ECUs have until
BenchSync k+1 for their commands, and the plant applies the commands received by then. Later ones have missed their
deadline: the actuators hold, and after the DBC's timeout enter their safe state.

A frame belongs to the cycle given by its alive counter, late or not; one without a counter to that of its sender's
newest frame with one; one that is refused (damaged, repeated, later than `SETTLE_CYCLES`, of nobody) to the cycle in
which it arrived. The log has that cycle's time, and the kernel's time of receipt.
"""

import os
import time
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

from bench import events
from bench.bus.control_channel import Truth
from bench.bus.e2e import COUNTER_MODULUS
from bench.bus.frame import BusFrame, CanFrame, RefusedFrame
from bench.bus.states import BenchCommand
from bench.bus.sync import BENCH_SYNC, read_sync
from bench.conductor.clock import CLOCK, PRIORITY
from bench.conductor.conducting import PROGRESS_CYCLES, Conductor, Means, OnProgress
from bench.conductor.crew import Crew, Ended
from bench.conductor.cycle import frames_due
from bench.conductor.linux import pin, real_time, set_real_time
from bench.conductor.linux import stolen_s as stolen_s_so_far
from bench.cycle import CYCLE_NS, CYCLE_S, time_of
from bench.errors import RunFailed
from bench.events import Refusal
from bench.faults.plan import is_off
from bench.names import PLANT, V2V

if TYPE_CHECKING:  # the recorder is imported while the processes start
    from bench.conductor.recorder import Recorder


PRIORITIES = {CLOCK: PRIORITY, PLANT: 70, "planner": 60, "tracker": 50}
"""SCHED_FIFO priority by role: higher if more nodes wait for it. An ECU of another role has the lowest of them."""

RECORDER_PRIORITY = 10
"""SCHED_FIFO priority of the conductor, which only records: below the bench's others, above all other programs."""

REST_NS = 7_500_000
"""Time for which the conductor sleeps in each cycle."""

SETTLE_CYCLES = 2
"""Number of cycles for which a cycle stays open for late frames before it is checked and recorded."""

EARLY_CYCLES = 10
"""Number of cycles by which BenchSync may be early: the first one may have come late."""

_POLL_S = 0.01


class _Received(NamedTuple):
    """A frame, and when it was received (ns)."""

    received_ns: int
    frame: BusFrame


@dataclass
class _Cycle:
    """The data received of a cycle.

    Attributes:
        frames: the frames received; also refused ones.
        due: of these the ones that were due.
        begun: arrival of its BenchSync, by bus (ns).
        done: arrival of each sender's newest frame with a counter, by name (ns).
        seen: identifiers of the due frames, by bus.
        truth: its truth rows.
    """

    frames: list[_Received] = field(default_factory=list)
    due: list[BusFrame] = field(default_factory=list)
    begun: dict[str, int] = field(default_factory=dict)
    done: dict[str, int] = field(default_factory=dict)
    seen: dict[str, set[int]] = field(default_factory=lambda: defaultdict(set))
    truth: list[Truth] = field(default_factory=list)


class _Expected(NamedTuple):
    """A frame of every cycle.

    Attributes:
        sender: its sender: an ECU, or the plant on one bus (veh1.plant).
        protected: whether it has a CRC and an alive counter.
    """

    sender: str
    protected: bool


class Realtime(Conductor):
    """Conducts a run on the wall clock: `cycle` is the newest that has begun, -1 before the first."""

    def __init__(self, means: Means) -> None:
        """Conduct with `means`; `silence_s` holds for the clock, and for each ECU that no fault has silenced."""
        super().__init__(means)
        codecs = means.codecs
        due = frames_due(codecs, means.vehicles)
        self._sync_ids = {bus: codec.can_id(BENCH_SYNC) for bus, codec in codecs.items()}
        self._expected = {
            bus: {can_id: _Expected(each.station, each.protected) for can_id, each in frames.items()}
            for bus, frames in due.items()
        }
        self._senders = {
            each.station: bus for bus, every in due.items() for each in every.values() if each.has_deadline
        }
        self._open: dict[int, _Cycle] = defaultdict(_Cycle)
        # By bus: the conductor reads one after the other, and may be behind on all of them.
        self._newest = dict.fromkeys(codecs, -1)
        self._at: dict[tuple[str, str], int] = {}
        self._has_clock = False
        self._prepared = -1
        self._first_ns = 0
        self._in_a_row: dict[str, int] = dict.fromkeys(self._senders, 0)
        self._plant_silent = 0
        self._pids: dict[str, int] = {}
        self.cycle = -1
        self.misses = dict.fromkeys(self._senders, 0)
        for link in means.links.values():
            link.keep_times()

    @property
    def cycles(self) -> int:
        """See `Conductor`; those that have begun."""
        return self.cycle + 1

    @property
    def wall_s(self) -> float:
        """See `Conductor`."""
        newest = self._open[self.cycle].begun.get(V2V, self._first_ns) if self.cycle in self._open else self._first_ns
        return (newest - self._first_ns + CYCLE_NS) / 1e9 if self.cycle >= 0 else 0.0

    def run(self, crew: Crew, recorder: "Recorder", cycles: int, on_progress: OnProgress | None) -> None:
        """See `Conductor`; the clock's process is started first."""
        stolen_s = stolen_s_so_far()
        with real_time(RECORDER_PRIORITY):
            self._run(crew, recorder, cycles, on_progress)
        stolen_s = stolen_s_so_far() - stolen_s
        if stolen_s > 0.0:
            stolen = events.StolenTime(stolen_s)
            self.scheduling += f"; {stolen.text}"
            recorder.event(self.cycle, stolen)

    def _run(self, crew: Crew, recorder: "Recorder", cycles: int, on_progress: OnProgress | None) -> None:
        self._has_clock = True
        crew.restart(CLOCK)
        self._schedule(crew, recorder)
        end_at: float | None = None
        heard_at = time.monotonic()
        while end_at is None or time.monotonic() < end_at:
            self._rest()
            if self._attend(crew, recorder):
                heard_at = time.monotonic()
            elif time.monotonic() - heard_at > self._silence_s:
                raise RunFailed(f"{self._when()} no frame came for {self._silence_s:g} s, not even from the clock")
            self._keep_up(crew, recorder, min(self._newest.values()) - SETTLE_CYCLES, on_progress)
            if end_at is None and self.cycles >= cycles:
                # The last cycle gets its full time like all others, and late frames are awaited as well.
                end_at = time.monotonic() + SETTLE_CYCLES * CYCLE_S
        sent = self._sync(BenchCommand.STOP, self.cycles)
        self._keep_up(crew, recorder, self.cycle, on_progress)
        if self._plant_silent >= self.cycles:
            raise RunFailed(f"the {PLANT} has met no deadline in the whole run")
        recorder.cycle(self.cycles, sent, (), (), (), ())
        if on_progress is not None:
            on_progress(time_of(self.cycles))

    def stop(self) -> None:
        """See `Conductor`; the clock stops too."""
        self._sync(BenchCommand.STOP, self.cycles)

    def frames(self, bus: str, frames: Sequence[CanFrame]) -> bool:
        """See `Listener`."""
        times = self._links[bus].times
        if times is None:
            times = [time.time_ns()] * len(frames)
        sync_id = self._sync_ids[bus]
        waited = False
        for frame, received in zip(frames, times, strict=True):
            can_id, data = frame
            if self._free.is_sign(bus, frame):
                waited |= self._free.note(bus, [frame])
                continue
            number = self._begin(bus, data, received) if can_id == sync_id else None
            if number is None:
                if self.cycle < 0:
                    waited |= self._before(bus, [frame])
                    continue
                number = self._due_in(bus, frame, received)
                if number is None:
                    continue
            waited = True
            self._open[number].frames.append(_Received(received, BusFrame(bus, can_id, data)))
        return waited

    def truth(self, row: Truth) -> None:
        """See `Listener`."""
        self._open[row.cycle].truth.append(row)

    def record_rest(self, recorder: "Recorder") -> None:
        """See `Conductor`."""
        for number in sorted(self._open):
            self._record(number, recorder)

    def _begin(self, bus: str, data: bytes, received: int) -> int | None:
        """Begin the cycle of the clock's BenchSync; return its number, None if this one is not the clock's."""
        sync = read_sync(self._codecs[bus].layout(BENCH_SYNC), data)
        if sync is None or not sync.realtime or not self._has_clock:
            return None
        number = sync.cycle
        if not self._desk.plan.has_opened(number, realtime=True):
            return None
        # The clock begins with 0, and is never early; some may have been lost.
        latest = (received - self._first_ns) // CYCLE_NS + EARLY_CYCLES if self.cycle >= 0 else 0
        if number > max(latest, self._newest[bus] + 1) or not self._lacks_sync(number, bus):
            return None
        if self.cycle < 0:
            self._first_ns = received
        if number > self.cycle:
            self.cycle = number
            self._refusals.begin_cycle()
        self._newest[bus] = max(self._newest[bus], number)
        self._open[number].begun[bus] = received
        return number

    def _lacks_sync(self, number: int, bus: str) -> bool:
        """Return whether a cycle is open and has no BenchSync on a bus yet; a stranger's may come before it."""
        if number in self._open:
            return bus not in self._open[number].begun
        return number > self._newest[bus] - SETTLE_CYCLES

    def _due_in(self, bus: str, frame: CanFrame, received: int) -> int | None:
        """Return the number of the cycle in which a frame is due, and note its sender; else refuse it."""
        can_id, data = frame
        why = self._refusals.flaw(bus, can_id, data)
        number = self._cycle_of(bus, can_id, data, received) if why is None else None
        if number is not None:
            self._open[number].due.append(BusFrame(bus, can_id, data))
            return number
        if why is None:
            why = Refusal.IMPLAUSIBLE if can_id == self._sync_ids[bus] else Refusal.NOT_DUE
        if self._refusals.refuse(bus, frame, why):
            now = max(self._newest[bus], 0)
            self._open[now].frames.append(_Received(received, RefusedFrame(bus, can_id, data)))
        return None

    def _cycle_of(self, bus: str, can_id: int, data: bytes, received: int) -> int | None:
        """Return the number of the cycle in which a whole frame is due, and note its sender; None if in none."""
        expected = self._expected[bus].get(can_id)
        if expected is None:
            return None
        place, newest = (bus, expected.sender), max(self._newest[bus], 0)
        if expected.protected:
            number = newest - (newest - (data[1] & 0x0F)) % COUNTER_MODULUS
        else:
            number = self._at.get(place, newest)
            if not self._has_room(number, bus, can_id):
                number = newest
        if not self._has_room(number, bus, can_id):
            return None
        cycle = self._open[number]
        cycle.seen[bus].add(can_id)
        if expected.protected:
            cycle.done[expected.sender] = received
            self._at[place] = number
        return number

    def _has_room(self, number: int, bus: str, can_id: int) -> bool:
        """Return whether a cycle is still open, and does not have a frame of this identifier yet."""
        return number >= max(0, self._newest[bus] - SETTLE_CYCLES) and can_id not in self._open[number].seen[bus]

    def _rest(self) -> None:
        """Wait for the part of a cycle in which the others have least to do.

        Reading every frame on arrival would take more time in total, and slow the others: two threads of a core
        slow each other down.
        """
        into_cycle = (time.time_ns() - self._first_ns) % CYCLE_NS
        if self.cycle >= 0 and into_cycle < REST_NS:
            time.sleep((REST_NS - into_cycle) / 1e9)

    def _attend(self, crew: Crew, recorder: "Recorder") -> bool:
        try:
            return crew.attend(min(_POLL_S, self._silence_s))
        except Ended as error:
            text = f"{self._when()} {error}"
            if not self._goes_on_without(error.names, crew, recorder, text):
                raise Ended(text, error.names) from error
            return True

    def _keep_up(self, crew: Crew, recorder: "Recorder", newest: int, on_progress: OnProgress | None) -> None:
        """Apply the faults of the cycles that have begun; check and record those up to `newest`."""
        while self._prepared < self.cycle:
            self._prepared += 1
            self._desk.open(self._prepared, recorder)
            self._outages.apply(self._prepared, crew)
            self._schedule(crew, recorder)
            if on_progress is not None and self._prepared % PROGRESS_CYCLES == 0:
                on_progress(time_of(self._prepared))
        for number in sorted(number for number in self._open if number <= newest):
            if self._open[number].begun:
                self._judge(number, crew, recorder)
            self._record(number, recorder)

    def _record(self, number: int, recorder: "Recorder") -> None:
        cycle = self._open[number]
        if number != self.cycle:
            del self._open[number]
        ordered = sorted(cycle.frames)
        cycle.frames = []
        truth, cycle.truth = cycle.truth, []
        words, self._words = self._words, []
        due, cycle.due = cycle.due, []
        frames = [each.frame for each in ordered]
        news, received_ns = self._refusals.news(), [each.received_ns for each in ordered]
        recorder.cycle(number, frames, due, truth, news, words, received_ns)

    def _judge(self, number: int, crew: Crew, recorder: "Recorder") -> None:
        """Note the nodes that have missed the end of a cycle."""
        cycle, following = self._open[number], self._open.get(number + 1)
        absent = self._outages.absent
        for name, bus in self._senders.items():
            if name in absent:
                self._in_a_row[name] = 0
                continue
            end = following.begun.get(bus) if following else None
            if end is None:
                end = cycle.begun.get(bus, self._first_ns + number * CYCLE_NS) + CYCLE_NS
            done = cycle.done.get(name)
            if done is not None and done <= end:
                if self._in_a_row[name]:
                    recorder.event(number, events.DeadlineMet(name, self._in_a_row[name]))
                    self._in_a_row[name] = 0
                continue
            self.misses[name] += 1
            self._in_a_row[name] += 1
            if self._in_a_row[name] == 1:
                late_ms = None if done is None else (done - end) / 1e6
                recorder.event(number, events.DeadlineMissed(name, late_ms))
            if time_of(self._in_a_row[name]) > self._silence_s and not name.endswith(f".{PLANT}"):
                text = f"{self._when()} {name} has met no deadline for {self._silence_s:g} s"
                if not self._goes_on_without([name], crew, recorder, text):
                    raise RunFailed(text)
        self._judge_plant(number)

    def _judge_plant(self, number: int) -> None:
        """Note whether the plant has met no deadline of a cycle on any bus, although no fault kept it from one.

        Raises:
            RunFailed: that has lasted too long.
        """
        faults = self._desk.plan.at(number)
        plants = [(name, bus) for name, bus in self._senders.items() if name.endswith(f".{PLANT}")]
        silent = all(self._in_a_row[name] and not is_off(name, bus, faults) for name, bus in plants)
        self._plant_silent = self._plant_silent + 1 if silent else 0
        if time_of(self._plant_silent) > self._silence_s:
            raise RunFailed(f"{self._when()} the {PLANT} has met no deadline for {self._silence_s:g} s")

    def _goes_on_without(self, names: Sequence[str], crew: Crew, recorder: "Recorder", text: str) -> bool:
        """Continue without ECUs that have failed if the run can; return whether it does."""
        failure = self._leave_out(names, crew, text)
        if failure is not None:
            recorder.event(max(self.cycle, 0), failure)
        return failure is not None

    def _schedule(self, crew: Crew, recorder: "Recorder") -> None:
        """Set the priority of new processes, and give each a core to itself if there are enough."""
        pids = crew.pids
        new = {name: pid for name, pid in pids.items() if self._pids.get(name) != pid}
        if not new:
            return
        self._pids = dict(pids)
        lowest = min(PRIORITIES.values())
        granted = [set_real_time(pid, PRIORITIES.get(name.rpartition(".")[2], lowest)) for name, pid in new.items()]
        cores = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []
        alone = len(cores) > len(pids)
        if alone:
            # The first core is left to the conductor and to other programs.
            for core, name in zip(cores[1:], sorted(pids), strict=False):
                pin(pids[name], {core})
        if self.scheduling:
            return
        scheduling = events.Scheduling(all(granted), alone, len(pids), len(cores))
        self.scheduling = scheduling.text
        recorder.event(0, scheduling)
