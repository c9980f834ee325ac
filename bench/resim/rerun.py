"""Runs one ECU in this process on the frames that a log has for it, with the log's clock.

The ECU runs in the same node as in a run, on the links of `--can direct`, with the run's faults: frame faults affect
what it sends, and crashes and hangs happen again.

In lockstep it gets the frames of a cycle and steps, as in the run. In real time it stepped when its inputs were there
or its wait was over; only the log tells when that was, and which cycles it missed: in each cycle in which the log has a
frame of it, it gets what had been received before that step, and before the next cycle began. This is not known to the
microsecond, so a frame received just then may be misplaced.
"""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass

from bench.bus.control_channel import Truth
from bench.bus.frame import BusFrame, CanFrame
from bench.bus.link.direct import DirectLink, Hub
from bench.bus.node import Node
from bench.bus.topic import Topic
from bench.conductor.direct import DirectCrew
from bench.conductor.interrupts import Interrupts
from bench.conductor.outages import Outages
from bench.conductor.realtime import SETTLE_CYCLES
from bench.cycle import time_of
from bench.ecu.checks import created
from bench.ecu.loading import load_class
from bench.ecu.runtime import EcuNode
from bench.events import EcuNote
from bench.faults.base import Fault
from bench.faults.plan import FaultPlan, is_off
from bench.resim.realtime_log import Feed, Naming
from bench.resim.recording import EcuLog
from bench.resim.step_limit import StepLimit
from bench.resim.witness import Witness
from bench.scenario import Scenario


@dataclass(frozen=True)
class Step:
    """The log's and the ECU's frames of one cycle.

    Attributes:
        cycle: its number.
        logged: what the ECU sent then.
        sent: what it sends now.
    """

    cycle: int
    logged: Sequence[BusFrame]
    sent: Sequence[BusFrame]


