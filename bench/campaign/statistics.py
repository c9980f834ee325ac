"""How sure a campaign makes one: shares of runs that failed, with exact bounds, and what the runs' metrics were."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import polars as pl

CONFIDENCE = 0.95
LEVELS = (0.0, 0.05, 0.5, 0.95, 1.0)
"""The quantiles that are told of a metric."""
MOST_POINTS = 40
"""Points of a curve over the number of runs."""


@dataclass(frozen=True)
class Share:
    """How many of so many independent runs failed.

    Attributes:
        failed: number of runs that failed.
        known: number of runs of which that is known.
        low, high: Clopper and Pearson's bounds of the probability of failure (Biometrika 26, 1934): they enclose it
            with at least 95 %, half of the rest on each side; None if runs are not drawn at random, or none is known.
    """

    failed: int
    known: int
    low: float | None
    high: float | None

    @property
    def text(self) -> str:
        """The share in percent; a dash of no run."""
        return percent(self.failed / self.known) if self.known else "–"

    @property
    def bounds(self) -> str:
        """The bounds in percent, rounded outwards; only one where none or all of the runs failed."""
        if self.low is None or self.high is None:
            return "–"
        if self.failed == 0:
            return f"at most {percent(self.high, math.ceil)}"
        if self.failed == self.known:
            return f"at least {percent(self.low, math.floor)}"
        return f"{percent(self.low, math.floor)} to {percent(self.high, math.ceil)}"


def share(failed: int, known: int, *, random: bool = True) -> Share:
    """Return how many runs failed, with bounds if the runs are drawn at random."""
    if not known or not random:
        return Share(failed, known, None, None)
    # The same as scipy.stats.binomtest's exact interval, whose package takes most of a second to import.
    from scipy.special import betaincinv

    rest = (1.0 - CONFIDENCE) / 2.0
    low = float(betaincinv(failed, known - failed + 1, rest)) if failed else 0.0
    high = float(betaincinv(failed + 1, known - failed, 1.0 - rest)) if failed < known else 1.0
    return Share(failed, known, low, high)


def share_of(failed: pl.Series, *, random: bool = True) -> Share:
    """Return the share of runs that failed; null is a run of which it is not known."""
    return share(int(failed.sum() or 0), failed.len() - failed.null_count(), random=random)


def convergence(failed: pl.Series) -> Iterator[Share]:
    """Yield the share of the first n runs with its bounds, for growing n up to all of which it is known.

    The runs must be in the order of their numbers: in the order in which they ended, the short ones come first.
    """
    known = failed.drop_nulls().to_numpy()
    counts = np.cumsum(known)
    for n in np.unique(np.linspace(0, len(known), MOST_POINTS + 1).round().astype(int)):
        if n:
            yield share(int(counts[n - 1]), int(n))


def quantiles(metrics: pl.DataFrame) -> list[list[float]]:
    """Return the `LEVELS` of each column, of its finite values; an empty list of a column that has none."""
    if not metrics.width:
        return []
    values = pl.all().cast(pl.Float64)
    known = values.filter(values.is_finite())
    # All columns at once: polars shares them among the cores.
    rows = [metrics.select(known.quantile(level, "linear")).row(0) for level in LEVELS]
    return [list(levels) if levels[0] is not None else [] for levels in zip(*rows, strict=True)]


def histogram(values: npt.NDArray[np.float64], edges: npt.NDArray[np.float64]) -> list[int]:
    """Return the number of values between successive edges."""
    return [int(count) for count in np.histogram(values, edges)[0]]


def edges_of(values: npt.NDArray[np.float64], most: int = 40) -> npt.NDArray[np.float64]:
    """Return the edges of at most `most` classes of equal width for a histogram of values, at least one."""
    whole = bool(np.all(values == np.round(values)))
    low, high = float(values.min()), float(values.max())
    if whole and high - low < most:
        # A class for each number.
        return np.arange(low - 0.5, high + 1.0, 1.0)
    if high - low <= 1e-12 * max(1.0, abs(low)):
        return np.array([low - 0.5, low + 0.5])
    return np.linspace(low, high, min(most, max(8, math.ceil(math.sqrt(len(values))))) + 1)


def finite(values: pl.Series) -> npt.NDArray[np.float64]:
    """Return the values that are finite numbers."""
    numbers: npt.NDArray[np.float64] = values.cast(pl.Float64).drop_nulls().to_numpy()
    return np.asarray(numbers[np.isfinite(numbers)])


def percent(part: float, rounded: Callable[[float], int] = round) -> str:
    """Return a share as text in percent, with two significant digits of what is less, it or the rest.

    Args:
        part: the share.
        rounded: `round`, or `math.floor` or `math.ceil` for a bound.
    """
    value = 100.0 * part
    least = min(value, 100.0 - value)
    if least <= 0.0:
        return f"{value:g} %"
    digits = max(1, 1 - math.floor(math.log10(least)))
    return f"{rounded(value * 10.0**digits) / 10.0**digits:.{digits}f} %"
