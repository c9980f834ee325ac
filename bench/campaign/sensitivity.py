"""What drives a metric: PAWN indices of the inputs from the runs there are.

Pianosi and Wagener (2018), Distribution-based sensitivity analysis from a generic input-output sample, Environmental
Modelling & Software 108: the index of an input is the mean distance (Kolmogorov and Smirnov's) between the
distribution of the metric and its distribution in slices of the input, 0 to 1. Since runs are few, an input without
influence has an index above 0 too; that of a dummy input says how far.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import polars as pl

SLICES = 8
"""Slices of an input, with equally many runs in each."""
RESAMPLES = 20
"""Bootstrap resamples for the confidence intervals."""
MOST_RUNS = 2000
"""Runs that are used at most, chosen at random: more make the indices slower and hardly better."""
LEAST_RUNS = 10 * SLICES
"""Fewer runs tell nothing."""
Z_95 = 1.96
_STREAM = 0x5041574E
"""Keeps these random numbers apart from others that follow from the same seed."""

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Influence:
    """The influence of an input on a metric.

    Attributes:
        input: name of the input.
        index: PAWN index, 0 to 1.
        half_width: of its 95 % confidence interval.
        direction: Spearman's rank correlation, -1 to 1: whether the metric rises or falls with the input.
    """

    input: str
    index: float
    half_width: float
    direction: float


@dataclass(frozen=True)
class Influences:
    """The influence of each input on a metric.

    Attributes:
        metric: name of the metric.
        runs: number of runs used.
        inputs: the inputs, the strongest first.
        chance: index that an input without influence has by chance, with its upper confidence bound.
    """

    metric: str
    runs: int
    inputs: tuple[Influence, ...]
    chance: float


def numeric(inputs: pl.DataFrame) -> list[str]:
    """Return the inputs with an influence to compute: numbers and yes or no, of more than one value; no seeds."""
    return [
        name
        for name, values in inputs.to_dict(as_series=True).items()
        if (values.dtype.is_numeric() or values.dtype == pl.Boolean) and values.min() != values.max() and name != "seed"
    ]


def influences(inputs: pl.DataFrame, metric: pl.Series, *, seed: int = 1) -> Influences | None:
    """Return the influence of each numeric input on a metric.

    Args:
        inputs: a column for each input, a row for each run.
        metric: its value in each run; null and values that are not finite are left out.
        seed: of the choice of runs, the dummy input and the resamples.

    Returns:
        None if there is nothing to tell: fewer than `LEAST_RUNS` runs, no numeric input, or the metric does not vary.
    """
    names = numeric(inputs)
    if not names:
        return None
    values = metric.cast(pl.Float64).fill_null(float("nan")).to_numpy()
    given = inputs.select(pl.col(names).cast(pl.Float64).fill_null(float("nan"))).to_numpy()
    known = np.isfinite(values) & np.all(np.isfinite(given), axis=1)
    # With the seed alone, the dummy input could be the study's own one: its sampling has the same generator.
    random = np.random.default_rng((seed, _STREAM))
    chosen = np.flatnonzero(known)
    if len(chosen) > MOST_RUNS:
        chosen = np.sort(random.choice(chosen, MOST_RUNS, replace=False))
    x, y = given[chosen], values[chosen]
    if len(chosen) < LEAST_RUNS or bool(np.all(y == y[0])):
        return None
    ranks = _ranks(np.column_stack([x, random.random(len(y))]), random)
    index = _pawn(ranks, y)
    resamples = (random.integers(0, len(y), len(y)) for _ in range(RESAMPLES))
    spread = Z_95 * np.std([pawn_means(ranks[rows], y[rows]) for rows in resamples], axis=0, ddof=1)
    found = [
        Influence(name, float(index[column]), float(spread[column]), _spearman(x[:, column], y))
        for column, name in enumerate(names)
    ]
    ordered = tuple(sorted(found, key=lambda each: -each.index))
    return Influences(metric.name, len(y), ordered, float(index[-1] + spread[-1]))


def _ranks(x: Array, random: np.random.Generator) -> Array:
    """Return the ranks of each column, those of equal values in random order.

    So the slices of an input of few values are equally large too. A rising function of an input has the same index.
    """
    order = np.lexsort((random.random(x.shape).T, x.T))
    ranks = np.empty(x.shape)
    np.put_along_axis(ranks, order.T, np.arange(len(x), dtype=float)[:, None], axis=0)
    return ranks


def _pawn(x: Array, y: Array) -> Array:
    """Return the index of each column of x."""
    # Here, because it takes a while to import.
    from SALib.analyze import pawn

    problem = {"num_vars": x.shape[1], "names": [str(column) for column in range(x.shape[1])]}
    return np.asarray(pawn.analyze(problem, x, y, S=SLICES)["mean"], float)


def pawn_means(x: Array, y: Array) -> Array:
    """Return the index of each column of x as SALib computes it, without the significance tests that take its time.

    Args:
        x: inputs (n, d).
        y: metric (n,).
    """
    order = np.argsort(y)
    edges = np.quantile(x, np.linspace(0.0, 1.0, SLICES + 1), axis=0)
    sorted_x = x[order, None, :]
    # Of each row, slice and input: whether the row is in the slice; then the slice's number of rows up to this one.
    inside = (sorted_x >= edges[:-1]) & (sorted_x < edges[1:])
    counts = np.cumsum(inside, axis=0, dtype=np.int32)
    # Distributions step behind the last of equal values.
    steps = np.flatnonzero(np.diff(y[order], append=np.inf))
    whole = (steps + 1.0) / len(y)
    with np.errstate(invalid="ignore"):
        distances = np.abs(counts[steps] / counts[-1] - whole[:, None, None]).max(axis=0)
    # A slice can be empty if equal values are many.
    return np.asarray(np.nanmean(distances, axis=0))


def _spearman(x: Array, y: Array) -> float:
    from scipy.stats import spearmanr

    return float(spearmanr(x, y).statistic)
