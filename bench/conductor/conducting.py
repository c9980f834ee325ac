"""The common part of both conductors, lockstep and real time."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from bench.bus.codec import Codec
from bench.bus.control_channel import Truth
from bench.bus.frame import BusFrame, CanFrame
from bench.bus.link.base import Link
from bench.bus.states import BenchCommand
from bench.bus.sync import BENCH_SYNC
from bench.conductor.clock import CLOCK
from bench.conductor.crew import Crew
from bench.conductor.fault_desk import FaultDesk
from bench.conductor.free_slots import FreeSlots
from bench.conductor.linux import dropped_datagrams
from bench.conductor.outages import Outages
from bench.conductor.refusals import Refusals
from bench.cycle import time_of
from bench.events import EcuFailed, EcuNote, Event, FramesRefused, ProcessOutput, Refusal
from bench.names import CONDUCTOR, PLANT

if TYPE_CHECKING:  # the recorder is imported while the processes start
    from bench.conductor.recorder import Recorder

PROGRESS_CYCLES = 10
"""Cycles between two calls of the progress function."""

_NEEDED = frozenset((PLANT, CLOCK))
"""Processes without which no run can continue."""

OnProgress = Callable[[float], None]
"""Called periodically with the simulated time in s."""


@dataclass(frozen=True)
class Means:
    """What a conductor works with.

    Attributes:
        links: its ends of the buses, by name.
        codecs: codec of every bus.
        vehicles: number of vehicles.
        silence_s: longest wall-clock time in s without a frame that is due.
        desk: receives faults.
        free: the slots of ECUs started by hand.
        go_on: whether the run continues without an ECU that has failed.
    """

    links: Mapping[str, Link]
    codecs: Mapping[str, Codec]
    vehicles: int
    silence_s: float
    desk: FaultDesk
    free: FreeSlots
    go_on: bool = False


class Conductor(ABC):
    """Conducts a run from its first cycle to its last. It is the crew's `Listener`.

    Attributes:
        cycle: number of the newest cycle.
        misses: missed deadlines by name: of an ECU, or of the plant on one bus (veh1.plant); empty in virtual time.
        scheduling: in real time, the scheduling that the kernel has granted, as text.
    """

    def __init__(self, means: Means) -> None:
        """Conduct with `means`; no cycle has begun."""
        self._links = means.links
        self._codecs = means.codecs
        self._silence_s = means.silence_s
        self._desk = means.desk
        self._free = means.free
        self._outages = Outages(means.desk.plan)
        self._go_on = means.go_on
        self._refusals = Refusals(means.codecs)
        for bus, link in means.links.items():
            link.on_ignored = self._refusals.without_data(bus)
        self._words: list[Event] = []
        self.cycle = 0
        self.misses: dict[str, int] = {}
        self.scheduling = ""

    @property
    @abstractmethod
    def cycles(self) -> int:
        """Number of cycles of the run so far."""

    @property
    @abstractmethod
    def wall_s(self) -> float:
        """Wall-clock time in s from the first BenchSync to the end of the newest cycle."""

    @abstractmethod
    def run(self, crew: Crew, recorder: "Recorder", cycles: int, on_progress: OnProgress | None) -> None:
        """Conduct `cycles` cycles, then stop the nodes.

        Args:
            crew: runs plant and ECUs.
            recorder: records every cycle.
            cycles: number of cycles.
            on_progress: see there.

        Raises:
            RunFailed: a process ended or fell silent; the message names it and the time.
            Interrupted: a signal has come.
        """

    @abstractmethod
    def stop(self) -> None:
        """Stop the nodes before the end of the run."""

    @abstractmethod
    def record_rest(self, recorder: "Recorder") -> None:
        """Record the frames of cycles not recorded yet."""

    @property
    def refused(self) -> list[FramesRefused]:
        """What has been refused so far on each bus that had any."""
        return self._refusals.totals

    @property
    def awaited(self) -> str | None:
        """See `Listener`."""
        return None

    @abstractmethod
    def frames(self, bus: str, frames: Sequence[CanFrame]) -> bool:
        """See `Listener`."""

    @abstractmethod
    def truth(self, row: Truth) -> None:
        """See `Listener`."""

    def words(self, name: str, text: str) -> None:
        """See `Listener`."""
        self._words.append(ProcessOutput(name, text))

    def note(self, event: EcuNote) -> None:
        """See `Listener`."""
        self._words.append(event)

    def _sync(self, command: BenchCommand, cycle: int) -> list[BusFrame]:
        """Send the BenchSync of a cycle on all buses; return the frames, for the log."""
        if command is BenchCommand.STOP:
            self._desk.plan.stop()
        else:
            self._desk.plan.open_cycle(cycle, realtime=False)
        values = {"Command": command, "Cycle": cycle, "Time": time_of(cycle)}
        return [self._send(bus, BENCH_SYNC, values, cycle) for bus in self._links]

    def _send(self, bus: str, message: str, values: Mapping[str, float], cycle: int) -> BusFrame:
        frame = self._codecs[bus].encode(message, values, cycle)
        self._links[bus].send_all([frame])
        return BusFrame(bus, *frame)

    def _before(self, bus: str, frames: Sequence[CanFrame]) -> bool:
        """Take frames that came before the first cycle; return whether one is of an ECU that is waited for."""
        whole = []
        for frame in frames:
            can_id, data = frame
            why = self._refusals.flaw(bus, can_id, data)
            if why is None and self._free.is_free(bus, can_id):
                whole.append(frame)
            else:
                self._refusals.refuse(bus, frame, why or Refusal.NOT_DUE)
        return self._free.note(bus, whole)

    def _losses(self, crew: Crew) -> str:
        """Return a clause about frames that came faster than they were read; empty if none are known."""
        own = {f"by {CONDUCTOR} on {bus}": link.frames_lost() for bus, link in self._links.items()}
        others = {f"by {name}": count for name, count in dropped_datagrams(crew.pids).items()}
        lost = ", ".join(f"{count} {who}" for who, count in (own | others).items() if count)
        return f"; frames came faster than they were read and were lost: {lost}" if lost else ""

    def _when(self) -> str:
        return f"in cycle {self.cycle} (t = {time_of(self.cycle):.2f} s)"

    def _leave_out(self, names: Sequence[str], crew: Crew, text: str) -> EcuFailed | None:
        """Continue without ECUs that have failed, for the reason `text`; return the event, None if the run cannot."""
        if not self._go_on or not names or not _NEEDED.isdisjoint(names):
            return None
        for name in names:
            self._outages.failed(name, crew)
        return EcuFailed(names, text)
