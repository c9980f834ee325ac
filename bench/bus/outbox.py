"""Sends a node's messages, cycle by cycle, with the faults of frames: the counterpart of `Inbox`.

Faults of frames are injected here, at the sender, so that every participant and every tool sees them on the bus. In
virtual time a frame that will not be sent, or not as a valid frame, is announced as absent: receivers would wait for it
for ever.
"""

from collections import defaultdict
from collections.abc import Iterable, Mapping

import cython

from bench.bus.absence import BENCH_ABSENT
from bench.bus.codec import Codec
from bench.bus.e2e import COUNTER_MODULUS, protect
from bench.bus.frame import BusFrame, CanFrame
from bench.bus.link.base import Link
from bench.bus.topic import Signals
from bench.cycle import CYCLE_MS
from bench.errors import BadInput
from bench.faults.base import Fault, FrameContext, Memory
from bench.faults.plan import FaultPlan, Faults, is_off

LARGEST_FRAME_BITS = 135
"""A frame of 8 bytes with a short identifier and the maximum number of stuff bits (Davis et al. 2007, equation 1)."""

_new = tuple.__new__

Hits = list[tuple[Fault, FrameContext, Memory]]
"""The faults at work on a frame, each with its context and its memory."""


class _Message:
    """A message of the node.

    Attributes:
        bus, name: its bus and its name.
        layout: where its signals are.
        period: its period in cycles.
        replaced: counts the values that could not be sent as they were.
        frames: the frames of its bus that are ready to be sent.
        largest: of a message of wall-clock times, the largest value of each signal since it was last sent; else None.
    """

    def __init__(self, bus: str, name: str, codec: Codec, frames: list[CanFrame]) -> None:
        """Describe the message `name` of `bus`."""
        self.bus = bus
        self.name = name
        self.layout = codec.layout(name)
        self.period = codec.period(name)
        self.replaced = codec.replaced
        self.frames = frames
        self.largest: dict[str, float] | None = {} if codec.is_wall_clock(self.layout.can_id) else None

    def to_send(self, values: Signals) -> Signals:
        """Return what to send if it is sent now, after `values` were put in."""
        if self.largest is None:
            return values
        for signal, value in values.items():
            self.largest[signal] = max(value, self.largest.get(signal, value))
        return self.largest

    def encoded(self, values: Signals, cycle: cython.longlong) -> bytes:
        """Return the data of its frame of `cycle`, with start values for signals without one."""
        return self.layout.encode(values, cycle % COUNTER_MODULUS, self.replaced, True)


