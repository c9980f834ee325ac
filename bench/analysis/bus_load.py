"""The load of each bus in a run, and the response times of its messages next to their worst-case bounds.

A response time runs from the release of a frame, when it starts to wait for its bus, to its end on the wire (see
`bench.bus.wire.timing`). The bound is that of `bench.bus.wire.schedulability` with the release jitter measured in the
run: the range of a message's release times within the cycle. In lockstep, computing takes no time, so an ECU's release
varies only with the frames it waits for; in real time the jitter includes computing time and scheduling.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from bench.bus.codec import Codec
from bench.bus.link.base import EXTENDED
from bench.bus.network import transmissions
from bench.bus.sync import BENCH_SYNC
from bench.bus.wire.frame_length import INTERFRAME_BITS, frame_bits
from bench.bus.wire.schedulability import Stream, load, response_times, streams
from bench.cycle import CYCLE_NS
from bench.record import Run

_S = 1e9


@dataclass(frozen=True)
class MessageTimes:
    """Response times of one message on its bus.

    Attributes:
        name: as in the DBC; empty for an identifier not in the DBC.
        can_id: identifier; the bit `EXTENDED` is set for a 29-bit one.
        sender: the process that sends it; empty if unknown.
        count: number of frames.
        mean_s, worst_s: response times in s.
        jitter_s: release jitter, the range of its release times within the cycle, s.
        bound_s: worst-case response time without faults, s; None if there is no bound.
        period_s: period, which is also the deadline, s; None for a message that is not periodic.
    """

    name: str
    can_id: int
    sender: str
    count: int
    mean_s: float
    worst_s: float
    jitter_s: float
    bound_s: float | None = None
    period_s: float | None = None

    @property
    def in_time(self) -> bool:
        """Whether no frame took longer than the period."""
        return self.period_s is None or self.worst_s <= self.period_s

    @property
    def in_bound(self) -> bool:
        """Whether no frame took longer than the bound; only faults and frames from outside can exceed it."""
        return self.bound_s is None or self.worst_s <= self.bound_s


@dataclass(frozen=True)
class SentFrame:
    """A frame in its cycle: when it was released, started and ended on the wire, in s from the start of the cycle."""

    name: str
    can_id: int
    sender: str
    release_s: float
    start_s: float
    end_s: float


@dataclass(frozen=True)
class BusLoad:
    """The load of one bus in a run.

    Attributes:
        bus: its name.
        bit_rate: in bit/s.
        t: (n,) times in s of the cycles that contain frames.
        load: (n,) bus load in each of them, as a fraction, including interframe spaces.
        cycles: number of cycles from the first of them to the last.
        most: upper bound of the mean load: all periodic messages of the DBC at their greatest length.
        messages: in order of priority.
        busiest: the frames of the cycle with the highest load, in order on the wire.
    """

    bus: str
    bit_rate: int
    t: npt.NDArray[np.float64]
    load: npt.NDArray[np.float64]
    cycles: int
    most: float
    messages: tuple[MessageTimes, ...]
    busiest: tuple[SentFrame, ...]

    @property
    def mean(self) -> float:
        """Mean load over all cycles."""
        return float(self.load.sum()) / self.cycles

    @property
    def worst(self) -> float:
        """Load of the busiest cycle."""
        return float(self.load.max())

    @property
    def worst_at_s(self) -> float:
        """Time of the busiest cycle, s."""
        return float(self.t[self.load.argmax()])


def bus_loads(run: Run) -> list[BusLoad]:
    """Return the load of each bus of a run that has a usable DBC file and times on the wire."""
    found = []
    for bus in run.buses:
        codec = run.codec(bus)
        if codec is None:
            continue
        frames = run.frame_table(bus)
        frames = frames[frames["wire"] > 0]
        cycles = frames["time"] // CYCLE_NS
        # The BenchSync that ends the run starts a cycle in which nothing is sent.
        working = cycles[frames["can_id"] != codec.can_id(BENCH_SYNC)]
        frames = frames[cycles <= working.max()] if len(working) else frames[:0]
        if len(frames):
            found.append(_bus_load(bus, codec, run.vehicles, frames))
    return found


def _bus_load(bus: str, codec: Codec, vehicles: int, frames: npt.NDArray[Any]) -> BusLoad:
    bits = frame_bits(frames["can_id"], frames["length"], frames["data"])
    # Not a table of all cycles: a damaged log may claim any number of them.
    cycles, cycle = np.unique(frames["time"] // CYCLE_NS, return_inverse=True)
    share = np.bincount(cycle, bits + INTERFRAME_BITS) * _S / (codec.bit_rate * CYCLE_NS)
    periodic = streams(bus, codec, vehicles)
    busiest = np.flatnonzero(cycle == share.argmax())
    names = _names(bus, codec)
    return BusLoad(
        bus=bus,
        bit_rate=codec.bit_rate,
        t=cycles * CYCLE_NS / _S,
        load=share,
        cycles=int(cycles[-1]) - int(cycles[0]) + 1,
        most=load(periodic, codec.bit_rate),
        messages=tuple(_messages(frames, names, periodic, codec.bit_rate)),
        busiest=tuple(_sent(frames[busiest], bits[busiest], names, codec.bit_rate)),
    )


def _messages(
    frames: npt.NDArray[Any], names: Mapping[int, tuple[str, str]], periodic: list[Stream], bit_rate: int
) -> Iterator[MessageTimes]:
    offset = frames["wire"] - frames["response"] - frames["time"]
    rows = {can_id: np.flatnonzero(frames["can_id"] == can_id) for can_id in np.unique(frames["can_id"]).tolist()}
    jitter = {can_id: int(np.ptp(offset[found])) for can_id, found in rows.items()}
    released = [replace(stream, jitter_ns=jitter.get(stream.can_id, 0)) for stream in periodic]
    bounds = response_times(released, bit_rate)
    periods = {stream.can_id: stream.period_ns for stream in periodic}
    for can_id, found in rows.items():
        response, bound = frames["response"][found], bounds.get(can_id)
        name, sender = names.get(can_id, ("", ""))
        yield MessageTimes(
            name=name,
            can_id=can_id,
            sender=sender,
            count=len(found),
            mean_s=float(response.mean()) / _S,
            worst_s=int(response.max()) / _S,
            jitter_s=jitter[can_id] / _S,
            bound_s=None if bound is None else bound.from_release_ns / _S,
            period_s=periods[can_id] / _S if can_id in periods else None,
        )


def _sent(
    frames: npt.NDArray[Any],
    bits: npt.NDArray[np.int64],
    names: Mapping[int, tuple[str, str]],
    bit_rate: int,
) -> Iterator[SentFrame]:
    for row in np.argsort(frames["wire"], kind="stable").tolist():
        frame = frames[row]
        end = int(frame["wire"] - frame["time"]) / _S
        name, sender = names.get(int(frame["can_id"]), ("", ""))
        yield SentFrame(
            name=name,
            can_id=int(frame["can_id"]),
            sender=sender,
            release_s=end - int(frame["response"]) / _S,
            start_s=end - int(bits[row]) / bit_rate,
            end_s=end,
        )


def _names(bus: str, codec: Codec) -> dict[int, tuple[str, str]]:
    """Name and sender of each message by identifier."""
    names = {}
    for each in transmissions(bus, codec):
        extended = EXTENDED if codec.described(each.message).is_extended else 0
        names[each.can_id | extended] = each.message, each.sender
    return names
