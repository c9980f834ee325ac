"""Bus timing: arbitration on every bus of a bench, from cycle to cycle.

CAN is a non-preemptive bus with fixed priorities: when it is free, the waiting frame with the lowest identifier is sent
and cannot be interrupted. Frames that a bench delivers without delay get their transmission time here, from the DBC's
bit rate and the length of the frame's content.

A frame is released (starts to wait for the bus)

- in lockstep, where time is virtual and computing takes none of it: BenchSync with its cycle; the plant's messages at
  the end of BenchSync on their bus; an ECU's messages when BenchSync and all of its inputs of this cycle are off the
  wire of its vehicle's bus. Frames on v2v are used in the next cycle, so no ECU waits for them. A frame whose
  identifier is not in the DBC is released with the cycle;
- in real time: when it was received.

The end of a frame is that of its last bit, before the interframe space; its response time is from release to end.
"""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import cython
import numpy as np
import numpy.typing as npt

from bench.bus.absence import BENCH_ABSENT
from bench.bus.codec import Codec
from bench.bus.frame import BusFrame, RefusedFrame
from bench.bus.network import transmissions
from bench.bus.sync import BENCH_SYNC
from bench.bus.topic import Topic
from bench.bus.wire.frame_length import INTERFRAME_BITS, frame_bits, longest_bits, priority
from bench.cycle import CYCLE_NS
from bench.names import PLANT, V2V

_MOST_BYTES = cython.declare(cython.int, 8)

MOST_HELD = 20_000
"""Number of frames that wait for their time on the wire; beyond it, a flood's are sent whatever may follow."""

_NEVER = cython.declare(cython.longlong, 1 << 62)

FRAME = np.dtype(
    [
        ("time", "<i8"),
        ("receive", "<i8"),
        ("wire", "<i8"),
        ("response", "<i8"),
        ("data", "u1", (8,)),
        ("can_id", "<u4"),
        ("bus", "<u2"),
        ("length", "u1"),
        ("refused", "u1"),
    ]
)
"""A frame: simulated time of its cycle, receive time on the host, end on the wire (simulated; 0 if never sent) and
response time, all in ns; data padded with zeros; number of its bus; whether it was refused, 1 or 0. Without gaps."""


@cython.cclass
class FrameBuffer:
    """Collects frames as they are received, as a table of `FRAME`."""

    _numbers: dict[str, int]
    _table: Any
    _count: cython.Py_ssize_t
    _time: cython.longlong[:]
    _receive: cython.longlong[:]
    _data: cython.uchar[:, :]
    _can_id: cython.uint[:]
    _bus: cython.ushort[:]
    _length: cython.uchar[:]
    _refused: cython.uchar[:]

    def __init__(self, buses: Iterable[str]) -> None:
        """Begin with nothing; frames name a bus by its place in `buses`."""
        self._numbers = {bus: number for number, bus in enumerate(buses)}
        self._count = 0
        self._use(np.zeros(256, FRAME))

    def _use(self, table: npt.NDArray[Any]) -> None:
        self._table = table
        self._time, self._receive = table["time"].data, table["receive"].data
        self._data, self._can_id, self._bus = table["data"].data, table["can_id"].data, table["bus"].data
        self._length, self._refused = table["length"].data, table["refused"].data

    def add(self, time_ns: int, frames: Sequence[BusFrame], receive_ns: Sequence[int]) -> None:
        """Add frames (n,) of the simulated time `time_ns`, received at `receive_ns` (n,).

        Raises:
            ValueError: a frame has more than 8 bytes; then none of them is added.
        """
        at: cython.Py_ssize_t = self._count
        index: cython.Py_ssize_t
        byte: cython.Py_ssize_t
        time: cython.longlong = time_ns
        if at + len(frames) > len(self._table):
            table = np.zeros(2 * (at + len(frames)), FRAME)
            table[:at] = self._table[:at]
            self._use(table)
        for index in range(len(frames)):
            frame = frames[index]
            data: bytes = frame[2]
            size: cython.Py_ssize_t = len(data)
            if size > _MOST_BYTES:
                raise ValueError(f"frame 0x{frame[1]:03X} on {frame[0]}: {size} bytes, not 0 to {_MOST_BYTES}")
            self._time[at], self._receive[at] = time, receive_ns[index]
            self._can_id[at], self._bus[at] = frame[1], self._numbers[frame[0]]
            self._length[at], self._refused[at] = size, type(frame) is RefusedFrame
            for byte in range(_MOST_BYTES):
                self._data[at, byte] = data[byte] if byte < size else 0
            at += 1
        self._count = at

    def take(self) -> npt.NDArray[Any]:
        """Return the frames, and empty the buffer."""
        table: npt.NDArray[Any] = self._table[: self._count].copy()
        self._count = 0
        return table


