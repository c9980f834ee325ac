"""Spans of a log's time."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from bench.errors import BadInput

NS = 1_000_000_000

FOREVER_NS = 1 << 63
"""Later than any log_time of ours."""


def to_ns(seconds: float, what: str) -> int:
    """Return a time in whole ns.

    Raises:
        BadInput: it is not a finite number; `what` names it.
    """
    if not math.isfinite(seconds) or abs(seconds) >= FOREVER_NS / NS:
        raise BadInput(f"{what} {seconds}: give a time in s")
    return round(seconds * NS)


class Span(NamedTuple):
    """The times with start_ns <= time < end_ns; no time is below 0."""

    start_ns: int = -1
    end_ns: int = FOREVER_NS

    @classmethod
    def of(cls, start_s: float | None, end_s: float | None) -> Span:
        """Return the span from `start_s` until before `end_s`, without a limit where one is None.

        Raises:
            BadInput: one is not a time, or the end is not after the start.
        """
        start = -1 if start_s is None else max(0, to_ns(start_s, "--from / start_s"))
        end = FOREVER_NS if end_s is None else to_ns(end_s, "--to / end_s")
        if end <= start:
            raise BadInput(
                f"from {max(0, start) / NS:g} s to {end / NS:g} s is an empty range; give an end after the start"
            )
        return cls(start, end)

    def holds(self, times: npt.NDArray[np.int64]) -> npt.NDArray[np.bool_]:
        """Return which of the times (n,), ns, are in the span."""
        return (times >= self.start_ns) & (times < self.end_ns)


ALL = Span()
