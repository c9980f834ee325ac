"""Sorts the frames a node receives into cycles, so that a step gets exactly one frame of each input.

Frames of one cycle arrive over several buses in any order; a peer's frame may arrive before this node's own BenchSync.
The content of a frame therefore determines its cycle, not its time of arrival: BenchSync carries the cycle number,
every other input its alive counter, which is the cycle modulo 15.

In virtual time `BenchAbsent` announces a frame that will not be sent; a node that receives announcements of all its own
frames of a cycle was dead or stopped in that cycle, and skips it. In real time a node waits for its inputs only as long
as its deadline allows.

Anybody can send anything. A frame that is not whole is refused. A BenchSync is also refused if its cycle does not
follow, and an announcement if it is not about a cycle under way; so neither moves a node out of its cycle, and what is
kept is bounded. Nodes that the bench has started also ask its `FaultBoard` whether a BenchSync is the bench's own. An
input with a good CRC is believed: the profile has no secret, so it protects against accidents only.
"""

import math
import time
from collections.abc import Callable, Collection, Iterable, Mapping

import cython

from bench.bus.absence import BENCH_ABSENT, read_absence
from bench.bus.codec import Codec
from bench.bus.e2e import COUNTER_MODULUS, Status
from bench.bus.link.base import Link
from bench.bus.reception import Health, Reception, ReceptionState
from bench.bus.states import BenchCommand
from bench.bus.sync import BENCH_SYNC, Sync, read_sync
from bench.bus.topic import Signals, Topic
from bench.cycle import CYCLE_S, time_of
from bench.errors import BadInput
from bench.faults.plan import FaultPlan, is_off

AHEAD_CYCLES = 100
"""In real time, the number of cycles by which BenchSync may be ahead of a node's clock, whose start is an estimate."""

_REFUSED = {
    Status.REPEATED: ReceptionState.REPEATED,
    Status.WRONG_SEQUENCE: ReceptionState.WRONG_SEQUENCE,
    Status.ERROR: ReceptionState.ERROR,
}
_new = tuple.__new__
_FRESH = Reception(ReceptionState.OK, 0)
_OK, _ERROR = Status.OK, Status.ERROR
_MODULUS = COUNTER_MODULUS


class _Slot:
    """One input and its frames waiting for their step.

    Attributes:
        topic: bus and message of the input.
        layout: where its signals are.
        receiver: checks its CRC and counter.
        delay: cycles from sending to the step that uses it.
        timeout: cycles without a valid frame after which it is lost.
        waiting: signals by step; None if the frame must not be used or will not arrive.
        refused: why the newest frame since the last step was rejected, None if none was.
        reception: its reception state.
    """

    def __init__(self, topic: Topic, codec: Codec) -> None:
        """Expect `topic`, as its bus's DBC describes it."""
        self.topic = topic
        self.layout = codec.layout(topic.message)
        self.receiver = codec.receiver(self.layout.can_id)
        self.delay = 0 if topic.message == BENCH_SYNC else topic.delay
        self.timeout = codec.timeout_cycles(topic.message)
        self.waiting: dict[int, Signals | None] = {}
        self.refused: ReceptionState | None = None
        self.reception = Reception()

    def receive(self, values: Signals | None) -> None:
        """Update the reception for a step that got `values`."""
        if values is not None:
            self.reception = _FRESH
        else:
            age = self.reception.age + 1
            before = self.reception.state is ReceptionState.INIT and self.refused is None
            state = ReceptionState.INIT if before else self.refused or ReceptionState.MISSING
            self.reception = Reception(ReceptionState.LOST if age >= self.timeout else state, age)
        self.refused = None


class _Bus:
    """One of the node's buses.

    Attributes:
        link: the node's end of the bus.
        sync: the layout of its BenchSync.
        absent: the layout of its BenchAbsent.
        slots: the inputs received on it, by identifier.
        own: periods in cycles of the messages that the node itself sends on it, by identifier.
        opened: the newest cycle for which a BenchSync has arrived on this bus; -1 before the first.
        errors: number of frames rejected.
        errors_before: the same up to the newest BenchSync of this bus, so that the count in a step does not depend on
            when a frame was read.
    """

    def __init__(self, link: Link, codec: Codec, slots: dict[int, _Slot], own: dict[int, int]) -> None:
        """Listen on `link`."""
        self.link = link
        self.sync = codec.layout(BENCH_SYNC)
        self.absent = codec.layout(BENCH_ABSENT)
        self.slots = slots
        self.own = own
        self.opened = -1
        self.errors = 0
        self.errors_before = 0


