"""The check of the bench's own solver over a set of problems: never worse than the optimum, never without an answer."""

from collections.abc import Iterator, Sequence

import numpy as np

from bench.benchmarks.rmpc.contestants import Result
from bench.benchmarks.rmpc.problems import Problem
from bench.control.certificate import certified_cost
from bench.control.outcome import GainSource
from bench.control.rmpc import Gain

LARGEST_RATIO = 1.001
"""A certified tau above this multiple of the optimum needs the semidefinite program as its source."""

_SAME = 1e-6
"""Relative difference of two certificates of the same gain."""


def failures(result: Result) -> list[str]:
    """Return where the solver fails the check, in words.

    A problem that has a gain must get a certified one, and its tau must be at most 1.001 times the optimum unless the
    semidefinite program was solved. What is called certified must be so by a certificate of its own.
    """
    return list(_failures(result))


def _failures(result: Result) -> Iterator[str]:
    ratios = result.ratio
    for place, (problem, gain) in enumerate(zip(result.problems, result.gains, strict=True)):
        name = f"problem {place} ({problem.group})"
        if problem.feasible and not gain.usable:
            yield f"{name} has no answer: {gain.status.name}"
        if gain.usable and not is_certified(problem, gain):
            yield f"{name}: its gain is not certified"
        if ratios[place] > LARGEST_RATIO and gain.source is not GainSource.SDP:
            yield f"{name}: tau is {ratios[place]:.6f} times the optimum, from {gain.source.name}"


def is_certified(problem: Problem, gain: Gain) -> bool:
    """Whether the certificate proves the tau of a gain at all vertices."""
    proven = certified_cost(gain.K, gain.P, problem.rho, vertices(problem), problem.z, problem.room)
    return proven is not None and bool(np.isclose(proven, gain.tau, rtol=_SAME))


def vertices(problem: Problem) -> Sequence[tuple[np.ndarray, np.ndarray]]:
    """Return A (3, 3) and B (3, 3) at each vertex of the uncertainty."""
    corners = [(1.0, 1.0), (-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0)]
    return [problem.model.at(*corner) for corner in corners[: 4 if problem.independent else 2]]
