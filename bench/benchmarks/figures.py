"""Figures that are measured several times: taken in turns, stated with their spread.

The machine does other work at the same time. What is compared is therefore measured in turns, round by round, and of
every figure the least, the median and the ninth decile of the rounds are given: the least is what the code can do,
the other two say how far to trust it.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from rich.table import Table

Samples = NDArray[np.float64]

Measure = Callable[[], float]
"""Does something once or many times; returns the seconds it took for each."""

_TIMES = ((1.0, "s"), (1e-3, "ms"), (1e-6, "µs"), (1e-9, "ns"))


@dataclass(frozen=True)
class Figure:
    """One figure of a table.

    Attributes:
        title: what was measured.
        wanted: what is asked of it, as text; empty where nothing is.
        least, median, high: of the rounds; `high` is the ninth decile.
        is_ratio: whether it is a ratio and not a time (s).
    """

    title: str
    wanted: str
    least: float
    median: float
    high: float
    is_ratio: bool = False


def in_turns(measures: Mapping[str, Measure], rounds: int) -> dict[str, Samples]:
    """Take every measure once a round, each round beginning with another one; return the rounds' seconds by name."""
    names = list(measures)
    samples = {name: np.empty(rounds) for name in names}
    for name in names:
        measures[name]()  # What is done once, as filling caches, belongs to no round.
    for i in range(rounds):
        for name in names[i % len(names) :] + names[: i % len(names)]:
            samples[name][i] = measures[name]()
    return samples


def time_figure(title: str, wanted: str, seconds: Samples) -> Figure:
    """Return the figure of a time."""
    return Figure(title, wanted, float(seconds.min()), float(np.median(seconds)), float(np.quantile(seconds, 0.9)))


def ratio_figure(title: str, wanted: str, above: Samples, below: Samples) -> Figure:
    """Return the figure of a ratio of two times: of their least, and over the ratios of the single rounds."""
    ratios = above / below
    least = float(above.min() / below.min())
    return Figure(title, wanted, least, float(np.median(ratios)), float(np.quantile(ratios, 0.9)), is_ratio=True)


def seconds_text(seconds: float) -> str:
    """Return a time with three digits and a unit that suits it."""
    scale, unit = next(((s, u) for s, u in _TIMES if abs(seconds) >= s), _TIMES[-1])
    return f"{seconds / scale:.3g} {unit}"


def table_of(title: str, figures: Sequence[Figure]) -> Table:
    """Return a table with a row for each figure."""
    table = Table(title=title, title_justify="left")
    table.add_column("")
    for heading in ("wanted", "least", "median", "9th decile"):
        table.add_column(heading, justify="right")
    for figure in figures:
        measured = (figure.least, figure.median, figure.high)
        texts = (f"{value:.3g}" if figure.is_ratio else seconds_text(value) for value in measured)
        table.add_row(figure.title, figure.wanted, *texts)
    return table
