"""The values of a study's inputs for each run: random, low-discrepancy or complete samples."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from bench.campaign.distributions import Value
from bench.campaign.study import WITHOUT_CHANCE, Study
from bench.campaign.unit_cube import columns_at

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Sample:
    """The values of one run.

    Attributes:
        number: of the run, from 0; with the random family as a base also that of its scenario.
        values: value of each input by its key.
    """

    number: int
    values: dict[str, Value]


def samples(study: Study) -> list[Sample]:
    """Return the sample of every run, see `each_sample`."""
    return list(each_sample(study))


def each_sample(study: Study) -> Iterator[Sample]:
    """Yield the sample of every run, always the same for the same study.

    With "monte-carlo" and "sobol" the values of a run do not depend on the number of runs: a longer campaign begins
    with the shorter one. With "latin-hypercube" they do, since its strata are as many as the runs; a grid and corners
    are complete, in the order of the inputs with the last one changing fastest.
    """
    if study.sampling in WITHOUT_CHANCE:
        points = [
            each.distribution.grid(each.points) if study.sampling == "grid" else each.distribution.extremes()
            for each in study.inputs
        ]
        rows: Iterable[tuple[Value, ...]] = itertools.product(*points)
    elif study.keys:
        rows = zip(*columns_at(study, _shares(study)), strict=True)
    else:
        rows = [()] * study.runs
    keys = study.keys
    for number, row in enumerate(rows):
        yield Sample(number, dict(zip(keys, row, strict=True)))


def _shares(study: Study) -> Array:
    """Return a point of the unit cube for each run, (runs, inputs)."""
    count, runs = len(study.keys), study.runs
    if study.sampling == "monte-carlo":
        # Filled run by run, so that the first runs do not depend on how many there are.
        return np.random.default_rng(study.seed).random((runs, count))
    # Slow to import, and not needed by all studies.
    from scipy.stats import qmc

    if study.sampling == "latin-hypercube":
        return np.asarray(qmc.LatinHypercube(count, rng=study.seed).random(runs))
    # A power of two of them, of which it does not say what the example of a study says anyway.
    return np.asarray(qmc.Sobol(count, rng=study.seed).random_base2(math.ceil(math.log2(runs))))[:runs]
