"""Repeated measurements: interleaved, reported with their spread.

The machine may have other work at the same time, so values to be compared are measured alternately, round by round. The
minimum, the median and the ninth decile of the rounds are reported: the minimum is what the code can do, the other two
show the uncertainty.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from rich.table import Table

Samples = NDArray[np.float64]

Measure = Callable[[], float]
"""Does something once or several times; returns the seconds per execution."""

_TIMES = ((1.0, "s"), (1e-3, "ms"), (1e-6, "µs"), (1e-9, "ns"))


@dataclass(frozen=True)
class Figure:
    """One metric of a table.

    Attributes:
        title: what was measured.
        wanted: its target, as text; empty if none.
        least, median, high: of the rounds; `high` is the ninth decile.
        is_ratio: whether it is a ratio rather than a time (s).
    """

    title: str
    wanted: str
    least: float
    median: float
    high: float
    is_ratio: bool = False


def in_turns(measures: Mapping[str, Measure], rounds: int) -> dict[str, Samples]:
    """Take every measure once per round, each round starting with another one; return the rounds' seconds by name."""
    names = list(measures)
    samples = {name: np.empty(rounds) for name in names}
    for name in names:
        measures[name]()  # One-time work, e.g. filling caches, is excluded from the rounds.
    for i in range(rounds):
        for name in names[i % len(names) :] + names[: i % len(names)]:
            samples[name][i] = measures[name]()
    return samples


def time_figure(title: str, wanted: str, seconds: Samples) -> Figure:
    """Return a time as a metric."""
    return Figure(title, wanted, float(seconds.min()), float(np.median(seconds)), float(np.quantile(seconds, 0.9)))


def ratio_figure(title: str, wanted: str, above: Samples, below: Samples) -> Figure:
    """Return the ratio of two times as a metric: of their minima, and the spread of the rounds' ratios."""
    ratios = above / below
    least = float(above.min() / below.min())
    return Figure(title, wanted, least, float(np.median(ratios)), float(np.quantile(ratios, 0.9)), is_ratio=True)


def seconds_text(seconds: float) -> str:
    """Return a time with three digits and a suitable unit."""
    scale, unit = next(((s, u) for s, u in _TIMES if abs(seconds) >= s), _TIMES[-1])
    return f"{seconds / scale:.3g} {unit}"


def table_of(title: str, figures: Sequence[Figure]) -> Table:
    """Return a table with a row for each metric."""
    table = Table(title=title, title_justify="left")
    table.add_column("")
    for heading in ("target", "min", "median", "9th decile"):
        table.add_column(heading, justify="right")
    for figure in figures:
        measured = (figure.least, figure.median, figure.high)
        texts = (f"{value:.3g}" if figure.is_ratio else seconds_text(value) for value in measured)
        table.add_row(figure.title, figure.wanted, *texts)
    return table