class Rerun:
    """One ECU on its log; iterating over it runs it. A context manager.

    Attributes:
        witness: the present ECU; after a crash a new one.
        steps: number of steps done.
        not_numbers: number of values sent that are not numbers.
    """

    def __init__(self, log: EcuLog, spec: str, scenario: Scenario, faults: Sequence[Fault], limit: StepLimit) -> None:
        """Put the ECU on its links.

        Args:
            log: what it saw.
            spec: its class, as `bench.ecu.loading.load_class` takes it.
            scenario: that of the run.
            faults: all faults of the run, in the order that chance knows them by.
            limit: time limit of a step.

        Raises:
            BadInput: the class cannot be loaded or takes what is not on its buses.
        """
        self._log = log
        self._spec = spec
        self._scenario = scenario
        self._limit = limit
        self._plan = FaultPlan(faults, scenario.seed)
        self._hub = Hub()
        self._links = {bus: DirectLink(bus, self._hub) for bus in log.codecs}
        self._sent: list[BusFrame] = []
        self._now_s = 0.0
        self._witnesses: list[Witness] = []
        self._nodes: list[EcuNode] = []
        self._stack = ExitStack()
        name = log.slot.name
        mine = [fault for fault in faults if fault.outage and fault.outage.ecu == name]
        self._outages = Outages(FaultPlan(mine))
        # Not entered: signals end this process as usual.
        interrupts = Interrupts()
        self._stack.push(interrupts)
        self._crew = DirectCrew([], [name], self._make, self._links, self, interrupts)
        self._fresh = False

    def __enter__(self) -> "Rerun":
        """Return itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Release its resources."""
        self._stack.close()

    @property
    def steps(self) -> int:
        """See the class."""
        return sum(witness.steps for witness in self._witnesses)

    @property
    def not_numbers(self) -> int:
        """See the class."""
        return sum(node.not_numbers for node in self._nodes)

    @property
    def witness(self) -> Witness:
        """See the class."""
        return self._witnesses[-1]

    def __iter__(self) -> Iterator[Step]:
        """Yield every cycle after it has been run.

        Raises:
            RunFailed: the ECU failed.
            BadInput: it sends on a bus it is not on.
        """
        return self._realtime() if self._log.realtime else self._lockstep()

    @property
    def awaited(self) -> str | None:
        """See `bench.conductor.crew.Listener`; links in this process are not waited on."""
        return None

    def frames(self, bus: str, frames: Sequence[CanFrame]) -> bool:
        """See `bench.conductor.crew.Listener`."""
        self._sent += [BusFrame(bus, *frame) for frame in frames]
        return bool(frames)

    def truth(self, row: Truth) -> None:
        """See `bench.conductor.crew.Listener`; no ECU has any."""

    def words(self, name: str, text: str) -> None:
        """See `bench.conductor.crew.Listener`; an ECU in this process prints to this process's output."""

    def note(self, event: EcuNote) -> None:
        """See `bench.conductor.crew.Listener`; `not_numbers` has their number, and the log those of the run."""

    def _make(self, _name: str) -> tuple[Node, tuple[Topic, ...]]:
        slot, codecs = self._log.slot, self._log.codecs
        self._fresh = True
        with self._limit.making():
            ecu = created(load_class(self._spec, slot.role), self._spec, slot, self._scenario, codecs)
        witness = Witness(ecu, self._limit)
        self._witnesses.append(witness)
        links = {bus: DirectLink(bus, self._hub) for bus in codecs}
        sends = slot.sends(codecs)
        clock = lambda: self._now_s  # noqa: E731
        node = EcuNode(slot.name, witness, links, codecs, sends, self._plan, clock=clock, note=self.note)
        self._nodes.append(node)
        return node, witness.inputs

    def _work(self) -> list[BusFrame]:
        """Let the ECU step if it can, and return what it sends."""
        while self._crew.attend(0.0):
            pass
        sent, self._sent = self._sent, []
        return sent

    def _lockstep(self) -> Iterator[Step]:
        for cycle in range(self._log.end):
            self._outages.apply(cycle, self._crew)
            away = bool(self._outages.absent)
            logged = []
            for frame in self._log.cycle(cycle):
                # While it is away, the conductor announces its frames as absent.
                if self._log.is_own(frame) and not (away and self._log.absent(frame) is not None):
                    logged.append(frame)
                else:
                    self._links[frame.bus].send(frame.can_id, frame.data)
            yield Step(cycle, logged, self._work())

    def _realtime(self) -> Iterator[Step]:
        feed, naming = Feed(self._log, self._nodes[-1].input_wait_s), Naming(self._log)
        sent: dict[int, list[BusFrame]] = {}
        for cycle in self._cycles_with_a_step(feed):
            sent.setdefault(cycle, [])
            for frame in self._step_in_time(feed, cycle):
                sent.setdefault(naming.cycle_of(frame, cycle), []).append(frame)
            # Later frames no longer belong to the cycles before.
            for done in [number for number in sent if number < cycle - SETTLE_CYCLES]:
                yield Step(done, feed.own(done), sent.pop(done))
        for done, frames in sent.items():
            yield Step(done, feed.own(done), frames)

    def _cycles_with_a_step(self, feed: Feed) -> Iterator[int]:
        """Yield the cycles in which the ECU did a step, after applying the faults that begin or end there."""
        prepared = 0
        for cycle in range(self._log.end):
            faults = self._plan.at(cycle)
            # A bus-off ECU was not heard, but kept running.
            unheard = any(is_off(self._log.slot.name, bus, faults) for bus in self._links)
            if not unheard and not feed.own(cycle):
                continue
            for number in range(prepared, cycle + 1):
                self._outages.apply(number, self._crew)
            prepared = cycle + 1
            if self._outages.absent:
                # Frames that it sent in this cycle before it was stopped.
                continue
            if self._fresh:
                # It was restarted during the run, and listens from here on.
                feed.skip_to(cycle)
                self._fresh = False
            yield cycle

    def _step_in_time(self, feed: Feed, cycle: int) -> list[BusFrame]:
        """Let the ECU do its step of a cycle with the frames received by then, and return what it sends."""
        for bus, can_id, data in feed.until(min(feed.step_began(cycle), feed.begun(cycle + 1))):
            self._links[bus].send(can_id, data)
        sent: list[BusFrame] = []
        # First with the cycle just begun, then with its waiting time over.
        for now in (cycle, cycle + 1):
            self._now_s = time_of(now)
            sent += self._work()
        return sent
