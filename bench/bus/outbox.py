"""Sends a node's messages, cycle by cycle, with the faults of frames: the counterpart of `Inbox`.

Faults of frames are injected here, at the sender, so that every participant and every tool sees them on the bus. In
virtual time a frame that will not be sent, or not as a valid frame, is announced as absent: receivers would wait for it
for ever.
"""

from collections import defaultdict
from collections.abc import Iterable, Mapping
from typing import NamedTuple

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

Hits = list[tuple[Fault, FrameContext, Memory]]
"""The faults at work on a frame, each with its context and its memory."""


class _Queued(NamedTuple):
    """A message waiting to be sent in its cycle."""

    bus: str
    message: str
    values: Signals


class Outbox:
    """Collects a node's messages of a cycle and sends them together.

    Signals without a value are sent with their start value. A message with a longer cycle time than the bench's is sent
    when it is due, however often it is put in.
    """

    def __init__(
        self, name: str, links: Mapping[str, Link], codecs: Mapping[str, Codec], plan: FaultPlan | None = None
    ) -> None:
        """Send over `links` (by bus name) for the node `name` (veh1.tracker), with the faults of `plan`."""
        self.plan = plan or FaultPlan()
        self._name = name
        self._links = dict(links)
        self._codecs = codecs
        self._queue: list[_Queued] = []
        self._start_values: dict[tuple[str, str], dict[str, float]] = {}
        self._periods: dict[tuple[str, str], int] = {}
        self._held: defaultdict[int, list[BusFrame]] = defaultdict(list)
        self._memories: defaultdict[tuple[int, str, int], Memory] = defaultdict(dict)

    def put(self, bus: str, message: str, values: Signals) -> None:
        """Add a message with its signals' physical values.

        Raises:
            BadInput: the node is not on this bus.
            EncodeError: the bus's DBC has no such message.
        """
        key = (bus, message)
        if key not in self._periods:
            if bus not in self._links:
                raise BadInput(f"{self._name} sends {message} on bus {bus}; it is on {', '.join(self._links)}")
            codec = self._codecs[bus]
            self._start_values[key] = codec.start_values(message)
            self._periods[key] = codec.period(message)
        self._queue.append(_Queued(bus, message, values))

    def send(self, cycle: int, *, lockstep: bool = True) -> None:
        """Send the messages as the frames of `cycle`; in virtual time announce absent ones."""
        queue, self._queue = self._queue, []
        self.plan.refresh()
        faults = self.plan.at(cycle)
        if not faults and not self._held:
            for item in queue:
                if cycle % self._periods[item.bus, item.message] == 0:
                    self._links[item.bus].send(*self._encoded(item, cycle))
            return
        due = [item for item in queue if cycle % self._periods[item.bus, item.message] == 0]
        self._send_faulty(due, faults, cycle, lockstep)

    def absent(self, bus: str, can_id: int, cycle: int) -> None:
        """Announce that a frame will not be sent in this cycle."""
        self._links[bus].send(
            *self._codecs[bus].encode(BENCH_ABSENT, {"Identifier": can_id, "Cycle": cycle}, counter=cycle)
        )

    def _values(self, item: _Queued) -> dict[str, float]:
        return {**self._start_values[item.bus, item.message], **item.values}

    def _encoded(self, item: _Queued, cycle: int) -> CanFrame:
        return self._codecs[item.bus].encode(item.message, self._values(item), cycle)

    def _send_faulty(self, queue: Iterable[_Queued], faults: Faults, cycle: int, lockstep: bool) -> None:
        off = {bus for bus in self._links if is_off(self._name, bus, faults)}
        starved = {bus: _starved(self._codecs[bus], bus, faults) for bus in self._links}
        for held in [due for due in self._held if due <= cycle]:
            for bus, can_id, data in self._held.pop(held):
                if bus not in off:
                    self._links[bus].send(can_id, data)
        self._send_babble(faults, off, cycle)
        for item in queue:
            bus = item.bus
            hits = self._hits(item, faults, cycle)
            values = self._values(item)
            for fault, frame, memory in hits:
                fault.on_values(values, frame, memory)
            can_id, data = self._codecs[bus].encode(item.message, values, cycle)
            if bus in off or can_id in starved[bus]:
                frames: list[bytes] = []
                good = False
            else:
                frames, good = self._on_the_way(item, data, hits) if hits else ([data], True)
            for each in frames:
                self._links[bus].send(can_id, each)
            # Receivers cannot detect that an unprotected frame is wrong.
            if lockstep and not good and (not frames or self._codecs[bus].is_protected(can_id)):
                self.absent(bus, can_id, cycle)

    def _hits(self, item: _Queued, faults: Faults, cycle: int) -> Hits:
        """Return the faults at work on a message's frame in this cycle."""
        can_id = self._codecs[item.bus].can_id(item.message)
        return [
            (fault, self.plan.context(index, item.bus, can_id, cycle), self._memories[index, item.bus, can_id])
            for index, fault in faults
            if fault.hits(item.bus, item.message)
        ]

    def _on_the_way(self, item: _Queued, data: bytes, hits: Hits) -> tuple[list[bytes], bool]:
        """Return the frames to send now, and whether this cycle's frame is among them and valid."""
        changed, good = self._changed(item, data, hits)
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

    def _changed(self, item: _Queued, data: bytes, hits: Hits) -> tuple[bytes, bool]:
        """Return a frame's bytes after the faults, and whether receivers accept them."""
        changed, repeated = data, False
        for fault, frame, _ in hits:
            counter = fault.counter(frame)
            if counter is not None:
                changed = self._with_counter(item, changed, counter)
                # A stuck counter is correct every fifteenth time, but receivers see a repeated frame.
                repeated |= counter != frame.cycle
            changed = fault.on_bytes(changed, frame)
        return changed, changed == data and not repeated

    def _with_counter(self, item: _Queued, data: bytes, counter: int) -> bytes:
        changed = bytearray(data)
        protect(changed, self._codecs[item.bus].data_id(item.message), counter % COUNTER_MODULUS)
        return bytes(changed)

    def _send_babble(self, faults: Faults, off: set[str], cycle: int) -> None:
        for index, fault in faults:
            for bus, can_id in fault.identifiers(self._name):
                if bus not in off:
                    for data in fault.payloads(self.plan.chance(index, bus, can_id, cycle)):
                        self._links[bus].send(can_id, data)


def _starved(codec: Codec, bus: str, faults: Faults) -> frozenset[int]:
    """Return the identifiers that do not fit on a bus in a cycle if every frame has the maximum length."""
    room = codec.bit_rate * CYCLE_MS // 1000 // LARGEST_FRAME_BITS
    return frozenset().union(*(fault.starved(bus, codec.can_ids, room) for _, fault in faults))
