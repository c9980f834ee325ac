"""The bench's own programs for the robust MPC, in the order in which they are tried.

The semidefinite solver is imported where it is needed: a tracker whose steps the Riccati equation solves loads none.
"""

import numpy as np
from numpy.typing import NDArray

from bench.control.outcome import GainSource
from bench.control.program import Answer, Program
from bench.control.riccati_program import RiccatiProgram
from bench.control.vehicle_model import LinearModel

Vector = NDArray[np.float64]

_FINER = 0.01
"""Tolerance of the last attempt, as a fraction of the usual one."""


def programs(
    m: int, input_weight: float, *, independent: bool, tolerance: float, max_iterations: int
) -> tuple[Program, ...]:
    """Return the bench's own programs in the order in which they are tried; arguments as of `RobustProgram`.

    Near the target the input bounds are inactive, and the Riccati equation has the optimum. Otherwise the semidefinite
    program is solved; once in thousands of times only a finer tolerance gives a result that can be certified.
    """
    exact = (
        _SemidefiniteProgram(
            m,
            input_weight,
            independent=independent,
            tolerance=each,
            max_iterations=max_iterations,
        )
        for each in (tolerance, _FINER * tolerance)
    )
    return RiccatiProgram(m, input_weight, independent=independent), *exact


class _SemidefiniteProgram:
    """A semidefinite program whose solver is loaded when it is first needed."""

    source = GainSource.SDP

    def __init__(
        self, m: int, input_weight: float, *, independent: bool, tolerance: float, max_iterations: int
    ) -> None:
        self._m, self._input_weight, self._independent = m, input_weight, independent
        self._tolerance, self._max_iterations = tolerance, max_iterations
        self._program: Program | None = None

    def solve(self, model: LinearModel, z: Vector, room: Vector) -> Answer:
        """See `Program.solve`."""
        if self._program is None:
            from bench.control.robust_program import RobustProgram

            self._program = RobustProgram(
                self._m,
                self._input_weight,
                independent=self._independent,
                bounded=True,
                tolerance=self._tolerance,
                max_iterations=self._max_iterations,
            )
        return self._program.solve(model, z, room)
