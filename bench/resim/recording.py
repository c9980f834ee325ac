"""One ECU's part of a log: the frames of its buses, cycle by cycle, its own separated from its inputs."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from bench.bus.absence import BENCH_ABSENT, read_absence
from bench.bus.codec import Codec
from bench.bus.frame import BusFrame
from bench.bus.network import EcuSlot
from bench.bus.states import BenchCommand
from bench.bus.sync import BENCH_SYNC, read_sync
from bench.bus.topic import Topic
from bench.cycle import CYCLE_NS
from bench.faults.base import Fault
from bench.record.reader import Run
from bench.record.whole import whole_length


@dataclass(frozen=True)
class BusLog:
    """The frames of one bus in the order of their cycles.

    Attributes:
        table: (n,) frames, see `bench.record.reader.FRAME_TABLE`.
        cycles: (n,) number of each frame's cycle, rising.
        synced: (c,) whether the log has the BenchSync that opened cycle 0 .. c-1.
        realtime: whether that says that the wall clock paces the cycles.
        begun: (c,) when it was received, ns since 1970; 0 where the log does not have it.
    """

    table: npt.NDArray[Any]
    cycles: npt.NDArray[np.int64]
    synced: npt.NDArray[np.bool_]
    realtime: bool
    begun: npt.NDArray[np.int64]

    def of_cycle(self, cycle: int) -> npt.NDArray[Any]:
        """Return the frames of a cycle in the order of the log."""
        start, end = np.searchsorted(self.cycles, (cycle, cycle + 1))
        return self.table[start:end]


def read_buses(run: Run, codecs: Mapping[str, Codec], cycles: int) -> dict[str, BusLog]:
    """Return the frames of all buses that the log has, of the first `cycles` cycles.

    Raises:
        BadInput: the log holds frames that cannot be read.
    """
    return {bus: _bus_log(run, bus, codecs[bus], cycles) for bus in run.buses if bus in codecs}


def _bus_log(run: Run, bus: str, codec: Codec, limit: int) -> BusLog:
    table = run.frame_table(bus)
    # A damaged log may contain any time.
    table = table[(table["time"] >= 0) & (table["time"] < limit * CYCLE_NS)]
    cycles = table["time"] // CYCLE_NS
    order = np.argsort(cycles, kind="stable")
    table, cycles = table[order], cycles[order]
    synced = np.zeros(int(cycles[-1]) + 1 if len(cycles) else 0, np.bool_)
    begun = np.zeros(len(synced), np.int64)
    realtime = False
    for row in table[table["can_id"] == codec.can_id(BENCH_SYNC)]:
        sync = read_sync(codec.layout(BENCH_SYNC), _data(row))
        # The log has a refused one, whatever cycle it names, in that in which it came.
        if sync is None or sync.command is BenchCommand.STOP or sync.cycle != row["time"] // CYCLE_NS:
            continue
        if not synced[sync.cycle]:
            synced[sync.cycle], begun[sync.cycle] = True, int(row["receive"])
            realtime = sync.realtime
    return BusLog(table, cycles, synced, realtime, begun)


def _data(row: Any) -> bytes:
    return bytes(row["data"].tobytes()[: int(row["length"])])


def frames_of(bus: str, rows: npt.NDArray[Any]) -> list[BusFrame]:
    """Return rows of a bus's table as frames."""
    data = rows["data"].tobytes()
    sizes = zip(rows["can_id"].tolist(), rows["length"].tolist(), strict=True)
    return [BusFrame(bus, can_id, data[8 * n : 8 * n + length]) for n, (can_id, length) in enumerate(sizes)]


def _first_gap(synced: Sequence[npt.NDArray[np.bool_]]) -> int:
    """Return the first cycle whose start is missing on some bus."""
    cycles = min(map(len, synced))
    everywhere = np.logical_and.reduce([each[:cycles] for each in synced])
    return cycles if everywhere.all() else int(np.argmin(everywhere))


