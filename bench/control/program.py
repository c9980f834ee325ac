"""What finds the gain of a step for the robust MPC."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from bench.control.outcome import GainSource, SolverStatus
from bench.control.vehicle_model import LinearModel

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


@dataclass(frozen=True)
class Answer:
    """A solver's result, uncertified, in scaled units.

    Attributes:
        P: (3, 3) ellipsoid `chi' P^-1 chi <= 1`.
        Y: (m, 3), `K P`.
        tau: cost of the deviation.
        status: outcome of the solver.
        iterations: of the solver.
    """

    P: Matrix
    Y: Matrix
    tau: float
    status: SolverStatus
    iterations: int


class Program(Protocol):
    """What finds the gain of one step, in scaled units; `RobustController` certifies it before use."""

    source: GainSource
    """What the bus reports as the source of its gains."""

    def solve(self, model: LinearModel, z: Vector, room: Vector) -> Answer:
        """Solve for one step.

        Args:
            model: model with m inputs, in scaled units.
            z: (3,) deviation in scaled units, of length one.
            room: (m,) room u_j of each input in scaled units.
        """
        ...