@cython.cclass
class _Frame:
    """A frame that has not been on the wire yet.

    Attributes:
        row: its place in the table of frames.
        serial: its number among all frames.
        rank: its priority; the lowest wins.
        duration: ns on the wire.
        release: time from which it waits for the bus.
        key: what it is sorted by in the queue that it is in.
        port: its bus.
        route: what the DBC says about it; None if its identifier is not in the DBC.
        readers: the `_Response`s that wait for it.
    """

    row: cython.Py_ssize_t
    serial: cython.longlong
    rank: cython.longlong
    duration: cython.longlong
    release: cython.longlong
    key: cython.longlong
    port: Any
    route: Any
    readers: list[Any]


@cython.cclass
class _Response:
    """The frames of one sender in one cycle: they are released when its inputs are off the wire.

    Attributes:
        awaited: number of frames that it still waits for.
        frames: its frames; none after their release.
    """

    awaited: cython.Py_ssize_t
    frames: list[_Frame]

    def __init__(self) -> None:
        self.awaited = 0
        self.frames = []


@cython.cclass
class _Route:
    """What the DBC says about the frames of one identifier on one bus.

    Attributes:
        readers: numbers of the senders that wait for them.
        sender: number of the sender that sends them in response to others; -1 if they are sent with the cycle.
        absence: whether they announce an absent frame, and are on no wire.
        duration: ns on the wire whatever they hold; 0 if it depends on that.
    """

    readers: list[int]
    sender: cython.Py_ssize_t
    absence: cython.bint
    duration: cython.longlong

    def __init__(self) -> None:
        self.readers = []
        self.sender = -1
        self.absence = False
        self.duration = 0


@cython.cclass
class _Queue:
    """Frames sorted by their `key` and, where that is equal, by their serial number: a binary heap."""

    items: list[_Frame]

    def __init__(self) -> None:
        self.items = []

    @cython.cfunc
    def put(self, frame: _Frame, key: cython.longlong) -> cython.void:
        """Add a frame, which is in no other queue, with this key."""
        items: list[_Frame] = self.items
        frame.key = key
        at: cython.Py_ssize_t = len(items)
        items.append(frame)
        while at > 0:
            above: cython.Py_ssize_t = (at - 1) >> 1
            other: _Frame = items[above]
            if other.key < key or (other.key == key and other.serial < frame.serial):
                break
            items[at] = other
            at = above
        items[at] = frame

    @cython.cfunc
    def take(self) -> _Frame:
        """Remove the first frame and return it."""
        items: list[_Frame] = self.items
        first: _Frame = items[0]
        last: _Frame = items.pop()
        size: cython.Py_ssize_t = len(items)
        at: cython.Py_ssize_t = 0
        while 2 * at + 1 < size:
            below: cython.Py_ssize_t = 2 * at + 1
            lower: _Frame = items[below]
            if below + 1 < size:
                other: _Frame = items[below + 1]
                if other.key < lower.key or (other.key == lower.key and other.serial < lower.serial):
                    below, lower = below + 1, other
            if last.key < lower.key or (last.key == lower.key and last.serial < lower.serial):
                break
            items[at] = lower
            at = below
        if size > 0:
            items[at] = last
        return first

    @cython.cfunc
    def first(self) -> _Frame:
        """Return the first frame."""
        frame: _Frame = self.items[0]
        return frame


