"""The true motion of a run's vehicles on one time base."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from bench.errors import BadInput
from bench.record import Run

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Motion:
    """Ground truth of all N vehicles at n common times.

    Attributes:
        t: (n,) s.
        X, Y: (N, n) centre of mass in the road frame, m.
        psi: (N, n) yaw angle, rad.
        v_x: (N, n) longitudinal speed, m/s.
        gamma: (N, n) yaw rate, rad/s.
        mu: (N, n) adhesion for the stability boundary: the smaller of the road's and the planner's.
        order: vehicles (from 0) from the head of the platoon to its tail.
    """

    t: Array
    X: Array
    Y: Array
    psi: Array
    v_x: Array
    gamma: Array
    mu: Array
    order: tuple[int, ...]

    @property
    def gaps(self) -> Array:
        """Distances along X from each vehicle of the platoon to the next one behind it, (N - 1, n), m."""
        slots = self.X[list(self.order)]
        return slots[:-1] - slots[1:]

    def distances(self) -> dict[tuple[int, int], Array]:
        """Return the distance between the centres of mass of each pair of vehicles (from 0), (n,), m."""
        pairs = itertools.combinations(range(len(self.X)), 2)
        return {(i, j): np.hypot(self.X[i] - self.X[j], self.Y[i] - self.Y[j]) for i, j in pairs}


def motion(run: Run) -> Motion:
    """Return the true motion of a run's vehicles at the times common to all of them.

    Raises:
        BadInput: the log lacks the ground truth of a vehicle, or the vehicles have no common time.
    """
    truths = [run.truth(vehicle) for vehicle in range(1, run.vehicles + 1)]
    stamps = [truth.time_ns for truth in truths]
    # A damaged log may have duplicate times, or times out of order.
    firsts = [np.unique(stamp, return_index=True) for stamp in stamps]
    common = firsts[0][0]
    for times, _ in firsts[1:]:
        common = np.intersect1d(common, times, assume_unique=True)
    if not len(common):
        raise BadInput(
            f"{run.path} has no ground truth of all {run.vehicles} vehicles at a common time: the run was too short"
        )
    rows = [first[np.searchsorted(times, common)] for times, first in firsts]

    def stacked(name: str) -> Array:
        return np.stack([np.asarray(truth[name])[row] for truth, row in zip(truths, rows, strict=True)])

    X = stacked("X")  # noqa: N806 - the paper's symbol
    return Motion(
        t=(common / 1e9).astype(np.float64),
        X=X,
        Y=stacked("Y"),
        psi=stacked("psi"),
        v_x=stacked("v_x"),
        gamma=stacked("gamma"),
        mu=np.minimum(stacked("mu"), run.scenario.planner.adhesion),
        order=_order(run, X[:, 0]),
    )


def _order(run: Run, start: Array) -> tuple[int, ...]:
    """Return the vehicles in order of their slots, or of their start positions if the slots are unknown."""
    slots = []
    for vehicle in range(1, run.vehicles + 1):
        if not run.has(f"veh{vehicle}", "PlannerStatus"):
            break
        slots += run.message(f"veh{vehicle}", "PlannerStatus")["Slot"][-1:].tolist()
    if len(set(slots)) == run.vehicles:
        return tuple(int(index) for index in np.argsort(slots))
    return tuple(int(index) for index in np.argsort(-start, kind="stable"))
