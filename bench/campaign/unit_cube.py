"""Points of the unit cube, or of standard normal space, as values of a study's inputs.

A coordinate of the cube is the share of an input's probability below its value, so the uniform distribution on the cube
is the inputs' joint distribution.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from bench.campaign.distributions import Choice, Distribution, Integers, Value
from bench.campaign.study import Study
from bench.errors import BadInput

Array = npt.NDArray[np.float64]

MOST_CELLS = 100
"""An input with more values than this is searched like a continuous one."""


def columns_at(study: Study, shares: Array) -> list[list[Value]]:
    """Return the values of each input, in the order of `study.keys`, at points of the unit cube.

    Args:
        study: the study.
        shares: the points (n, inputs); the coordinates of a group are independent, and are made to correlate here.
    """
    columns = [each.distribution.at(shares[:, place]) for place, each in enumerate(study.inputs)]
    place = len(study.inputs)
    for group in study.groups:
        inputs = group.inputs()
        own = _correlated(shares[:, place : place + len(inputs)], np.array(group.correlation))
        columns += [each.distribution.at(own[:, index]) for index, each in enumerate(inputs)]
        place += len(inputs)
    return columns


def check_base(study: Study) -> None:
    """Refuse a study whose runs do not follow from the values of its inputs.

    Raises:
        BadInput: its base is a family of random scenarios.
    """
    if study.by_number:
        raise BadInput(
            f'Study {study.name}: base = "{study.base}" is another scenario in each run, but this needs one of which'
            f' only the inputs vary; save one by `platoon scenarios {study.base}:7 > mine.toml`, set base = "mine.toml"'
            " and give [[inputs]]"
        )


class UnitCube:
    """The unit cube of those inputs of a study that have more than one value.

    Attributes:
        dimension: number of those inputs.
        steps: width (dimension,) of a value's cell along each axis; 0 of continuous inputs, and of those with more
            than `MOST_CELLS` values.
    """

    def __init__(self, study: Study) -> None:
        """Take the study's inputs.

        Raises:
            BadInput: they are not all that varies, or nothing varies.
        """
        check_base(study)
        self._study = study
        distributions = [each.distribution for each in study.inputs]
        cells = np.array([*map(_cells, distributions), *(0 for group in study.groups for _ in group.keys)])
        self._varied = np.flatnonzero(cells != 1)
        self.dimension = len(self._varied)
        if not self.dimension:
            raise BadInput(
                f"Study {study.name}: no input has more than one value, so there is nothing to vary; give [[inputs]]"
                " with a range"
            )
        counts = cells[self._varied]
        self.steps = np.where((counts > 1) & (counts <= MOST_CELLS), 1.0 / np.maximum(counts, 1), 0.0)

    def values(self, points: Array) -> list[dict[str, Value]]:
        """Return the values of all inputs at points (n, dimension) of the cube."""
        shares = np.full((len(points), len(self._study.keys)), 0.5)
        shares[:, self._varied] = points
        rows = zip(*columns_at(self._study, shares), strict=True)
        return [dict(zip(self._study.keys, row, strict=True)) for row in rows]

    def values_of_normal(self, points: Array) -> list[dict[str, Value]]:
        """Return the values of all inputs at points (n, dimension) of standard normal space."""
        from scipy.special import ndtr

        return self.values(ndtr(points))


def _cells(distribution: Distribution) -> int:
    """Return the number of a distribution's values; 0 of a continuous one."""
    if isinstance(distribution, Choice):
        return len(distribution.values)
    if isinstance(distribution, Integers):
        return distribution.high - distribution.low + 1
    return 0


def _correlated(shares: Array, correlation: Array) -> Array:
    """Return shares (n, k) whose normal quantiles have this correlation (k, k): a Gaussian copula."""
    from scipy.special import ndtr, ndtri

    # A share of 0 has no finite quantile.
    independent = ndtri(np.clip(shares, np.finfo(float).tiny, 1.0 - np.finfo(float).epsneg))
    factor = np.linalg.cholesky(correlation)
    correlated = np.zeros_like(independent)
    # A matrix product would round a point differently according to the number of points beside it.
    for place in range(len(factor)):
        correlated += independent[:, place, None] * factor[:, place]
    return np.asarray(ndtr(correlated))