@cython.cclass
class _Port:
    """One bus.

    Attributes:
        routes: the `_Route` of each identifier.
        bit_rate: bits per second.
        interframe: ns between two frames.
        free: time from which the next frame may begin.
        ready: frames that wait for the bus, by priority.
        to_come: frames released later than `free`, by that time.
        waiting: the `_Response`s to frames of this bus that have not been released.
    """

    routes: dict[int, _Route]
    bit_rate: cython.longlong
    interframe: cython.longlong
    free: cython.longlong
    ready: _Queue
    to_come: _Queue
    waiting: list[_Response]

    def __init__(self, codec: Codec) -> None:
        self.routes = {can_id: _Route() for can_id in codec.can_ids}
        self.bit_rate = codec.bit_rate
        self.interframe = INTERFRAME_BITS * 1_000_000_000 // codec.bit_rate
        self.free = 0
        self.ready = _Queue()
        self.to_come = _Queue()
        self.waiting = []

    @cython.cfunc
    def run(self, until: cython.longlong, wire: cython.longlong[:], response: cython.longlong[:]) -> cython.void:
        """Send all frames that begin before `until`; set the end and the response time of each."""
        each: _Response
        while True:
            self._send(until, wire, response)
            self.waiting = [each for each in self.waiting if each.frames]
            if self.ready.items or self.to_come.items or not self.waiting:
                return
            # Two senders that wait for each other would wait for ever; on a bench neither would have sent.
            for each in self.waiting:
                _release(each, self.free - self.interframe)

    @cython.cfunc
    def _send(self, until: cython.longlong, wire: cython.longlong[:], response: cython.longlong[:]) -> cython.void:
        ready: _Queue = self.ready
        to_come: _Queue = self.to_come
        free: cython.longlong = self.free
        frame: _Frame
        reader: _Response
        while ready.items or to_come.items:
            if not ready.items and to_come.first().key > free:
                free = to_come.first().key
            if free >= until:
                break
            while to_come.items and to_come.first().key <= free:
                frame = to_come.take()
                ready.put(frame, frame.rank)
            frame = ready.take()
            end: cython.longlong = free + frame.duration
            free = end + self.interframe
            wire[frame.row] = end
            response[frame.row] = end - frame.release
            for reader in frame.readers:
                reader.awaited -= 1
                if reader.awaited == 0:
                    _release(reader, end)
        self.free = free


@cython.cfunc
def _release(response: _Response, time: cython.longlong) -> cython.void:
    """Let the frames of a sender wait for their buses from `time` on."""
    frame: _Frame
    for frame in response.frames:
        _wait(frame, time)
    response.frames = []


@cython.cfunc
def _wait(frame: _Frame, time: cython.longlong) -> cython.void:
    port: _Port = frame.port
    frame.release = time
    port.to_come.put(frame, time)


