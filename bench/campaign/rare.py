"""The probability that a requirement is missed, where that is rare, by subset simulation.

The probability is a product of conditional ones, each about 0.1, of margins below falling thresholds (Au and Beck,
Estimation of small failure probabilities in high dimensions by subset simulation, Probabilistic Engineering Mechanics
16, 2001). The samples below a threshold come from Markov chains in standard normal space, by adaptive conditional
sampling (Papaioannou, Betz, Zwirglmaier and Straub, MCMC algorithms for subset simulation, Probabilistic Engineering
Mechanics 41, 2015). All chains advance one step at a time, so that a batch has as many runs as there are chains.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from bench.campaign.evaluating import Evaluate, Remembered, fails, margin_of
from bench.campaign.requirements import Requirement
from bench.campaign.statistics import share
from bench.campaign.study import Study
from bench.campaign.unit_cube import UnitCube
from bench.errors import BadInput, RunFailed

Array = npt.NDArray[np.float64]
Truths = npt.NDArray[np.bool_]

LEVEL_SHARE = 0.1
"""Share p0 of a level's samples that are below the next threshold."""

MOST_SHARE = 0.5
"""Where more samples than this are at the threshold with equal margins, it is lowered to the next margin."""

SAMPLES = 1000
LEAST_SAMPLES = 100
MOST_LEVELS = 12
"""So many levels reach a probability of about 1e-12."""

MOST_DRAWS = 100
"""Samples are drawn at random up to so many times their number, until enough of them have a margin."""

FIRST_SCALE = 0.6
ACCEPTED = 0.44
"""Standard deviation of the first candidates, and the share of them that should be accepted: Papaioannou's values."""

TWO_SIDED = 1.96
"""Standard deviations of a normal distribution on both sides of its mean that enclose 95 %."""


@dataclass(frozen=True)
class Level:
    """A level of subset simulation.

    Attributes:
        threshold: the margins of its samples are at most this; infinite for the first level.
        share: share of its samples that are below the next threshold, or that fail on the last level.
        variation: coefficient of variation of the share; infinite if it is 0.
    """

    threshold: float
    share: float
    variation: float


@dataclass(frozen=True)
class Estimate:
    """A probability of failure.

    Attributes:
        probability: the estimate; 0 if no failure was found.
        variation: its coefficient of variation, with the correlation within chains and without that between chains and
            levels, for which it can be 1.5 times as large (a probability of 1e-6 in ten dimensions); infinite if the
            probability is 0.
        most: an upper bound of the probability, at about 95 %, if no failure was found.
        levels: of the simulation.
        words: how it ended.
    """

    probability: float
    variation: float
    most: float | None
    levels: tuple[Level, ...]
    words: str


@dataclass(frozen=True)
class Progress:
    """How far a simulation is.

    Attributes:
        level: number of the level, from 1.
        reached: probability of that level.
        evaluations: number of values evaluated.
        estimate: the result, with the last progress.
    """

    level: int
    reached: float
    evaluations: int
    estimate: Estimate | None = None


def subset_simulation(
    study: Study,
    requirement: Requirement,
    evaluate: Evaluate,
    *,
    samples: int = SAMPLES,
    most_levels: int = MOST_LEVELS,
) -> Iterator[Progress]:
    """Yield the progress of a simulation after each batch; the last one has the estimate.

    It is the same for the same study and outcomes. A run that does not reach its end fails and is beyond all
    thresholds. Values that make no scenario, and runs without a margin, do not count: the probability is that of the
    others.

    Args:
        study: its inputs are drawn from their distributions; its seed is that of the simulation.
        requirement: a limit from one side.
        evaluate: evaluates values.
        samples: number of samples of a level.
        most_levels: the simulation ends after so many levels.

    Raises:
        BadInput: the requirement has no margin, the study has nothing to vary, or there are too few samples.
        RunFailed: hardly any values have a margin; while it runs.
    """
    check(requirement, samples)
    limit = _Limit(UnitCube(study), requirement, Remembered(evaluate))
    return _Simulation(limit, np.random.default_rng(study.seed), samples).all_levels(most_levels)


