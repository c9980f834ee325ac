"""Sorts the frames a node receives into cycles, so that a step sees exactly one frame of each input.

Frames of one cycle come over several buses in any order; a peer's frame may be here before this node's own BenchSync.
So what a frame carries tells its cycle, not when it came: BenchSync has the number itself, every other input its alive
counter, which is the cycle modulo 15.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from bench.bus.base import Link
from bench.bus.codec import Codec
from bench.bus.e2e import COUNTER_MODULUS, Receiver, Status
from bench.bus.topic import Health, Signals, Topic
from bench.errors import BadInput

BENCH_SYNC = "BenchSync"
STOP = 0
RUN = 1


@dataclass(slots=True)
class _Slot:
    """One input and its frames that wait for their step.

    Attributes:
        topic: what this input is.
        receiver: checks its CRC and counter.
        delay: cycles between its sending and the step it takes part in.
        last: newest step a frame has come for.
        waiting: signals by step; None where what came must not be used.
    """

    topic: Topic
    receiver: Receiver
    delay: int
    last: int | None = None
    waiting: dict[int, Signals | None] = field(default_factory=dict)


class Inbox:
    """Collects the inputs of each cycle from a node's links.

    Attributes:
        cycle: the cycle whose inputs are being collected, the next to be stepped.
        opened: the newest cycle a BenchSync has come for; -1 before the first.
        stopped: whether a BenchSync has told this node to stop.
    """

    def __init__(self, links: Mapping[str, Link], codecs: Mapping[str, Codec], topics: Iterable[Topic]) -> None:
        """Listen on `links` (by bus name) for `topics` and for each bus's BenchSync.

        Raises:
            BadInput: a topic's bus or message does not exist, or the message carries no alive counter.
        """
        self.cycle = 0
        self.opened = -1
        self.stopped = False
        self._e2e_errors = 0
        self._arrived: dict[int, int] = {}
        self._topics = tuple(topics)
        self._links = tuple((link, codecs[bus], self._slots_of(bus, codecs[bus])) for bus, link in links.items())
        for link, _, slots in self._links:
            link.select(slots)
        self._slots = tuple(slot for _, _, slots in self._links for slot in slots.values())
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
                    f"input {topic.message} on bus {bus} has no alive counter to tell its cycle by; "
                    "only messages with an E2EDataId can be inputs"
                )
            delay = 0 if topic.message == BENCH_SYNC else topic.delay
            slots[can_id] = _Slot(topic, codec.receiver(can_id), delay)
        return slots

    @property
    def health(self) -> Health:
        """Frames lost and E2E errors up to now."""
        return Health(sum(link.frames_lost() for link, _, _ in self._links), self._e2e_errors)

    @property
    def complete(self) -> bool:
        """Whether every input of `cycle` is here.

        A newer BenchSync does not end the wait: on a busy machine it may be here before a frame that was sent before
        it, and in lockstep nobody sends it unless all frames have been sent.
        """
        return self._arrived.get(self.cycle, 0) == len(self._slots)

    def drain(self) -> bool:
        """Take in what has arrived; whether there was anything."""
        arrived = False
        for link, codec, slots in self._links:
            for can_id, data in link.receive():
                arrived = True
                slot = slots.get(can_id)
                if slot is not None:
                    self._sort(slot, codec, can_id, data)
        return arrived

    def take(self) -> dict[Topic, Signals | None]:
        """The inputs of `cycle`, None for each that is missing or damaged; turns to the next cycle."""
        inputs = {slot.topic: slot.waiting.get(self.cycle) for slot in self._inputs}
        for slot in self._inputs:
            if inputs[slot.topic] is None:
                slot.receiver.missed()
        self._arrived.pop(self.cycle, None)
        for slot in self._slots:
            slot.waiting.pop(self.cycle, None)
        self.cycle += 1
        return inputs

    def _sort(self, slot: _Slot, codec: Codec, can_id: int, data: bytes) -> None:
        status = slot.receiver.check(data)
        if status is not Status.OK:
            self._e2e_errors += 1
        if status is Status.REPEATED:
            return
        if status is Status.ERROR:
            # Its counter cannot be trusted: it stands for the frame that was due next.
            self._put(slot, self.cycle if slot.last is None else slot.last + 1, None)
            return
        values = codec.decode(can_id, data)[1]
        if slot.topic.message == BENCH_SYNC:
            if values["Command"] == STOP:
                self.stopped = True
                return
            self._open(int(values["Cycle"]))
            self._put(slot, int(values["Cycle"]), values)
        else:
            step = self._nearest(data[1] & 0x0F) + slot.delay
            self._put(slot, step, values if status is Status.OK else None)

    def _nearest(self, counter: int) -> int:
        """The cycle with this alive counter that is nearest to the newest one opened."""
        now = max(self.opened, 0)
        half = COUNTER_MODULUS // 2
        return now + (counter - now + half) % COUNTER_MODULUS - half

    def _open(self, cycle: int) -> None:
        first = self.opened < 0
        self.opened = max(self.opened, cycle)
        if not first:
            return
        if cycle != self.cycle:
            # This node joins a run under way; what came before its first BenchSync was numbered by guess.
            for slot in self._slots:
                slot.last = None
                slot.waiting.clear()
            self._arrived.clear()
            self.cycle = cycle
        for slot in self._slots:
            if slot.delay and cycle not in slot.waiting:
                # Sent in a cycle that this node was not there for.
                self._fill(slot, cycle, None)

    def _put(self, slot: _Slot, step: int, values: Signals | None) -> None:
        if slot.last is not None and step <= slot.last:
            return
        slot.last = step
        if step >= self.cycle and step not in slot.waiting:
            self._fill(slot, step, values)

    def _fill(self, slot: _Slot, step: int, values: Signals | None) -> None:
        slot.waiting[step] = values
        self._arrived[step] = self._arrived.get(step, 0) + 1