class BusTimeline:
    """Computes the bus timing of a run's frames, batch after batch."""

    def __init__(
        self, codecs: Mapping[str, Codec], inputs: Mapping[str, Sequence[Topic]], *, realtime: bool = False
    ) -> None:
        """Begin with all buses free.

        Args:
            codecs: codec of every bus; frames name the bus by its number here.
            inputs: inputs of each process, by its name (veh1.tracker); read with the first frame. A process not listed
                sends as soon as BenchSync has arrived.
            realtime: whether the wall clock paces the cycles.
        """
        self._codecs = codecs
        self._inputs = inputs
        self._realtime = realtime
        self._ports: list[_Port] = []
        self._ordered: list[_Port] = []
        self._homes: list[_Port] = []
        self._origin = 0
        self._serial = 0
        self._held = np.empty(0, FRAME)
        self._waiting: list[_Frame] = []

    def send(self, frames: npt.NDArray[Any], *, last: bool = False) -> npt.NDArray[Any]:
        """Send frames and return those whose timing is final.

        A frame still waiting at the end of the newest cycle may be overtaken by one of the next cycle; it is returned
        with a later batch. On buses that are overloaded for long, those of `MOST_HELD` and more are not overtaken.

        Args:
            frames: (n,) new ones as `FRAME`, `wire` 0, cycle after cycle, in lockstep complete cycles only; modified.
            last: whether no more frames will follow.

        Returns:
            (m,) frames with `wire` and `response`, by cycle; in lockstep sorted by end on the wire within a cycle,
            frames never sent last; in real time in the order of arrival.
        """
        if not self._ports:
            self._make_ports()
        new = self._waiting_frames(frames)
        table = np.concatenate([self._held, frames]) if self._waiting else frames
        waiting = self._waiting + new
        row: cython.Py_ssize_t
        frame: _Frame
        for row, frame in enumerate(waiting):
            frame.row = row
        absent: list[int] = []
        if not self._realtime:
            absent = self._send_cycles(new, frames["time"].data, table)
        elif new:
            self._origin = self._origin or int(frames["receive"][0] - frames["time"][0])
            self._send_received(new, frames["receive"], table)
        if last or len(self._held) > MOST_HELD:
            self._run(self._ordered, _NEVER, table)
        certain = table["wire"] > 0
        certain[absent] = True
        open_rows = np.flatnonzero(~certain)
        self._held, self._waiting = table[open_rows], [waiting[at] for at in open_rows.tolist()]
        table = table[certain] if len(open_rows) else table
        if self._realtime:
            return table
        keys = [table["wire"], table["time"]]
        if absent:
            missing = table["wire"] == 0
            # Announcements of absent frames arrive from several processes in any order.
            text = np.where(missing, np.ascontiguousarray(table["data"]).view(">u8")[:, 0], 0)
            keys = [text, np.where(missing, _NEVER, table["wire"]), table["time"]]
        return table[np.lexsort(keys)]

    def _make_ports(self) -> None:
        ports: dict[str, _Port] = {bus: _Port(codec) for bus, codec in self._codecs.items()}
        self._ports = list(ports.values())
        # Vehicles first: frames received on their buses release the planners' frames on v2v.
        self._ordered = [ports[bus] for bus in sorted(ports, key=lambda bus: bus == V2V)]
        senders: dict[tuple[str, str], int] = {}
        for bus, codec in self._codecs.items():
            self._note_lengths(ports[bus], codec)
            for each in transmissions(bus, codec):
                if each.sender and each.message != BENCH_SYNC:
                    # A planner also sends on v2v, in response to frames on its vehicle's bus.
                    own = each.sender.partition(".")[0]
                    home = own if own in ports else bus
                    port: _Port = ports[bus]
                    route: _Route = port.routes[each.can_id]
                    route.sender = senders.setdefault((each.sender, home), len(senders))
        self._homes = [ports[bus] for _, bus in senders]
        for (process, bus), sender in senders.items():
            port = ports[bus]
            self._note_inputs(port.routes, process, bus, sender)

    def _note_lengths(self, port: _Port, codec: Codec) -> None:
        route: _Route
        if BENCH_ABSENT in codec.names:
            route = port.routes[codec.can_id(BENCH_ABSENT)]
            route.absence = True
        if not self._realtime:
            # Wall-clock values must not change the timing of other frames: assume the maximum length.
            for can_id in filter(codec.is_wall_clock, codec.can_ids):
                route = port.routes[can_id]
                route.duration = _duration(longest_bits(8) - INTERFRAME_BITS, port)

    def _note_inputs(self, routes: dict[int, _Route], process: str, bus: str, sender: int) -> None:
        route: _Route = routes[self._codecs[bus].can_id(BENCH_SYNC)]
        route.readers.append(sender)
        for topic in self._inputs.get(process, ()) if process != PLANT else ():
            can_id = self._codecs[topic.bus].can_id(topic.message)
            if topic.bus == bus and not topic.delay:
                route = routes[can_id]
                if route.sender != sender:
                    route.readers.append(sender)

    def _waiting_frames(self, table: npt.NDArray[Any]) -> list[_Frame]:
        """Return new frames (n,) as objects, with their lengths and priorities."""
        buses: cython.ushort[:] = table["bus"].data
        identifiers: cython.uint[:] = table["can_id"].data
        bits: cython.longlong[:] = frame_bits(table["can_id"], table["length"], table["data"]).data
        ranks: cython.longlong[:] = priority(table["can_id"]).data
        frames: list[_Frame] = []
        ports: list[_Port] = self._ports
        row: cython.Py_ssize_t
        serial: cython.longlong = self._serial
        for row in range(len(table)):
            port: _Port = ports[buses[row]]
            route: _Route | None = port.routes.get(identifiers[row])
            frame: _Frame = _Frame.__new__(_Frame)
            frame.serial = serial + row
            frame.rank = ranks[row]
            frame.duration = _duration(bits[row], port)
            if route is not None and route.duration:
                frame.duration = route.duration
            frame.port = port
            frame.route = route
            frame.readers = _NOBODY
            frames.append(frame)
        self._serial += len(frames)
        return frames

    def _send_cycles(self, frames: list[_Frame], times: cython.longlong[:], table: npt.NDArray[Any]) -> list[int]:
        """Send complete cycles of lockstep; return the rows of frames never on the wire.

        Args:
            frames: new ones.
            times: simulated time of each.
            table: all frames.
        """
        wire: cython.longlong[:] = table["wire"].data
        response: cython.longlong[:] = table["response"].data
        absent: list[int] = []
        begin: cython.Py_ssize_t = 0
        end: cython.Py_ssize_t
        count: cython.Py_ssize_t = len(frames)
        port: _Port
        while begin < count:
            time: cython.longlong = times[begin]
            end = begin + 1
            while end < count and times[end] == time:
                end += 1
            self._open(time, frames[begin:end], absent)
            for port in self._ordered:
                port.run(time + CYCLE_NS, wire, response)
            begin = end
        return absent

    def _open(self, time: int, frames: list[_Frame], absent: list[int]) -> None:
        """Queue a cycle's frames: for the bus, or until their sender's inputs have arrived."""
        responses: list[_Response] = [_Response() for _ in self._homes]
        frame: _Frame
        reader: _Response
        for frame in frames:
            route: _Route | None = frame.route
            if route is None:
                _wait(frame, time)
                continue
            if route.absence:
                absent.append(frame.row)
                continue
            if route.readers:
                frame.readers = [responses[number] for number in route.readers]
                for reader in frame.readers:
                    reader.awaited += 1
            if route.sender < 0:
                _wait(frame, time)
            else:
                reader = responses[route.sender]
                reader.frames.append(frame)
        home: _Port
        for home, reader in zip(self._homes, responses, strict=True):
            if reader.frames and reader.awaited:
                home.waiting.append(reader)
            elif reader.frames:
                _release(reader, time)

    def _send_received(self, frames: list[_Frame], received: npt.NDArray[np.int64], table: npt.NDArray[Any]) -> None:
        """Send frames, which wait from their receipt on; see `_send_cycles`."""
        releases = received - self._origin
        frame: _Frame
        for frame, release in zip(frames, releases.tolist(), strict=True):
            _wait(frame, release)
        self._run(self._ports, int(releases.max()), table)

    def _run(self, ports: Sequence[_Port], until: int, table: npt.NDArray[Any]) -> None:
        port: _Port
        for port in ports:
            port.run(until, table["wire"].data, table["response"].data)


@cython.cfunc
def _duration(bits: cython.longlong, port: _Port) -> cython.longlong:
    """Return ns on the wire."""
    return bits * 1_000_000_000 // port.bit_rate


_NOBODY: list[_Response] = []