class Inbox:
    """Collects the inputs of each cycle from a node's links.

    Attributes:
        cycle: the cycle whose inputs are being collected; its step is the next.
        opened: the newest cycle for which a BenchSync has arrived; -1 before the first.
        settled: whether that is certain: it is cycle 0, or the one before has arrived as well.
        stopped: whether a BenchSync has told this node to stop.
        opened_at: estimated time (s) of that BenchSync's arrival by the clock: all cycles have the same length in real
            time, and the node is not busy at every BenchSync.
        realtime: whether the wall clock paces the cycles.
        late: number of cycles skipped in real time, because a newer one had begun before their step.
    """

    def __init__(
        self,
        links: Mapping[str, Link],
        codecs: Mapping[str, Codec],
        topics: Iterable[Topic],
        *,
        name: str = "",
        own: Collection[Topic] = (),
        joins: bool = True,
        plan: FaultPlan | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Listen on `links` (by bus name) for `topics` and for each bus's BenchSync.

        Args:
            links: the node's ends of its buses.
            codecs: codec of every bus.
            topics: its inputs.
            name: name of the node, e.g. veh1.tracker.
            own: topics that the node itself sends.
            joins: whether it may join a running bench; else its first cycle is 0.
            plan: the faults of the run.
            clock: returns the time in s; read when a BenchSync arrives.

        Raises:
            BadInput: a topic's bus or message does not exist, or the message carries no alive counter.
        """
        self.cycle = 0
        self.opened = -1
        self.settled = False
        self.stopped = False
        self.opened_at = 0.0
        self._zero_at = math.inf
        self.realtime = False
        self.late = 0
        self._clock = clock
        self._name = name
        self._joins = joins
        self._plan = plan or FaultPlan()
        self._arrived: dict[int, int] = {}
        self._excused: dict[int, set[tuple[str, int]]] = {}
        self._topics = tuple(topics)
        self._buses = tuple(
            _Bus(
                link,
                codecs[bus],
                self._slots_of(bus, codecs[bus]),
                {
                    codecs[bus].can_id(topic.message): codecs[bus].period(topic.message)
                    for topic in own
                    if topic.bus == bus
                },
            )
            for bus, link in links.items()
        )
        for bus in self._buses:
            bus.link.select([*bus.slots, bus.absent.can_id])
        self._slots = tuple(slot for bus in self._buses for slot in bus.slots.values())
        self._inputs = tuple(slot for slot in self._slots if slot.topic.message != BENCH_SYNC)
        for topic in self._topics:
            if topic.bus not in links:
                raise BadInput(f"input {topic.message} is on bus {topic.bus}; this node has {', '.join(links)}")

    def _slots_of(self, bus: str, codec: Codec) -> dict[int, _Slot]:
        slots = {}
        for topic in (Topic(bus, BENCH_SYNC), *(topic for topic in self._topics if topic.bus == bus)):
            if topic.message not in codec.names:
                known = ", ".join(codec.names)
                raise BadInput(f"input {topic.message} does not exist on bus {bus}; its DBC has {known}")
            can_id = codec.can_id(topic.message)
            if not codec.is_protected(can_id):
                raise BadInput(
                    f"input {topic.message} on bus {bus} has no alive counter, which determines its cycle; "
                    "only messages with an E2EDataId can be inputs"
                )
            slots[can_id] = _Slot(topic, codec)
        return slots

    @property
    def health(self) -> Health:
        """The state of the buses as of the newest step."""
        lost, errors, receptions = 0, 0, {}
        bus: _Bus
        for bus in self._buses:
            lost += bus.link.frames_lost()
            errors += bus.errors_before
        slot: _Slot
        for slot in self._inputs:
            receptions[slot.topic] = slot.reception
        return _new(Health, (lost, errors, self.late, receptions))

    @property
    def complete(self) -> bool:
        """Whether every input of `cycle` has arrived or is known to be absent.

        A newer BenchSync does not end the wait: on a busy machine it may overtake a frame sent before it, and in
        lockstep it is sent only after all frames.
        """
        return self._arrived.get(self.cycle, 0) == len(self._slots)

    @property
    def awaited(self) -> Link | None:
        """In virtual time, the link of the first bus that lacks a frame of `cycle`; None if any frame may matter."""
        if self.realtime or not self.settled:
            return None
        bus: _Bus
        slot: _Slot
        for bus in self._buses:
            for slot in bus.slots.values():
                if self.cycle not in slot.waiting:
                    return bus.link
        return None

    @property
    def excused(self) -> bool:
        """Whether the others have continued without this node in `cycle`, because it was dead or stopped.

        Then all its frames are announced as absent; one alone is only given up.
        """
        announced = self._excused.get(self.cycle)
        return announced is not None and all(
            (bus.link.name, can_id) in announced
            for bus in self._buses
            for can_id, period in bus.own.items()
            if self.cycle % period == 0
        )

    def drain(self) -> bool:
        """Read all frames that have arrived; return whether there were any."""
        arrived = False
        bus: _Bus
        for bus in self._buses:
            for can_id, data in bus.link.receive():
                arrived = True
                slot: _Slot | None = bus.slots.get(can_id)
                if slot is None:
                    if can_id == bus.absent.can_id:
                        self._note_absent(bus, data)
                elif can_id == bus.sync.can_id:
                    self._take_sync(bus, slot, data)
                else:
                    self._sort(bus, slot, data)
        return arrived

    def take(self) -> dict[Topic, Signals | None]:
        """Return the inputs of `cycle`, None for each one missing or damaged, and begin the next cycle."""
        self._plan.refresh()
        faults = self._plan.at(self.cycle)
        off = {bus.link.name for bus in self._buses if is_off(self._name, bus.link.name, faults)} if faults else ()
        inputs: dict[Topic, Signals | None] = {}
        slot: _Slot
        for slot in self._inputs:
            if self.cycle not in slot.waiting:
                slot.receiver.missed()
            values = slot.waiting.get(self.cycle) if slot.topic.bus not in off else None
            inputs[slot.topic] = values
            slot.receive(values)
        self._forget()
        return inputs

    def catch_up(self) -> None:
        """In real time: skip the cycles that are over, so that late ones do not queue up."""
        while self.realtime and self.cycle < self.opened:
            self.late += 1
            self.skip()

    def skip(self) -> None:
        """Skip `cycle`: the others have continued without this node."""
        slot: _Slot
        for slot in self._inputs:
            if self.cycle not in slot.waiting:
                slot.receiver.missed()
            slot.receive(slot.waiting.get(self.cycle))
        self._forget()

    def _forget(self) -> None:
        self._arrived.pop(self.cycle, None)
        self._excused.pop(self.cycle, None)
        slot: _Slot
        for slot in self._slots:
            slot.waiting.pop(self.cycle, None)
        self.cycle += 1

    def _sort(self, bus: _Bus, slot: _Slot, data: bytes) -> None:
        status = slot.receiver.check(data if len(data) == slot.layout.length else b"")
        if status is not _OK:
            bus.errors += 1
            slot.refused = _REFUSED[status]
        if status is _ERROR:
            # The due frame may still arrive; in virtual time its absence would be announced.
            return
        values = slot.layout.decode(data)
        if status is _OK and not slot.layout.is_possible(values):
            # Its CRC is correct by chance, or its sender is faulty.
            status = _ERROR
            bus.errors += 1
            slot.refused = ReceptionState.ERROR
        step: cython.longlong = self._cycle_of(bus, data[1] & 0x0F) + slot.delay
        if status is _OK and step < self.cycle:
            # In sequence, but late by whole cycles.
            bus.errors += 1
            slot.refused = ReceptionState.WRONG_SEQUENCE
        self._put(slot, step, values if status is _OK else None)

    def _take_sync(self, bus: _Bus, slot: _Slot, data: bytes) -> None:
        sync = read_sync(bus.sync, data)
        if sync is not None and not self._is_own(sync):
            sync = None
        if sync is not None and self.settled and sync.stops_after(self._newest(bus), realtime=self.realtime):
            self.stopped = True
        elif sync is not None and self._follows(bus, sync):
            bus.errors_before = bus.errors
            self.realtime = sync.realtime
            self._open(bus, sync.cycle)
            self._put(slot, sync.cycle, None)
        else:
            bus.errors += 1

    def _is_own(self, sync: Sync) -> cython.bint:
        """Return whether this bench can have sent a BenchSync; an ECU that was started by hand cannot know."""
        if sync.command is BenchCommand.STOP:
            return self._plan.has_stopped
        return self._plan.has_opened(sync.cycle, realtime=sync.realtime)

    def _newest(self, bus: _Bus) -> cython.longlong:
        """The newest cycle on a bus; before its own first BenchSync, that on any bus."""
        return bus.opened if bus.opened >= 0 else self.opened

    def _follows(self, bus: _Bus, sync: Sync) -> cython.bint:
        """Return whether a BenchSync other than STOP opens a cycle that may come next on this bus."""
        cycle: cython.longlong = sync.cycle
        if sync.command is BenchCommand.STOP:
            return False
        if not self.settled:
            return cycle != bus.opened and (self._joins or cycle == 0)
        if sync.realtime != self.realtime:
            return False
        if self.realtime and cycle > bus.opened >= 0:
            # Some may have been lost.
            return cycle - AHEAD_CYCLES <= max(bus.opened, (self._clock() - self._zero_at) / CYCLE_S)
        return self._is_next(bus, cycle)

    def _is_next(self, bus: _Bus, cycle: cython.longlong) -> cython.bint:
        return cycle == bus.opened + 1 if bus.opened >= 0 else self.cycle <= cycle <= self.opened + 1

    def _note_absent(self, bus: _Bus, data: bytes) -> None:
        absence = None if self.realtime else read_absence(bus.absent, data)
        if absence is None:
            bus.errors += 1
            return
        identifier: cython.longlong = absence.can_id
        cycle: cython.longlong = absence.cycle
        if cycle > self._newest(bus) + 1 or not self._plan.has_opened(cycle, realtime=False):
            bus.errors += 1
            return
        if identifier in bus.own and cycle >= self.cycle:
            self._excused.setdefault(cycle, set()).add((bus.link.name, identifier))
        slot: _Slot | None = bus.slots.get(identifier)
        if slot is not None and identifier != bus.sync.can_id:
            step: cython.longlong = cycle + slot.delay
            # Here, not in the step, which may be before or after the arrival of the sender's next frame.
            slot.receiver.missed()
            if step >= self.cycle and step not in slot.waiting:
                self._fill(slot, step, None)

    def _cycle_of(self, bus: _Bus, counter: cython.int) -> cython.longlong:
        """The newest possible cycle of a frame with this alive counter.

        The frame may arrive before the BenchSync of its own cycle, but not before that of the cycle before. Only the
        BenchSync of the frame's own bus counts, because a node that was stopped reads its queues bus by bus. A frame 14
        cycles late is taken for one of the next cycle: the profile's counter cannot distinguish them.
        """
        newest: cython.longlong = 1 + max(self._newest(bus), 0)
        return newest - (newest - counter) % _MODULUS

    def _open(self, bus: _Bus, cycle: cython.longlong) -> None:
        if not self.settled and self.opened >= 0 and not self._is_next(bus, cycle):
            # The one before was not of this bench, or is too old.
            self.opened, self._zero_at = -1, math.inf
            each: _Bus
            for each in self._buses:
                each.opened = -1
        first: cython.bint = self.opened < 0
        slot: _Slot
        self.settled = self.settled or cycle == 0 or cycle == bus.opened + 1 > 0
        bus.opened = cycle
        if cycle > self.opened:
            self.opened = cycle
            self._zero_at = min(self._zero_at, self._clock() - time_of(cycle))
            self.opened_at = self._zero_at + time_of(cycle)
        if not first:
            return
        if cycle != self.cycle:
            # This node joins a running bench; the cycles of frames before its first BenchSync were guesses.
            for slot in self._slots:
                slot.waiting.clear()
            self._arrived.clear()
            self._excused.clear()
            self.cycle = cycle
        for slot in self._slots:
            if slot.delay and cycle not in slot.waiting:
                # Sent in a cycle in which this node did not take part.
                self._fill(slot, cycle, None)

    def _put(self, slot: _Slot, step: cython.longlong, values: Signals | None) -> None:
        if step >= self.cycle and step not in slot.waiting:
            self._fill(slot, step, values)

    def _fill(self, slot: _Slot, step: cython.longlong, values: Signals | None) -> None:
        slot.waiting[step] = values
        self._arrived[step] = self._arrived.get(step, 0) + 1