class EcuLog:
    """The frames of an ECU's buses.

    Attributes:
        slot: which ECU.
        buses: its buses' frames, by name, in the order the ECU has its links in.
        end: the first cycle not compared because the log does not hold it completely.
        whole: whether that is the end of the run.
    """

    def __init__(
        self,
        slot: EcuSlot,
        buses: Mapping[str, BusLog],
        codecs: Mapping[str, Codec],
        faults: Collection[Fault],
        *,
        cycles: int | None,
        until: int | None = None,
    ) -> None:
        """Select the ECU's buses.

        Args:
            slot: which ECU.
            buses: the log's buses.
            codecs: codec of every bus.
            faults: all faults of the run.
            cycles: how many the run had; None where it was not completed or its log has no end.
            until: the cycle in which the ECU failed, None where it did not.
        """
        self.slot = slot
        self.codecs = {bus: codecs[bus] for bus in slot.buses}
        self.buses = {bus: buses[bus] for bus in self.codecs if bus in buses}
        self._absent_ids = {bus: codec.can_id(BENCH_ABSENT) for bus, codec in self.codecs.items()}
        self._own = {
            bus: frozenset(codecs[bus].can_id(t.message) for t in self._sends if t.bus == bus) for bus in self.codecs
        }
        for bus, log in self.buses.items():
            # Frames of its identifiers in another length are somebody else's.
            kept = whole_length(log.table, self.codecs[bus]) | ~np.isin(log.table["can_id"], list(self._own[bus]))
            self.buses[bus] = replace(log, table=log.table[kept], cycles=log.cycles[kept])
        others = {bus: frozenset(codec.can_ids) - self._own[bus] for bus, codec in self.codecs.items()}
        places = {place for fault in faults for place in fault.identifiers(slot.name)}
        # Frames with another node's identifier cannot be distinguished from that node's.
        self._babble = {(bus, can_id) for bus, can_id in places if can_id not in others[bus]}
        gap = _first_gap([log.synced for log in self.buses.values()]) if len(self.buses) == len(self.codecs) else 0
        self.whole = cycles is not None and gap >= cycles
        # In a truncated run the newest cycle may be incomplete.
        self.end = gap if self.whole else max(0, gap - 1)
        if until is not None:
            self.end = min(self.end, until)

    @property
    def realtime(self) -> bool:
        """Whether the wall clock paced the cycles."""
        return any(log.realtime for log in self.buses.values())

    @cached_property
    def ran(self) -> bool:
        """Whether the log has any frame of this ECU."""
        return any(bool(np.isin(log.table["can_id"], list(self._own[bus])).any()) for bus, log in self.buses.items())

    def has(self, topic: Topic) -> bool:
        """Return whether the log has any frame of a message."""
        recorded = self.buses.get(topic.bus)
        return recorded is not None and self.codecs[topic.bus].can_id(topic.message) in recorded.table["can_id"]

    @property
    def _sends(self) -> list[Topic]:
        return self.slot.sends(self.codecs)

    def is_own(self, frame: BusFrame) -> bool:
        """Return whether this ECU sends the frame's identifier, or announces one of its frames as absent."""
        bus, can_id, _ = frame
        if can_id == self._absent_ids[bus]:
            return self.absent(frame) in self._own[bus]
        return self.sends(bus, can_id)

    def sends(self, bus: str, can_id: int) -> bool:
        """Return whether frames of this identifier on this bus are the ECU's."""
        return can_id in self._own[bus] or (bus, can_id) in self._babble

    def own_rows(self, bus: str) -> npt.NDArray[np.bool_]:
        """Return which frames of a bus's table carry an identifier that this ECU sends."""
        own = [*self._own[bus], *(can_id for on, can_id in self._babble if on == bus)]
        return np.isin(self.buses[bus].table["can_id"], own)

    def absent(self, frame: BusFrame) -> int | None:
        """Return which identifier a frame announces as absent, None where it does not."""
        bus, can_id, data = frame
        absence = read_absence(self.codecs[bus].layout(BENCH_ABSENT), data) if can_id == self._absent_ids[bus] else None
        return None if absence is None else absence.can_id

    def cycle(self, number: int) -> list[BusFrame]:
        """Return all frames of a cycle on the ECU's buses: BenchSync first, what is announced as absent last.

        This is the order of sending: an absence is announced after any other frame of its identifier. The log is in
        wire order.
        """
        frames = [f for bus, log in self.buses.items() for f in frames_of(bus, log.of_cycle(number))]
        syncs = {bus: codec.can_id(BENCH_SYNC) for bus, codec in self.codecs.items()}
        return sorted(frames, key=lambda f: (f.can_id != syncs[f.bus], f.can_id == self._absent_ids[f.bus]))
