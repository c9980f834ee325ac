"""Sends a node's messages, cycle by cycle, as far as faults let it: the counterpart of `Inbox`.

Faults of frames are put in here, at the sender, so that every participant and every tool sees them on the bus. In
virtual time, in which nothing happens by itself, a frame that will not come, or not in good order, is announced as
absent: others would wait for it for ever.
"""

from collections import defaultdict
from collections.abc import Iterable, Mapping
from random import Random
from typing import NamedTuple

from bench.bus.codec import Codec
from bench.bus.e2e import COUNTER_MODULUS, protect
from bench.bus.link.base import Link
from bench.bus.topic import V2V, Signals, vehicle_of
from bench.cycle import CYCLE_MS
from bench.errors import BadInput
from bench.faults.kinds import (
    BabblingIdiot,
    BusOff,
    CounterStuck,
    Fault,
    FrameCorrupt,
    FrameDelay,
    FrameLoss,
    FrameReorder,
    GilbertElliott,
    SensorBias,
    SensorDropout,
    SensorNoise,
    SignalStuck,
    V2VOutage,
)
from bench.faults.plan import FaultPlan, hits

BENCH_ABSENT = "BenchAbsent"
LARGEST_FRAME_BITS = 135
"""A frame of 8 bytes with a short identifier and as many stuff bits as there can be (Davis et al. 2007, equation 1)."""

Faults = tuple[tuple[int, Fault], ...]


class _Queued(NamedTuple):
    """A message that waits for its cycle's sending."""

    bus: str
    message: str
    values: Signals


class Outbox:
    """Takes a node's messages of a cycle and sends them together.

    What a message leaves out is sent with its start value. A message of a longer cycle time than the bench's is sent
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
        self._held: defaultdict[int, list[tuple[str, int, bytes]]] = defaultdict(list)
        self._stuck: dict[tuple[int, str, str, str], float] = {}
        self._swapped: dict[tuple[int, str, int], bytes] = {}
        self._bad_channel: dict[tuple[int, str, int], bool] = {}

    def put(self, bus: str, message: str, values: Signals) -> None:
        """Put in a message with its signals' physical values.

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
        """Send what was put in, as the frames of `cycle`; announce what is missing where time is virtual."""
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
        """Announce that a frame will not come in this cycle."""
        self._links[bus].send(
            *self._codecs[bus].encode(BENCH_ABSENT, {"Identifier": can_id, "Cycle": cycle}, counter=cycle)
        )

    def _encoded(self, item: _Queued, cycle: int) -> tuple[int, bytes]:
        values = {**self._start_values[item.bus, item.message], **item.values}
        return self._codecs[item.bus].encode(item.message, values, cycle)

    def _send_faulty(self, queue: Iterable[_Queued], faults: Faults, cycle: int, lockstep: bool) -> None:
        off = {bus for bus in self._links if is_off(self._name, bus, faults)}
        starved = {bus: _starved(self._codecs[bus], bus, faults) for bus in self._links}
        for held in [due for due in self._held if due <= cycle]:
            for bus, can_id, data in self._held.pop(held):
                if bus not in off:
                    self._links[bus].send(can_id, data)
        self._babble(faults, off, cycle)
        for item in queue:
            bus = item.bus
            mine = tuple((index, fault) for index, fault in faults if hits(fault, bus, item.message))
            can_id, data = self._encoded(self._with_sensor_faults(item, mine, cycle), cycle)
            if bus in off or can_id in starved[bus]:
                frames: list[bytes] = []
                good = False
            else:
                frames, good = self._on_the_way(item, can_id, data, mine, cycle) if mine else ([data], True)
            for frame in frames:
                self._links[bus].send(can_id, frame)
            # Of an unprotected frame nobody can tell that it is not as it should be.
            if lockstep and not good and (not frames or self._codecs[bus].is_protected(can_id)):
                self.absent(bus, can_id, cycle)

    def _on_the_way(
        self, item: _Queued, can_id: int, data: bytes, faults: Faults, cycle: int
    ) -> tuple[list[bytes], bool]:
        """Return what becomes of a frame: what goes out now, and whether this cycle's frame is among it and good."""
        changed = self._changed(item, can_id, data, faults, cycle)
        # A stuck counter is right every fifteenth time, and no news to any receiver.
        stuck = any(isinstance(f, CounterStuck) and cycle > self.plan.window(index).first for index, f in faults)
        good = changed == data and not stuck
        data = changed
        after: list[bytes] = []
        for index, fault in faults:
            dice = self.plan.chance(index, item.bus, can_id, cycle)
            if isinstance(fault, FrameLoss | SensorDropout):
                if self._is_lost(index, fault, item.bus, can_id, dice):
                    return [], False
            elif isinstance(fault, FrameDelay):
                late = fault.cycles + dice.randint(0, fault.jitter_cycles)
                if late:
                    self._held[cycle + late].append((item.bus, can_id, data))
                    return [], False
            elif isinstance(fault, FrameReorder):
                pair = (index, item.bus, can_id)
                if not self.plan.is_second(index, cycle):
                    self._swapped[pair] = data
                    return [], False
                if pair in self._swapped:
                    after.append(self._swapped.pop(pair))
        copies = self.plan.extra(item.bus, item.message, can_id, cycle) - len(after)
        return [data] * (1 + max(0, copies)) + after, good

    def _changed(self, item: _Queued, can_id: int, data: bytes, faults: Faults, cycle: int) -> bytes:
        """Return the frame with what faults have done to its bytes."""
        for index, fault in faults:
            dice = self.plan.chance(index, item.bus, can_id, cycle)
            if isinstance(fault, CounterStuck):
                data = self._with_counter(item, data, self.plan.window(index).first)
            elif isinstance(fault, FrameCorrupt) and dice.random() < fault.probability:
                data = _corrupted(data, fault.bits, dice)
        return data

    def _is_lost(self, index: int, fault: FrameLoss | SensorDropout, bus: str, can_id: int, dice: Random) -> bool:
        bursts = fault.bursts if isinstance(fault, FrameLoss) else None
        if bursts is None:
            return dice.random() < fault.probability
        return self._is_lost_in_burst((index, bus, can_id), bursts, dice)

    def _is_lost_in_burst(self, channel: tuple[int, str, int], bursts: GilbertElliott, dice: Random) -> bool:
        was_bad = self._bad_channel.get(channel, False)
        change = bursts.to_good if was_bad else bursts.to_bad
        is_bad = was_bad != (dice.random() < change)
        self._bad_channel[channel] = is_bad
        return dice.random() < (bursts.loss_bad if is_bad else bursts.loss_good)

    def _with_counter(self, item: _Queued, data: bytes, counter: int) -> bytes:
        changed = bytearray(data)
        protect(changed, self._codecs[item.bus].data_id(item.message), counter % COUNTER_MODULUS)
        return bytes(changed)

    def _with_sensor_faults(self, item: _Queued, faults: Faults, cycle: int) -> _Queued:
        """Return the message as a faulty sensor or sender means it; CRC and counter will be good."""
        values = None
        for index, fault in faults:
            if not isinstance(fault, SignalStuck | SensorBias | SensorNoise):
                continue
            values = values or {**self._start_values[item.bus, item.message], **item.values}
            value = values[fault.signal]
            if isinstance(fault, SignalStuck):
                value = self._stuck.setdefault((index, item.bus, item.message, fault.signal), value)
            elif isinstance(fault, SensorBias):
                value += fault.bias
            else:
                can_id = self._codecs[item.bus].can_id(item.message)
                value += self.plan.chance(index, item.bus, can_id, cycle).gauss(0.0, fault.sigma)
            values[fault.signal] = value
        return item if values is None else item._replace(values=values)

    def _babble(self, faults: Faults, off: set[str], cycle: int) -> None:
        for index, fault in faults:
            if isinstance(fault, BabblingIdiot) and fault.node == self._name:
                bus = fault.node.partition(".")[0]
                dice = self.plan.chance(index, bus, fault.identifier, cycle)
                if bus not in off:
                    for _ in range(fault.frames_per_cycle):
                        self._links[bus].send(fault.identifier, dice.randbytes(8))