def check(requirement: Requirement, samples: int) -> None:
    """Check what a simulation is to estimate, and with how many samples of a level.

    Raises:
        BadInput: the requirement has no margin, or there are too few samples.
    """
    if not requirement.has_margin:
        raise BadInput(f'Subset simulation needs a margin, and "{requirement.text}" has none; allowed: >, >=, <, <=')
    if samples < LEAST_SAMPLES:
        raise BadInput(f"{samples} samples of a level are not enough; allowed: at least {LEAST_SAMPLES}")


@dataclass(frozen=True)
class _Samples:
    """The samples of a level, as chains (steps, chains) of which some may be one step shorter.

    Attributes:
        points: in standard normal space (steps, chains, dimension).
        margins: of the points (steps, chains).
        failed: whether they fail.
        there: whether the chain has this step.
    """

    points: Array
    margins: Array
    failed: Truths
    there: Truths

    def below(self, threshold: float) -> Truths:
        """Return which samples (steps, chains) are at most at a threshold."""
        return self.there & (self.margins <= threshold)

    def share(self, chosen: Truths) -> float:
        """Return the share of chosen samples."""
        return float(chosen[self.there].mean())


class _Limit:
    """The requirement as a function of standard normal space."""

    def __init__(self, cube: UnitCube, requirement: Requirement, evaluate: Remembered) -> None:
        self.dimension = cube.dimension
        self.evaluate = evaluate
        self._cube = cube
        self.requirement = requirement

    def __call__(self, points: Array) -> tuple[Array, Truths]:
        """Return margins, NaN where there is none, and whether a run fails, (n,) each, at points (n, dimension)."""
        outcomes = self.evaluate(self._cube.values_of_normal(points))
        margins = [margin_of(outcome, self.requirement) for outcome in outcomes]
        failed = [fails(outcome, self.requirement) for outcome in outcomes]
        return np.array([math.nan if margin is None else margin for margin in margins]), np.array(failed, dtype=bool)


