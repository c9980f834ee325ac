"""Searches a study's inputs for the values with the least margin to a requirement.

CMA-ES with restarts of doubled population (Auger and Hansen, A restart CMA evolution strategy with increasing
population size, CEC 2005), on the unit cube of the inputs; inputs with few values by CMA-ES with margin (Hamano, Saito,
Nomura and Shirakawa, GECCO 2022).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from bench.campaign.distributions import Value
from bench.campaign.evaluating import Evaluate, Outcome, Remembered, margin_of
from bench.campaign.requirements import Requirement
from bench.campaign.study import Study
from bench.campaign.unit_cube import UnitCube
from bench.errors import BadInput

if TYPE_CHECKING:
    from cmaes import CMAwM

Array = npt.NDArray[np.float64]

FIRST_STEP = 0.3
"""Standard deviation of the first points of a start, in the unit cube."""

LEAST_SPREAD = 1e-4
"""A start has converged if the standard deviations of its points in the unit cube are below this."""

LEAST_GAIN = 1e-6
"""A margin is better only if it is less by this, absolute and relative."""

FRUITLESS_STARTS = 3
"""The search ends when so many starts in a row have found nothing better."""


@dataclass(frozen=True)
class Worst:
    """The worst that a search has found so far.

    Attributes:
        evaluations: number of values evaluated.
        starts: number of starts.
        margin: least margin; minus infinity if a run did not reach its end, None if no run has had a margin.
        values: the values with that margin by key.
        outcome: of these values.
        ended: why the search has ended, empty until it has.
    """

    evaluations: int = 0
    starts: int = 0
    margin: float | None = None
    values: dict[str, Value] | None = None
    outcome: Outcome | None = None
    ended: str = ""


def search(
    study: Study, requirement: Requirement, evaluate: Evaluate, *, runs: int, workers: int = 1
) -> Iterator[Worst]:
    """Yield the worst found after each batch of runs; the last one says why the search has ended.

    It is the same for the same study, number of workers and outcomes. A run that does not reach its end is worse than
    every other. Values that make no scenario, or a run without a margin, are better than every other, the more so the
    further they are from the worst found. Values are not evaluated twice.

    Args:
        study: its inputs are varied, within their ranges; its seed is that of the search.
        requirement: a limit from one side.
        evaluate: evaluates values.
        runs: largest number of evaluations.
        workers: least number of values in a batch, except the last one.

    Raises:
        BadInput: the requirement has no margin, or the study nothing to vary.
    """
    if not requirement.has_margin:
        raise BadInput(f'A search minimises a margin, and "{requirement.text}" has none; allowed: >, >=, <, <=')
    return _Search(UnitCube(study), requirement, Remembered(evaluate), runs).all_starts(study.seed, workers)


class _Search:
    def __init__(self, cube: UnitCube, requirement: Requirement, evaluate: Remembered, runs: int) -> None:
        self._cube = cube
        self._requirement = requirement
        self._evaluate = evaluate
        self._runs = runs
        self._worst = Worst()
        self._point: Array = np.full(cube.dimension, 0.5)

    def all_starts(self, seed: int, workers: int) -> Iterator[Worst]:
        random = np.random.default_rng(seed)
        population = max(4 + math.floor(3 * math.log(self._cube.dimension)), workers)
        mean, fruitless = self._point, 0
        while fruitless < FRUITLESS_STARTS:
            self._worst = dataclasses.replace(self._worst, starts=self._worst.starts + 1)
            before = self._worst.margin
            yield from self._start(self._optimizer(mean, population, int(random.integers(2**32))))
            if self._worst.ended:
                return
            fruitless = 0 if _is_less(self._worst.margin, before) else fruitless + 1
            mean, population = random.random(self._cube.dimension), 2 * population
        self._worst = dataclasses.replace(
            self._worst, ended=f"converged: the last {FRUITLESS_STARTS} of {self._worst.starts} starts found none worse"
        )
        yield self._worst

    def _optimizer(self, mean: Array, population: int, seed: int) -> CMAwM:
        # Imports much of scipy.
        from cmaes import CMAwM

        # A value with a cell of its own is the cell's middle.
        low, high = self._cube.steps / 2, 1 - self._cube.steps / 2
        return CMAwM(
            np.clip(mean, low, high),
            FIRST_STEP,
            bounds=np.column_stack([low, high]),
            steps=self._cube.steps,
            seed=seed,
            population_size=population,
        )

    def _start(self, optimizer: CMAwM) -> Iterator[Worst]:
        """Yield the worst after each batch, until this start has converged or the search has ended."""
        patience = 10 + math.ceil(30 * self._cube.dimension / optimizer.population_size)
        least: float | None = None
        idle = 0
        while idle < patience:
            asked = [optimizer.ask() for _ in range(optimizer.population_size)]
            points = np.array([point for point, _ in asked])
            margins = self._margins(points)
            self._end_if_due(all_made=len(margins) < len(asked))
            yield self._worst
            if self._worst.ended:
                return
            ranks = _ranks(margins, np.linalg.norm(points - self._point, axis=1))
            optimizer.tell([(inner, rank) for (_, inner), rank in zip(asked, ranks, strict=True)])
            best = min((margin for margin in margins if margin is not None), default=None)
            idle, least = (0, best) if _is_less(best, least) else (idle + 1, least)
            if self._has_contracted(points) or optimizer.should_stop():
                return

    def _margins(self, points: Array) -> list[float | None]:
        """Return the margins at points, at most as many as may still be evaluated; take note of the least."""
        batch = self._cube.values(points[: self._runs - self._evaluate.evaluations])
        outcomes = self._evaluate(batch)
        margins = [margin_of(outcome, self._requirement) for outcome in outcomes]
        for place, margin in enumerate(margins):
            least = self._worst.margin
            if margin is not None and (least is None or margin < least):
                self._point = points[place]
                self._worst = dataclasses.replace(
                    self._worst, margin=margin, values=batch[place], outcome=outcomes[place]
                )
        self._worst = dataclasses.replace(self._worst, evaluations=self._evaluate.evaluations)
        return margins

    def _end_if_due(self, *, all_made: bool) -> None:
        ended = ""
        if self._worst.margin == -math.inf:
            ended = "found a run than which none can be worse"
        elif all_made or self._evaluate.evaluations >= self._runs:
            ended = f"made {self._runs} runs, as many as allowed"
        self._worst = dataclasses.replace(self._worst, ended=ended)

    def _has_contracted(self, points: Array) -> bool:
        """Return whether a start's points are all in one place, by the inputs that are continuous."""
        continuous = points[:, self._cube.steps == 0.0]
        return continuous.size > 0 and bool(np.all(continuous.std(axis=0) < LEAST_SPREAD))


def _is_less(margin: float | None, than: float | None) -> bool:
    """Return whether a margin is less by more than rounding; any is less than None."""
    if margin is None or than is None:
        return margin is not None
    return margin < than - LEAST_GAIN * max(1.0, abs(than))


def _ranks(margins: Sequence[float | None], distances: Array) -> list[float]:
    """Return the place of each margin from the least one on; those without come last, the nearest of them first."""
    keys = [
        (margin is None, distance if margin is None else margin)
        for margin, distance in zip(margins, distances.tolist(), strict=True)
    ]
    rank = {key: float(place) for place, key in enumerate(sorted(set(keys)))}
    return [rank[key] for key in keys]