def is_off(node: str, bus: str, faults: Faults) -> bool:
    """Return whether a node takes no part on a bus, neither sending nor receiving."""
    for _, fault in faults:
        if isinstance(fault, BusOff) and fault.node == node and bus != V2V:
            return True
        if isinstance(fault, V2VOutage) and bus == V2V and fault.vehicle in (None, vehicle_of(node)):
            return True
    return False


def _starved(codec: Codec, bus: str, faults: Faults) -> frozenset[int]:
    """Return the identifiers that find no room on a bus in a cycle beside a babbling idiot.

    All messages of a bus are taken to be due in the cycle, and every frame to be as long as one can be.
    """
    starved: frozenset[int] = frozenset()
    for _, fault in faults:
        if isinstance(fault, BabblingIdiot) and fault.node.partition(".")[0] == bus:
            room = codec.bit_rate * CYCLE_MS // 1000 // LARGEST_FRAME_BITS
            before = [can_id for can_id in codec.can_ids if can_id <= fault.identifier]
            after = [can_id for can_id in codec.can_ids if can_id > fault.identifier]
            left = max(0, room - len(before) - fault.frames_per_cycle)
            starved |= frozenset([*before[room:], *after[left:]])
    return starved


def _corrupted(data: bytes, bits: int, dice: Random) -> bytes:
    """Return `data` with this many of its bits turned over."""
    word = int.from_bytes(data, "little")
    for bit in dice.sample(range(8 * len(data)), min(bits, 8 * len(data))):
        word ^= 1 << bit
    return word.to_bytes(len(data), "little")
