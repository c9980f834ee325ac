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

from collections.abc import Mapping, Sequence
from heapq import heappop, heappush
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt

from bench.bus.absence import BENCH_ABSENT
from bench.bus.codec import Codec
from bench.bus.network import transmissions
from bench.bus.sync import BENCH_SYNC
from bench.bus.topic import Topic
from bench.bus.wire.frame_length import INTERFRAME_BITS, frame_bits, longest_bits, priority
from bench.cycle import CYCLE_NS
from bench.names import PLANT, V2V

MOST_HELD = 20_000
"""Number of frames that wait for their time on the wire; beyond it, a flood's are sent whatever may follow."""

_NEVER = 1 << 62

FRAME = np.dtype(
    [
        ("bus", "<u2"),
        ("length", "u1"),
        ("can_id", "<u4"),
        ("time", "<i8"),
        ("receive", "<i8"),
        ("data", "u1", (8,)),
        ("wire", "<i8"),
        ("response", "<i8"),
        ("refused", "u1"),
    ]
)
"""A frame: number of its bus; data padded with zeros; simulated time of its cycle, receive time on the host, end on the
wire (simulated; 0 if never sent) and response time, all in ns; whether it was refused, 1 or 0."""


class _Cycle:
    """One cycle on a vehicle's bus: the senders yet to send, and the number of frames each still waits for."""

    __slots__ = ("left", "waiting")

    def __init__(self) -> None:
        self.left: dict[str, int] = {}
        # By sender: port, priority, serial number, ns on the wire, identifier.
        self.waiting: dict[str, list[tuple[_Port, int, int, int, int]]] = {}

    def release(self, process: str, time: int) -> None:
        """Release the frames of a process at `time`."""
        for port, rank, serial, duration, can_id in self.waiting.pop(process, ()):
            heappush(port.to_come, (time, rank, serial, duration, can_id, self))


