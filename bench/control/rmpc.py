"""The robust model predictive controller: one semidefinite program per step, (50)-(62), and its certificate.

`chi+ = (A + H Lambda N1) chi + (B + H Lambda N2) theta`, `theta = K chi`: minimise tau, the worst cost
`sum chi'Q chi + theta'R theta` over all cornering stiffnesses. `robust_program` states the inequalities.

Every solver result is certified before use: `certificate` checks it at every corner of the uncertainty, and the
reported tau is the one that it proves.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.control.certificate import proven_cost
from bench.control.compiled import njit
from bench.control.outcome import GainSource, SolverStatus
from bench.control.robust_program import Answer, Program
from bench.control.vehicle_model import LinearModel
from platoon_fmu.parameters import LAMBDA_MAX, LAMBDA_MIN

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Stack = NDArray[np.float64]

N = 3
_SMALLEST = 0.01
"""Deviations below this (scaled units) are treated as this large."""
_LARGEST_ROOM = 10.0
"""Input room is limited to this multiple of the deviation (scaled units): more is hardly used and costs accuracy."""
_LARGEST_COST_RATIO = 1.5


@dataclass(frozen=True)
class Gain:
    """A state feedback with the ellipsoid that proves it.

    Attributes:
        K: (m, 3) gain of `theta = K chi`, in physical units; 0 if not usable.
        P: (3, 3) ellipsoid `chi' P^-1 chi <= 1`, in scaled units.
        tau: bound of the worst-case cost from chi, scaled units.
        status: outcome of the solver, or CHECK_FAILED if the certificate rejected its result.
        iterations: of the solver, in the program that gave this result.
        source: the kind of program that gave this result.
    """

    K: Matrix
    P: Matrix
    tau: float
    status: SolverStatus
    iterations: int
    source: GainSource = GainSource.SDP

    @property
    def usable(self) -> bool:
        """Whether the certificate holds."""
        return self.status is SolverStatus.SOLVED


class RobustController:
    """Solves the semidefinite program of one step and certifies the result.

    Several programs are tried in turn, the fastest first; the next one is used only if the certificate rejects the
    result of the one before.

    Args:
        state_scale: (3,) unit of each state in the program (m/s, m/s, rad/s).
        input_scale: (m,) unit of each input in the program.
        input_weight: R = input_weight I in scaled units, against Q = I.
        programs: tried in turn, see `robust_program.programs`.
        independent: lambda_f and lambda_r vary independently; otherwise lambda_f = lambda_r as in the paper.
    """

    def __init__(
        self,
        state_scale: Vector,
        input_scale: Vector,
        input_weight: float,
        programs: Sequence[Program],
        *,
        independent: bool,
    ) -> None:
        self._state_scale = state_scale
        self._input_scale = input_scale
        self._rho = input_weight
        low, high = LAMBDA_MIN, LAMBDA_MAX
        corners = [(high, high), (low, low), (high, low), (low, high)]
        self._corners = np.array(corners if independent else corners[:2])
        self._programs = tuple(programs)

    def solve(self, model: LinearModel, chi: Vector, u_max: Vector) -> Gain:
        """Return the gain of this step.

        Args:
            model: model with m inputs, physical units.
            chi: (3,) deviation from the target.
            u_max: (m,) range of each input about its target, positive.
        """
        x, u = self._state_scale, self._input_scale
        scaled = LinearModel(*_scaled(model.A, model.B, model.H, model.N1, model.N2, x, u))
        # The program is homogeneous: in units of the deviation all its numbers are near one. A very small deviation is
        # treated as a larger one in the same direction; the proof for the larger one covers it.
        z = chi / x
        size = math.sqrt(z @ z)
        z = z / size if size > 0.0 else np.eye(N)[0]
        size = max(size, _SMALLEST)
        room = np.minimum(u_max / u / size, _LARGEST_ROOM)
        models = _vertices(scaled.A, scaled.B, scaled.H, scaled.N1, scaled.N2, self._corners)

        for program in self._programs:
            answer = program.solve(scaled, z, room)
            K, tau, status = self._certify(answer, models, z, room)
            if status is not SolverStatus.CHECK_FAILED:
                break
        gain = K * u[:, None] / x
        return Gain(gain, answer.P * size**2, tau * size**2, status, answer.iterations, program.source)

    def _certify(
        self, answer: Answer, models: tuple[Stack, Stack], z: Vector, room: Vector
    ) -> tuple[Matrix, float, SolverStatus]:
        """Return gain and cost in scaled units, and SOLVED only if the certificate holds; otherwise the gain is 0."""
        none = np.zeros_like(answer.Y)
        if answer.status not in (SolverStatus.SOLVED, SolverStatus.ALMOST_SOLVED):
            return none, answer.tau, answer.status
        K = _gain(answer.P, answer.Y)
        proven = float(proven_cost(K, answer.P, self._rho, *models, z, room))
        # The proven cost must be close to the solver's; otherwise the solve itself failed.
        if proven <= _LARGEST_COST_RATIO * answer.tau:
            return K, proven, SolverStatus.SOLVED
        return none, answer.tau, SolverStatus.CHECK_FAILED


@njit(cache=True)
def _gain(P: Matrix, Y: Matrix) -> Matrix:
    """K = Y P^-1 (m, 3); NaN if P is singular."""
    if not (np.isfinite(P).all() and np.linalg.det(P) > 0.0):
        return np.full_like(Y, np.nan)
    return np.ascontiguousarray(np.linalg.solve(P, Y.T).T)


@njit(cache=True)
def _scaled(
    A: Matrix, B: Matrix, H: Matrix, N1: Matrix, N2: Matrix, x: Vector, u: Vector
) -> tuple[Matrix, Matrix, Matrix, Matrix, Matrix]:
    """A, B, H, N1, N2 of the same model in units x (3,) of the states and u (m,) of the inputs."""
    row = x.reshape(N, 1)
    return A / row * x, B / row * u, H / row, N1 * x, N2 * u


@njit(cache=True)
def _vertices(A: Matrix, B: Matrix, H: Matrix, N1: Matrix, N2: Matrix, corners: Matrix) -> tuple[Stack, Stack]:
    """A (n, 3, 3) and B (n, 3, m) of a model at (n, 2) pairs lambda_f, lambda_r; see `LinearModel.at`."""
    n = len(corners)
    at_A, at_B = np.empty((n, *A.shape)), np.empty((n, *B.shape))
    for k in range(n):
        spread = H * np.array([corners[k, 0], corners[k, 0], corners[k, 1]])
        at_A[k], at_B[k] = A + spread @ N1, B + spread @ N2
    return at_A, at_B
