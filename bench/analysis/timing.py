"""Timing of a real-time run: response times, jitter, missed deadlines, and the lateness of the clock.

A cycle starts on a bus when its BenchSync is received there. The response time of an ECU runs from then to its last
frame with an alive counter in that cycle, by kernel receive times; its deadline is the next BenchSync. The same holds
for the plant, separately on each bus. Jitter is the maximum minus the minimum response time.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.analysis.step_times import percentiles
from bench.bus.codec import Codec
from bench.bus.network import transmissions
from bench.bus.sync import BENCH_SYNC
from bench.cycle import CYCLE_MS, CYCLE_NS
from bench.errors import BadInput
from bench.names import PLANT, vehicle_bus
from bench.record.reader import Run
from bench.record.whole import whole

BIN_MS = 0.25
LONGEST_MS = 2.0 * CYCLE_MS
"""Upper end of the histograms; their last bin also counts everything longer."""

PERCENTILES = (1.0, 50.0, 99.0, 99.9)

_MOST_CYCLES = 1000
"""Limit per frame of the clock; with more cycles, the times of the log are wrong."""


@dataclass(frozen=True)
class NodeTiming:
    """Timing of an ECU, or of the plant on one bus.

    Attributes:
        name: e.g. veh1.tracker; veh1.plant for the plant.
        cycles: number of deadlines.
        late: number of cycles in which it was late.
        missing: number of cycles in which it sent nothing.
        longest_miss: greatest number of consecutive missed deadlines.
        response_ms: (n,) response time of each cycle in which it sent.
    """

    name: str
    cycles: int
    late: int
    missing: int
    longest_miss: int
    response_ms: NDArray[np.float64]

    @property
    def misses(self) -> int:
        """Number of missed deadlines."""
        return self.late + self.missing

    @property
    def miss_rate(self) -> float:
        """Missed deadlines as a fraction of all deadlines."""
        return self.misses / self.cycles if self.cycles else 0.0

    def response(self, percentile: float) -> float | None:
        """Return a percentile of the response time in ms; None without response times."""
        return next(iter(percentiles(self.response_ms, [percentile]).values()), None)

    @property
    def jitter_ms(self) -> float:
        """Maximum minus minimum response time, ms."""
        return float(np.ptp(self.response_ms)) if self.response_ms.size else 0.0


@dataclass(frozen=True)
class Timing:
    """Timing of a run.

    Attributes:
        cycles: number of cycles that the clock started.
        clock_late_ms: (n,) lateness of BenchSync in each cycle, relative to the grid through the earliest one.
        nodes: ECUs and plant, by vehicle.
    """

    cycles: int
    clock_late_ms: NDArray[np.float64]
    nodes: tuple[NodeTiming, ...]

    @property
    def miss_rate(self) -> float:
        """Missed deadlines of the ECUs as a fraction of all their deadlines."""
        ecus = [node for node in self.nodes if not node.name.endswith(f".{PLANT}")]
        deadlines = sum(node.cycles for node in ecus)
        return sum(node.misses for node in ecus) / deadlines if deadlines else 0.0


def timing(run: Run) -> Timing | None:
    """Return the timing of a real-time run on the buses whose DBC file is in the log.

    None if there is no such bus, and for a run in lockstep, where wall-clock times mean nothing.

    Raises:
        BadInput: the log is incomplete, or has impossible times.
    """
    if run.metadata.get("clock") != "realtime":
        return None
    buses = [vehicle_bus(number) for number in range(1, run.vehicles + 1)]
    codecs = {bus: codec for bus in buses if (codec := run.codec(bus))}
    if not codecs:
        return None
    nodes: list[NodeTiming] = []
    late = np.empty(0)
    for bus, codec in codecs.items():
        table = run.frame_table(bus)
        table = table[whole(table, codec)]
        begun = _first_receipts(table, codec.can_id(BENCH_SYNC))
        # The last BenchSync only ends the run, some time after the end of the last cycle.
        count = begun.size - 1
        if count < 1:
            continue
        begun[count] = min(begun[count], begun[count - 1] + CYCLE_NS)
        if not late.size:
            from_grid = begun[:count] - np.arange(count) * CYCLE_NS
            late = (from_grid - np.nanmin(from_grid)) / 1e6
        for name, can_ids in _senders(codec, bus).items():
            done = np.full(count, np.nan)
            for can_id in can_ids:
                done = np.fmax(done, _first_receipts(table, can_id, count))
            nodes.append(_node(name, begun, done))
    return Timing(late.size, late, tuple(nodes))


def histograms(times: Timing) -> dict[str, Any]:
    """Return what a page needs to draw the timing, as plain numbers.

    `edges_ms`: (m + 1) edges of all histograms. `clock`: `counts` (m), `p99_ms`, `max_ms` of the lateness of BenchSync.
    `nodes`: for each `name`, `cycles`, `late`, `missing`, `longest_miss`, `miss_rate`, `jitter_ms`, `response_ms` (by
    percentile: `p1`, `p50`, `p99`, `p99.9`, `max`) and `counts` (m). `period_ms` is the cycle, `miss_rate` the fraction
    of the ECUs' deadlines that were missed.
    """
    edges = np.arange(0.0, LONGEST_MS + BIN_MS, BIN_MS)
    return {
        "period_ms": CYCLE_MS,
        "cycles": times.cycles,
        "miss_rate": times.miss_rate,
        "edges_ms": edges.tolist(),
        "clock": {
            "counts": _counts(times.clock_late_ms, edges),
            **{f"{key}_ms": value for key, value in _percentiles(times.clock_late_ms).items() if key in ("p99", "max")},
        },
        "nodes": [
            {
                "name": node.name,
                "cycles": node.cycles,
                "late": node.late,
                "missing": node.missing,
                "longest_miss": node.longest_miss,
                "miss_rate": node.miss_rate,
                "jitter_ms": node.jitter_ms,
                "response_ms": _percentiles(node.response_ms),
                "counts": _counts(node.response_ms, edges),
            }
            for node in times.nodes
        ],
    }


def _senders(codec: Codec, bus: str) -> Mapping[str, list[int]]:
    """Return, by node, the identifiers of the frames with an alive counter that it sends every cycle on its bus."""
    senders: dict[str, list[int]] = {}
    for each in transmissions(bus, codec):
        if each.has_deadline:
            senders.setdefault(each.station, []).append(each.can_id)
    return senders


def _first_receipts(table: NDArray[Any], can_id: int, count: int | None = None) -> NDArray[np.float64]:
    """Return when the first frame of this identifier arrived in each of `count` cycles (None: all), ns; NaN for none.

    Raises:
        BadInput: there are far more cycles than frames.
    """
    rows = table[table["can_id"] == can_id]
    cycles = rows["time"] // CYCLE_NS
    count = int(cycles.max(initial=-1)) + 1 if count is None else count
    if count > _MOST_CYCLES * (rows.size + 1):
        raise BadInput(f"frame 0x{can_id:03X} has impossible times: {rows.size} frames up to cycle {count - 1}")
    receipts = np.full(count, np.inf)
    inside = (cycles >= 0) & (cycles < count)
    # Relative to the first frame: in float64, absolute times have a resolution of 256 ns.
    times = (rows["receive"][inside] - table["receive"][0]).astype(np.float64)
    np.minimum.at(receipts, cycles[inside], times)
    return np.where(np.isinf(receipts), np.nan, receipts)


def _node(name: str, begun: NDArray[np.float64], done: NDArray[np.float64]) -> NodeTiming:
    missing = np.isnan(done)
    late = done > begun[1:]
    missed = np.concatenate([[0], (missing | late).astype(int), [0]])
    starts, ends = np.flatnonzero(np.diff(missed) == 1), np.flatnonzero(np.diff(missed) == -1)
    response = (done - begun[:-1]) / 1e6
    return NodeTiming(
        name,
        cycles=done.size,
        late=int(late.sum()),
        missing=int(missing.sum()),
        longest_miss=int((ends - starts).max(initial=0)),
        response_ms=response[np.isfinite(response)],
    )


def _percentiles(values: NDArray[np.float64]) -> dict[str, float]:
    found = percentiles(values, PERCENTILES)
    return {**found, "max": float(values.max())} if found else {}


def _counts(values: NDArray[np.float64], edges: NDArray[np.float64]) -> list[int]:
    counts: list[int] = np.histogram(np.clip(values, edges[0], edges[-1]), edges)[0].tolist()
    return counts