class _Simulation:
    def __init__(self, limit: _Limit, random: np.random.Generator, samples: int) -> None:
        self._limit = limit
        self._random = random
        self._count = samples
        self._scale = FIRST_SCALE
        self._levels: list[Level] = []

    @property
    def _reached(self) -> float:
        """The probability of the present level."""
        return math.prod(level.share for level in self._levels)

    def all_levels(self, most: int) -> Iterator[Progress]:
        threshold = math.inf
        samples = yield from self._drawn()
        while True:
            lower = None if len(self._levels) + 1 == most else _lower(samples)
            chosen = samples.failed if lower is None else samples.below(lower)
            self._levels.append(Level(threshold, samples.share(chosen), share_variation(chosen, samples.there)))
            if lower is None:
                break
            threshold = lower
            samples = yield from self._moved(samples, chosen, lower)
        words = self._words(samples, most)
        yield self._progress(self._levels.pop(), samples, words)

    def _progress(self, last: Level, samples: _Samples, words: str) -> Progress:
        """Return the last progress, after the last level with its samples."""
        reached, levels = self._reached, (*self._levels, last)
        variation = math.hypot(*(level.variation for level in levels))
        most = None if last.share else self._bound(reached, samples)
        estimate = Estimate(reached * last.share, variation, most, levels, words)
        return Progress(len(levels), reached, self._limit.evaluate.evaluations, estimate)

    def _bound(self, reached: float, samples: _Samples) -> float:
        """Return an upper bound of the probability if none of the samples fails.

        It is that of as many independent samples as there are chains, times that of the level's probability if its
        logarithm is normally distributed.
        """
        variation = math.hypot(*(level.variation for level in self._levels))
        conditional = share(0, samples.there.shape[1]).high or 1.0
        return min(1.0, reached * math.exp(TWO_SIDED * math.sqrt(math.log1p(variation**2))) * conditional)

    def _words(self, samples: _Samples, most: int) -> str:
        metric, count = self._limit.requirement.metric, self._count
        least = float(samples.margins[samples.there].min())
        if samples.failed.any():
            return f"reached the failures on level {len(self._levels)}"
        if len(self._levels) == most:
            return f"ended after {most} levels without a failure; the least margin of {metric} is {least:.4g}"
        return (
            f"ended on level {len(self._levels)}, because no level can follow: most of its {count} samples have the"
            f" same margin of {metric}, {least:.4g}, none has less and none fails"
        )

    def _now(self) -> Progress:
        return Progress(len(self._levels) + 1, self._reached, self._limit.evaluate.evaluations)

    def _drawn(self) -> Generator[Progress, None, _Samples]:
        """Return independent samples that have a margin, after yielding the progress of each batch."""
        points, margins = np.empty((0, self._limit.dimension)), np.empty(0)
        failed = np.empty(0, dtype=bool)
        drawn = 0
        while drawn < MOST_DRAWS * self._count:
            new = self._random.standard_normal((self._count - len(margins), self._limit.dimension))
            new_margins, new_failed = self._limit(new)
            known = ~np.isnan(new_margins)
            points = np.concatenate([points, new[known]])
            margins = np.concatenate([margins, new_margins[known]])
            failed = np.concatenate([failed, new_failed[known]])
            drawn += len(new)
            yield self._now()
            if len(margins) == self._count:
                return _Samples(points[None], margins[None], failed[None], np.ones((1, self._count), dtype=bool))
        raise RunFailed(
            f"Of {drawn} random values, only {len(margins)} made a run with a margin of"
            f" {self._limit.requirement.metric}; narrow the ranges of the inputs to those that make one"
        )

    def _moved(self, samples: _Samples, chosen: Truths, threshold: float) -> Generator[Progress, None, _Samples]:
        """Return samples below a threshold, of chains from those chosen, after yielding each step's progress."""
        # In random order, because some chains are one step longer.
        seeds = self._random.permutation(np.flatnonzero(chosen.ravel()))
        points, margins, failed = (
            each.reshape(-1, *each.shape[2:])[seeds] for each in (samples.points, samples.margins, samples.failed)
        )
        steps = [(points, margins, failed)]
        whole, longer = divmod(self._count, len(seeds))
        there = np.ones((whole + bool(longer), len(seeds)), dtype=bool)
        there[whole:, longer:] = False
        for step in range(1, len(there)):
            points, margins, failed = self._step(*steps[-1], there[step], threshold, step)
            steps.append((points, margins, failed))
            yield self._now()
        all_points, all_margins, all_failed = zip(*steps, strict=True)
        return _Samples(np.stack(all_points), np.stack(all_margins), np.stack(all_failed), there)

    def _step(
        self, points: Array, margins: Array, failed: Truths, active: Truths, threshold: float, step: int
    ) -> tuple[Array, Array, Truths]:
        """Return points, margins and failures of all chains after a step of those that are active."""
        moving = np.flatnonzero(active)
        noise = self._random.standard_normal((len(moving), points.shape[1]))
        candidates = math.sqrt(1.0 - self._scale**2) * points[moving] + self._scale * noise
        new_margins, new_failed = self._limit(candidates)
        accepted = new_margins <= threshold
        points, margins, failed = points.copy(), margins.copy(), failed.copy()
        kept = moving[accepted]
        points[kept], margins[kept], failed[kept] = candidates[accepted], new_margins[accepted], new_failed[accepted]
        self._scale = min(1.0, self._scale * math.exp((float(accepted.mean()) - ACCEPTED) / math.sqrt(step)))
        return points, margins, failed


def _lower(samples: _Samples) -> float | None:
    """Return the next threshold; None if failures are reached, or if no threshold is lower."""
    margins = np.sort(samples.margins[samples.there])
    threshold = float(margins[math.ceil(LEVEL_SHARE * len(margins)) - 1])
    if samples.share(samples.below(threshold)) > MOST_SHARE:
        less = margins[margins < threshold]
        if not less.size:
            return None
        threshold = float(less[-1])
    reached = samples.share(samples.failed) >= samples.share(samples.below(threshold))
    return None if reached else threshold


def share_variation(chosen: Truths, there: Truths) -> float:
    """Return the coefficient of variation of the share of chosen samples (steps, chains), as Au and Beck (eq. 28, 29).

    It contains the correlation of samples within a chain; chains are taken as independent.
    """
    count, p = int(there.sum()), float(chosen[there].mean())
    if p in (0.0, 1.0):
        return math.inf if p == 0.0 else 0.0
    gamma = 0.0
    for lag in range(1, len(there)):
        pairs = there[lag:] & there[:-lag]
        together = float((chosen[lag:] & chosen[:-lag])[pairs].mean())
        gamma += 2.0 * int(pairs.sum()) / count * (together - p**2) / (p * (1.0 - p))
    return math.sqrt((1.0 - p) / (count * p) * (1.0 + max(gamma, 0.0)))
