"""Joins of values in time: equal times, and zero-order hold."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from bench.mcap.time_span import NS

Rows = npt.NDArray[np.int64]


def whole_ns(t: npt.NDArray[np.float64]) -> npt.NDArray[np.int64]:
    """Return times in s as whole ns, so that equal times are equal."""
    times: npt.NDArray[np.int64] = np.rint(t * NS).astype(np.int64)
    return times


def same_times(a: npt.NDArray[np.float64], b: npt.NDArray[np.float64]) -> tuple[Rows, Rows]:
    """Return the rows of `a` (m,) s and of `b` (n,) s that have the same time, in the order of time.

    Of several rows of one time the first counts.
    """
    _, rows_a, rows_b = np.intersect1d(whole_ns(a), whole_ns(b), return_indices=True)
    return rows_a.astype(np.int64), rows_b.astype(np.int64)


def last_until(times_ns: npt.NDArray[np.int64], at_ns: npt.NDArray[np.int64]) -> Rows:
    """Return for each of `at_ns` (n,) the last row of `times_ns` (m,), ascending, that is not later: zero-order hold.

    -1 if there is none. Of several rows of one time the last counts.
    """
    return np.searchsorted(times_ns, at_ns, side="right") - 1