class _Port:
    """One bus.

    Attributes:
        readers: the processes that wait for a frame, by its identifier.
        routes: by identifier of frames sent in response to others, the sender and the bus whose frames it waits for.
        free: time from which the next frame may begin.
        ready: frames that wait for the bus: priority, serial number, release, ns on the wire, identifier, cycle.
        to_come: the same for frames released later than `free`: release, priority, ...
        open_cycles: cycles in which some sender has yet to send.
    """

    def __init__(self, name: str, codec: Codec) -> None:
        self.name = name
        self.bit_rate = codec.bit_rate
        self.interframe = INTERFRAME_BITS * 1_000_000_000 // codec.bit_rate
        self.sync_id = codec.can_id(BENCH_SYNC)
        self.absent_id = codec.can_id(BENCH_ABSENT) if BENCH_ABSENT in codec.names else -1
        self.senders = {
            each.can_id: each.sender
            for each in transmissions(name, codec)
            if each.sender and each.can_id != self.sync_id
        }
        self.readers: dict[int, list[str]] = {}
        self.routes: dict[int, tuple[str, _Port]] = {}
        self.free = 0
        self.ready: list[tuple[int, int, int, int, int, _Cycle | None]] = []
        self.to_come: list[tuple[int, int, int, int, int, _Cycle | None]] = []
        self.open_cycles: list[_Cycle] = []

    def run(self, until: int, done: list[tuple[int, int, int]]) -> None:
        """Send all frames that begin before `until`; add serial number, end and response time to `done`."""
        while True:
            self._send(until, done)
            self.open_cycles = [cycle for cycle in self.open_cycles if cycle.waiting]
            if self.ready or self.to_come or not self.open_cycles:
                return
            # Two senders that wait for each other would wait for ever; on a bench neither would have sent.
            for cycle in self.open_cycles:
                for process in list(cycle.waiting):
                    cycle.release(process, self.free - self.interframe)

    def _send(self, until: int, done: list[tuple[int, int, int]]) -> None:
        ready, to_come, readers, free, interframe = self.ready, self.to_come, self.readers, self.free, self.interframe
        while ready or to_come:
            if not ready and to_come[0][0] > free:
                free = to_come[0][0]
            if free >= until:
                break
            while to_come and to_come[0][0] <= free:
                release, rank, serial, duration, can_id, cycle = heappop(to_come)
                heappush(ready, (rank, serial, release, duration, can_id, cycle))
            _, serial, release, duration, can_id, cycle = heappop(ready)
            end = free + duration
            free = end + interframe
            done.append((serial, end, end - release))
            if cycle is not None and can_id in readers:
                left = cycle.left
                for process in readers[can_id]:
                    left[process] -= 1
                    if not left[process]:
                        cycle.release(process, end)
        self.free = free


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
        self._origin = 0
        self._serial = 0
        self._held = np.empty(0, FRAME)
        self._held_serials = np.empty(0, np.int64)

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
        serials = np.arange(self._serial, self._serial + len(frames))
        self._serial += len(frames)
        done: list[tuple[int, int, int]] = []
        absent = self._realtime_batch(frames, serials, done) if self._realtime else self._cycles(frames, serials, done)
        if last or len(self._held) > MOST_HELD:
            # Vehicles first: frames received on their buses release the planners' frames on v2v.
            for port in self._in_order():
                port.run(_NEVER, done)
        if len(self._held):
            frames = np.concatenate([self._held, frames])
            serials = np.concatenate([self._held_serials, serials])
        rows, ends = np.searchsorted(serials, [row[0] for row in done]), np.array(done, np.int64).reshape(-1, 3)
        frames["wire"][rows], frames["response"][rows] = ends[:, 1], ends[:, 2]
        certain = frames["wire"] > 0
        certain[np.searchsorted(serials, absent)] = True
        self._held, self._held_serials = frames[~certain], serials[~certain]
        frames = frames[certain]
        if self._realtime:
            return frames
        missing = frames["wire"] == 0
        # Announcements of absent frames arrive from several processes in any order.
        text = np.where(missing, np.ascontiguousarray(frames["data"]).view(">u8")[:, 0], 0)
        return frames[np.lexsort((text, np.where(missing, _NEVER, frames["wire"]), frames["time"]))]

    def _make_ports(self) -> None:
        self._ports = [_Port(bus, codec) for bus, codec in self._codecs.items()]
        by_name = {port.name: port for port in self._ports}
        for port in self._ports:
            port.readers = {port.sync_id: []}
            for can_id, process in port.senders.items():
                # A planner also sends on v2v, in response to frames on its vehicle's bus.
                home = by_name.get(process.partition(".")[0], port)
                port.routes[can_id] = process, home
        for process, home in {route for port in self._ports for route in port.routes.values()}:
            home.readers[home.sync_id].append(process)
            for topic in self._inputs.get(process, ()) if process != PLANT else ():
                can_id = self._codecs[topic.bus].can_id(topic.message)
                if topic.bus == home.name and not topic.delay and home.senders.get(can_id) != process:
                    home.readers.setdefault(can_id, []).append(process)

    def _in_order(self) -> list[_Port]:
        return sorted(self._ports, key=lambda port: port.name == V2V)

    def _cycles(
        self, frames: npt.NDArray[Any], serials: npt.NDArray[np.int64], done: list[tuple[int, int, int]]
    ) -> list[int]:
        """Process complete cycles of lockstep; return the serial numbers of frames never on the wire."""
        absent: list[int] = []
        ordered = self._in_order()
        times = frames["time"]
        rows = self._rows(frames, serials)
        changes = (np.flatnonzero(times[1:] != times[:-1]) + 1).tolist()
        for start, end in pairwise([0, *changes, len(rows)] if rows else []):
            time = int(times[start])
            self._open(time, rows[start:end], absent)
            for port in ordered:
                port.run(time + CYCLE_NS, done)
        return absent

    def _open(self, time: int, rows: list[tuple[int, int, int, int, int]], absent: list[int]) -> None:
        """Queue a cycle's frames: for the bus, or until their sender's inputs have arrived."""
        cycles = {port: _Cycle() for port in self._ports}
        for number, can_id, rank, duration, serial in rows:
            port = self._ports[number]
            if can_id == port.absent_id:
                absent.append(serial)
                continue
            if can_id in port.readers:
                left = cycles[port].left
                for reader in port.readers[can_id]:
                    left[reader] = left.get(reader, 0) + 1
            if can_id in port.routes:
                process, home = port.routes[can_id]
                cycles[home].waiting.setdefault(process, []).append((port, rank, serial, duration, can_id))
            else:
                heappush(port.to_come, (time, rank, serial, duration, can_id, cycles[port]))
        for port, cycle in cycles.items():
            port.open_cycles.append(cycle)
            for process in [name for name in cycle.waiting if name not in cycle.left]:
                cycle.release(process, time)

    def _realtime_batch(
        self, frames: npt.NDArray[Any], serials: npt.NDArray[np.int64], done: list[tuple[int, int, int]]
    ) -> list[int]:
        if not len(frames):
            return []
        if not self._origin:
            self._origin = int(frames["receive"][0] - frames["time"][0])
        releases = (frames["receive"] - self._origin).tolist()
        for release, (number, can_id, rank, duration, serial) in zip(
            releases, self._rows(frames, serials), strict=True
        ):
            heappush(self._ports[number].to_come, (release, rank, serial, duration, can_id, None))
        newest = max(releases)
        for port in self._ports:
            port.run(newest, done)
        return []

    def _rows(self, frames: npt.NDArray[Any], serials: npt.NDArray[np.int64]) -> list[tuple[int, int, int, int, int]]:
        """Number of the bus, identifier, priority, ns on the wire and serial number of each frame."""
        rates = np.array([port.bit_rate for port in self._ports], np.int64)
        bits = frame_bits(frames["can_id"], frames["length"], frames["data"])
        if not self._realtime:
            # Wall-clock values must not change the timing of other frames: assume the maximum length.
            for number, codec in enumerate(self._codecs.values()):
                clocked = [can_id for can_id in codec.can_ids if codec.is_wall_clock(can_id)]
                rows = (frames["bus"] == number) & np.isin(frames["can_id"], clocked)
                bits[rows] = longest_bits(8) - INTERFRAME_BITS
        duration = bits * 1_000_000_000 // rates[frames["bus"]]
        ranks = priority(frames["can_id"])
        columns = (frames["bus"], frames["can_id"], ranks, duration, serials)
        return list(zip(*(column.tolist() for column in columns), strict=True))