class Outbox:
    """Collects a node's messages of a cycle and sends them together.

    Signals without a value are sent with their start value. A message with a longer cycle time than the bench's is sent
    when it is due, however often it is put in, with its newest values; one of wall-clock times with the largest
    value of each signal since it was last sent: the longest step matters, in whatever cycle it was.
    """

    def __init__(
        self, name: str, links: Mapping[str, Link], codecs: Mapping[str, Codec], plan: FaultPlan | None = None
    ) -> None:
        """Send over `links` (by bus name) for the node `name` (veh1.tracker), with the faults of `plan`."""
        self.plan = plan or FaultPlan()
        self._name = name
        self._links = dict(links)
        self._codecs = codecs
        self._queue: list[tuple[_Message, Signals]] = []
        self._messages: dict[tuple[str, str], _Message] = {}
        self._frames: dict[str, list[CanFrame]] = {bus: [] for bus in links}
        self._held: defaultdict[int, list[BusFrame]] = defaultdict(list)
        self._memories: defaultdict[tuple[int, str, int], Memory] = defaultdict(dict)

    def put(self, bus: str, message: str, values: Signals) -> None:
        """Add a message with its signals' physical values.

        Raises:
            BadInput: the node is not on this bus.
            EncodeError: the bus's DBC has no such message.
        """
        known = self._messages.get((bus, message))
        if known is None:
            if bus not in self._links:
                raise BadInput(f"{self._name} sends {message} on bus {bus}; it is on {', '.join(self._links)}")
            known = self._messages[bus, message] = _Message(bus, message, self._codecs[bus], self._frames[bus])
        self._queue.append((known, known.to_send(values)))

    def send(self, cycle: cython.longlong, *, lockstep: bool = True) -> None:
        """Send the messages as the frames of `cycle`; in virtual time announce absent ones."""
        queue, self._queue = self._queue, []
        self.plan.refresh()
        faults = self.plan.at(cycle)
        message: _Message
        due = [(message, values) for message, values in queue if cycle % message.period == 0]
        if faults or self._held:
            self._send_faulty(due, faults, cycle, lockstep)
        else:
            for message, values in due:
                frame = _new(CanFrame, (message.layout.can_id, message.encoded(values, cycle)))
                message.frames.append(frame)
        for message, _ in due:
            if message.largest is not None:
                message.largest = {}
        self._flush()

    def _flush(self) -> None:
        """Send what is ready, all frames of a bus at once."""
        for bus, frames in self._frames.items():
            if frames:
                self._links[bus].send_all(frames)
                frames.clear()

    def absent(self, bus: str, can_id: int, cycle: int) -> None:
        """Announce that a frame will not be sent in this cycle."""
        self._links[bus].send(*self._absence(bus, can_id, cycle))

    def _absence(self, bus: str, can_id: int, cycle: int) -> CanFrame:
        return self._codecs[bus].encode(BENCH_ABSENT, {"Identifier": can_id, "Cycle": cycle}, counter=cycle)

    def _send_faulty(
        self, queue: Iterable[tuple[_Message, Signals]], faults: Faults, cycle: int, lockstep: bool
    ) -> None:
        off = {bus for bus in self._links if is_off(self._name, bus, faults)}
        starved = {bus: _starved(self._codecs[bus], bus, faults) for bus in self._links}
        for held in [due for due in self._held if due <= cycle]:
            for bus, can_id, data in self._held.pop(held):
                if bus not in off:
                    self._frames[bus].append(CanFrame(can_id, data))
        self._send_babble(faults, off, cycle)
        message: _Message
        for message, given in queue:
            bus, can_id = message.bus, message.layout.can_id
            hits = self._hits(message, faults, cycle)
            values = {**self._codecs[bus].start_values(message.name), **given}
            for fault, frame, memory in hits:
                fault.on_values(values, frame, memory)
            data = message.encoded(values, cycle)
            if bus in off or can_id in starved[bus]:
                frames: list[bytes] = []
                good = False
            else:
                frames, good = self._on_the_way(message, data, hits) if hits else ([data], True)
            self._frames[bus] += [CanFrame(can_id, each) for each in frames]
            # Receivers cannot detect that an unprotected frame is wrong.
            if lockstep and not good and (not frames or message.layout.data_id):
                self._frames[bus].append(self._absence(bus, can_id, cycle))

    def _hits(self, message: _Message, faults: Faults, cycle: int) -> Hits:
        """Return the faults at work on a message's frame in this cycle."""
        bus, can_id = message.bus, message.layout.can_id
        return [
            (fault, self.plan.context(index, bus, can_id, cycle), self._memories[index, bus, can_id])
            for index, fault in faults
            if fault.hits(bus, message.name)
        ]

    def _on_the_way(self, message: _Message, data: bytes, hits: Hits) -> tuple[list[bytes], bool]:
        """Return the frames to send now, and whether this cycle's frame is among them and valid."""
        changed, good = self._changed(message, data, hits)
        behind: list[bytes] = []
        for fault, frame, memory in hits:
            passage = fault.passage(changed, frame, memory)
            if passage.late:
                self._held[frame.cycle + passage.late].append(BusFrame(frame.bus, frame.can_id, changed))
            if passage.late != 0:
                return [], False
            behind += passage.behind
        copies = sum(fault.extra(frame) for fault, frame, _ in hits) - len(behind)
        return [changed] * (1 + max(0, copies)) + behind, good

    def _changed(self, message: _Message, data: bytes, hits: Hits) -> tuple[bytes, bool]:
        """Return a frame's bytes after the faults, and whether receivers accept them."""
        changed, repeated = data, False
        for fault, frame, _ in hits:
            counter = fault.counter(frame)
            if counter is not None:
                changed = self._with_counter(message, changed, counter)
                # A stuck counter is correct every fifteenth time, but receivers see a repeated frame.
                repeated |= counter != frame.cycle
            changed = fault.on_bytes(changed, frame)
        return changed, changed == data and not repeated

    def _with_counter(self, message: _Message, data: bytes, counter: int) -> bytes:
        changed = bytearray(data)
        protect(changed, message.layout.data_id, counter % COUNTER_MODULUS)
        return bytes(changed)

    def _send_babble(self, faults: Faults, off: set[str], cycle: int) -> None:
        for index, fault in faults:
            for bus, can_id in fault.identifiers(self._name):
                if bus not in off:
                    for data in fault.payloads(self.plan.chance(index, bus, can_id, cycle)):
                        self._frames[bus].append(CanFrame(can_id, data))


def _starved(codec: Codec, bus: str, faults: Faults) -> frozenset[int]:
    """Return the identifiers that do not fit on a bus in a cycle if every frame has the maximum length."""
    room = codec.bit_rate * CYCLE_MS // 1000 // LARGEST_FRAME_BITS
    return frozenset().union(*(fault.starved(bus, codec.can_ids, room) for _, fault in faults))
