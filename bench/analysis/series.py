"""The values that figures are drawn from: of a complete run, or of a span of a run in progress."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from bench.analysis.motion import Array, Motion, motion
from bench.analysis.told import told
from bench.cycle import CYCLE_S
from bench.names import vehicle_bus
from bench.record import Run
from bench.record.time_join import Rows, last_until, same_times, whole_ns

MAX_POINTS = 2400
"""A curve with more samples is thinned to at most this many."""

Span = tuple[float, float]
"""Start (inclusive) and end (exclusive), s."""

Pool = dict[str, list[float | None]]


class Series:
    """Values at the times of a run's ground truth, thinned to at most `MAX_POINTS`.

    Attributes:
        truth: the motion at these times, before thinning.
        live: whether the run is in progress, so that missing values may still arrive.
        pool: key -> values; None for a missing value.
        over_time: keys of the values that are over time.
    """

    def __init__(self, run: Run, span: Span | None = None) -> None:
        """Take the values of all of `run`, or of a span of a run in progress; an empty span gives empty columns.

        The concatenated columns of consecutive spans are on one time grid.

        Raises:
            BadInput: the log has no ground truth or no scenario.
        """
        self._run = run
        self.live = span is not None
        self.pool: Pool = {}
        self.over_time: list[str] = []
        if span is None:
            self.truth = motion(run)
            stride = -(-len(self.truth.t) // MAX_POINTS)
            self._kept = np.arange(0, len(self.truth.t), stride)
        else:
            self.truth = _within(run, span)
            stride = -(-round(run.scenario.duration_s / CYCLE_S) // MAX_POINTS)
            self._kept = np.flatnonzero(np.rint(self.truth.t / CYCLE_S).astype(np.int64) % stride == 0)

    def signal(self, v: int, message: str, signal: str, *, hold: bool = False, points: bool = False) -> Array | None:
        """Return a signal of vehicle `v` at all times, NaN for missing values; None if its ECU sent none, see `told`.

        Between the frames of a message that is not sent in every cycle it is on a straight line; with `hold` a value is
        held until the message is due again, and with `points` there is none.
        """
        found = np.full(len(self.truth.t), np.nan)
        sent = told(self._run, v, message, signal)
        if sent is None:
            return found if self.live and self._run.has(f"veh{v}", message) else None
        times, values = sent
        period_s = self._period_s(v, message)
        if period_s > CYCLE_S and not hold and not points:
            return between(times, values, self.truth.t, period_s)
        hold = hold and len(times) > 1
        rows, at = until_due(times, self.truth.t) if hold else same_times(times, self.truth.t)
        found[at] = values[rows]
        return found

    def _period_s(self, v: int, message: str) -> float:
        """Return the cycle time of a message by the log's DBC file (s)."""
        codec = self._run.codec(vehicle_bus(v))
        return CYCLE_S * (codec.period(message) if codec is not None and message in codec.names else 1)

    def felt(self, v: int, name: str) -> Array | None:
        """Return a column of `Run.comfort` of vehicle `v` at all times, NaN for missing values; None if it has none.

        What needs values of other times is left out of a run in progress, of which a span is all there is.
        """
        if self.live:
            return self.true(v, name) if name in ("a_x", "a_y") else None
        if self.true(v, "a_x") is None or self.true(v, "a_y") is None:
            return None
        felt = self._run.comfort(v)
        values = np.full(len(self.truth.t), np.nan)
        rows, at = same_times(felt["t"], self.truth.t)
        values[at] = felt[name][rows]
        return values

    def true(self, v: int, name: str) -> Array | None:
        """Return the ground truth `name` of vehicle `v` at all times; None if it was not recorded."""
        columns = self._run.truth(v) if f"/truth/veh{v}" in self._run.topics else {}
        if name not in columns:
            return None
        values = np.full(len(self.truth.t), np.nan)
        rows, at = same_times(columns["t"], self.truth.t)
        values[at] = columns[name][rows]
        return values

    def put(self, key: str, values: Array, *, peak: bool = False) -> None:
        """Put values at all times into the pool, thinned to the first of each group, or the largest if `peak`."""
        kept = self._kept
        thinned = np.fmax.reduceat(values, kept) if peak and len(kept) else values[kept]
        self.over_time.append(key)
        self.put_as_is(key, thinned)

    def put_as_is(self, key: str, values: npt.NDArray[Any] | Sequence[float]) -> None:
        """Put values that are not over time into the pool."""
        self.pool[key] = list(short(values))


def _within(run: Run, span: Span) -> Motion:
    """Return the motion in a span of time, with the platoon's order from the scenario."""
    starts = np.array([vehicle.x_m for vehicle in run.scenario.vehicles])
    order = tuple(int(index) for index in np.argsort(-starts, kind="stable"))
    start, end = span
    if end <= start:
        none = np.empty((len(starts), 0))
        return Motion(np.empty(0), none, none, none, none, none, none, order)
    whole = motion(run)
    rows = np.flatnonzero((whole.t >= start - 1e-9) & (whole.t < end - 1e-9))
    columns = {name: getattr(whole, name)[:, rows] for name in ("X", "Y", "psi", "v_x", "gamma", "mu")}
    return replace(whole, t=whole.t[rows], order=order, **columns)


def until_due(times: Array, t: Array) -> tuple[Rows, Rows]:
    """Return index pairs (message, time): message at `times` (m > 1,) s, ascending, is valid at `t` (n,) s.

    A message is valid from its arrival until the next one is due.
    """
    rows = last_until(whole_ns(times), whole_ns(t))
    period_s = float(np.median(np.diff(times)))
    at = np.flatnonzero((rows >= 0) & (t - times[rows] < period_s - CYCLE_S / 2.0))
    return rows[at], at


def between(times: Array, values: Array, t: Array, period_s: float) -> Array:
    """Return a signal of a message with a period at `t` (n,) s, from its `values` (m,) at `times` (m,) s, ascending.

    It is on a straight line between two frames of which the second came when it was due, and goes on in the direction
    of the last two until the next frame is due; NaN elsewhere.
    """
    sent, first = np.unique(whole_ns(times), return_index=True)
    values, at = values[first], whole_ns(t)
    before = last_until(sent, at)
    steps = np.diff(sent)
    # By frame: the change to the next one, and whether that came when it was due.
    slope = np.append(np.diff(values) / steps, 0.0)
    joined = np.append(steps < 1.5e9 * period_s, False)
    slope = np.where(joined, slope, np.concatenate([[0.0], np.where(joined, slope, 0.0)[:-1]]))
    since = at - sent[before]
    valid = (before >= 0) & (joined[before] | (since < round(1e9 * (period_s - CYCLE_S / 2.0))))
    found: Array = np.where(valid, values[before] + slope[before] * since, np.nan)
    return found


def short(values: Iterable[float]) -> Iterable[float | None]:
    """Yield numbers with six digits, as many as a screen can show; None for non-finite values."""
    for value in values:
        yield float(f"{value:.6g}") if np.isfinite(value) else None
