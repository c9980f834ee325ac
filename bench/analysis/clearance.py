"""The clearance between the vehicles of a run: the distance between their bodies."""

from __future__ import annotations

import itertools

import numpy as np
import numpy.typing as npt

from bench.analysis.motion import Array, Motion
from bench.bodies import clearance
from platoon_fmu.parameters import BODY


def clearances(truth: Motion) -> dict[tuple[int, int], Array]:
    """Return the clearance of each pair of vehicles (from 0), (n,), m; negative where their bodies overlap."""
    pairs = itertools.combinations(range(len(truth.X)), 2)
    return {
        (i, j): clearance(truth.X[j] - truth.X[i], truth.Y[j] - truth.Y[i], truth.psi[i], truth.psi[j])
        for i, j in pairs
    }


def abreast(along: npt.ArrayLike) -> bool:
    """Return whether any two of the vehicles at positions along the road (N,), m, are abreast: their bodies overlap."""
    return bool((np.diff(np.sort(along)) < BODY.length).any())
