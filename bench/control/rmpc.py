# cython: boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""The robust model predictive controller: the gain of each step, (50)-(62), and its certificate.

`chi+ = (A + H Lambda N1) chi + (B + H Lambda N2) theta`, `theta = K chi`: minimise tau, the worst cost
`sum chi'Q chi + theta'R theta` over all cornering stiffnesses. `robust_program` states the inequalities, and
`riccati_program` finds their optimum in a hundredth of the time while no input bound is active.

Every solver result is certified before use: `certificate` checks it at every corner of the uncertainty, and the
reported tau is the one that it proves.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cython
import numpy as np
from numpy.typing import NDArray

from bench.control.outcome import GainSource, SolverStatus
from bench.control.program import Answer, Program
from bench.control.vehicle_model import LinearModel
from platoon_fmu.parameters import LAMBDA_MAX, LAMBDA_MIN

if cython.compiled:
    from cython.cimports.bench.control.certificate import proven_cost
    from cython.cimports.bench.control.matrices import invert
    from cython.cimports.libc.math import isfinite, sqrt
else:
    from math import isfinite, sqrt

    from bench.control.certificate import proven_cost
    from bench.control.matrices import invert

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Stack = NDArray[np.float64]

N = 3
_SMALLEST = cython.declare(cython.double, 0.01)
"""Deviations below this (scaled units) are treated as this large."""
_LARGEST_ROOM = cython.declare(cython.double, 10.0)
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
    """Finds the gain of one step and certifies it.

    Several programs are tried in turn, the fastest first, until the certificate accepts a result or
    one finds that there is none.

    Args:
        state_scale: (3,) unit of each state in the program (m/s, m/s, rad/s).
        input_scale: (m,) unit of each input in the program.
        input_weight: R = input_weight I in scaled units, against Q = I.
        programs: tried in turn, see `programs`.
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
        x: cython.double[::1] = self._state_scale
        u: cython.double[::1] = self._input_scale
        deviation: cython.double[::1] = chi
        limit: cython.double[::1] = u_max
        m: cython.Py_ssize_t = u.shape[0]
        i: cython.Py_ssize_t
        j: cython.Py_ssize_t
        scaled = _scaled(model, x, u)
        # The program is homogeneous: in units of the deviation all its numbers are near one. A very small deviation is
        # treated as a larger one in the same direction; the proof for the larger one covers it.
        z, room = np.empty(N), np.empty(m)
        direction: cython.double[::1] = z
        scaled_room: cython.double[::1] = room
        size: cython.double = 0.0
        for i in range(N):
            direction[i] = deviation[i] / x[i]
            size += direction[i] * direction[i]
        size = sqrt(size)
        for i in range(N):
            direction[i] = direction[i] / size if size > 0.0 else float(i == 0)
        size = max(size, _SMALLEST)
        for i in range(m):
            scaled_room[i] = min(limit[i] / u[i] / size, _LARGEST_ROOM)
        models = _vertices(scaled, self._corners)

        for program in self._programs:
            answer = program.solve(scaled, z, room)
            K, tau, status = self._certify(answer, models, z, room)
            if status in (SolverStatus.SOLVED, SolverStatus.INFEASIBLE):
                break
        gain: cython.double[:, ::1] = K
        for i in range(m):
            for j in range(N):
                gain[i, j] *= u[i] / x[j]
        return Gain(K, answer.P * size**2, tau * size**2, status, answer.iterations, program.source)

    def _certify(
        self, answer: Answer, models: tuple[Stack, Stack], z: Vector, room: Vector
    ) -> tuple[Matrix, float, SolverStatus]:
        """Return gain and cost in scaled units, and SOLVED only if the certificate holds; otherwise the gain is 0."""
        if answer.P.shape != (N, N) or answer.Y.shape != (room.size, N):
            raise ValueError(
                f"a program returned P {answer.P.shape} and Y {answer.Y.shape} instead of {(N, N)} and {(room.size, N)}"
            )
        none = np.zeros((room.size, N))
        if answer.status not in (SolverStatus.SOLVED, SolverStatus.ALMOST_SOLVED):
            return none, answer.tau, answer.status
        K = _gain(answer.P, answer.Y)
        proven: cython.double = proven_cost(K, answer.P, self._rho, models[0], models[1], z, room)
        # The proven cost must be close to the solver's; otherwise the solve itself failed.
        if proven <= _LARGEST_COST_RATIO * answer.tau:
            return K, proven, SolverStatus.SOLVED
        return none, answer.tau, SolverStatus.CHECK_FAILED


def _gain(P: cython.double[:, ::1], Y: cython.double[:, ::1]) -> Matrix:
    """K = Y P^-1 (m, 3); NaN if P is singular."""
    m: cython.Py_ssize_t = Y.shape[0]
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    K = np.full((m, N), np.nan)
    gain: cython.double[:, ::1] = K
    inverse: cython.double[:, ::1] = np.empty((N, N))
    determinant: cython.double = invert(inverse, P)
    if determinant > 0.0 and isfinite(determinant):
        for i in range(m):
            for j in range(N):
                gain[i, j] = Y[i, 0] * inverse[0, j] + Y[i, 1] * inverse[1, j] + Y[i, 2] * inverse[2, j]
    return K


def _scaled(model: LinearModel, x: cython.double[::1], u: cython.double[::1]) -> LinearModel:
    """Return the same model in units x (3,) of the states and u (m,) of the inputs."""
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    m: cython.Py_ssize_t = u.shape[0]
    A: cython.double[:, ::1] = model.A
    B: cython.double[:, ::1] = model.B
    H: cython.double[:, ::1] = model.H
    N1: cython.double[:, ::1] = model.N1
    N2: cython.double[:, ::1] = model.N2
    scaled = LinearModel(np.empty((N, N)), np.empty((N, m)), np.empty((N, N)), np.empty((N, N)), np.empty((N, m)))
    to_A: cython.double[:, ::1] = scaled.A
    to_B: cython.double[:, ::1] = scaled.B
    to_H: cython.double[:, ::1] = scaled.H
    to_N1: cython.double[:, ::1] = scaled.N1
    to_N2: cython.double[:, ::1] = scaled.N2
    for i in range(N):
        for j in range(N):
            to_A[i, j] = A[i, j] / x[i] * x[j]
            to_H[i, j] = H[i, j] / x[i]
            to_N1[i, j] = N1[i, j] * x[j]
        for j in range(m):
            to_B[i, j] = B[i, j] / x[i] * u[j]
            to_N2[i, j] = N2[i, j] * u[j]
    return scaled


def _vertices(model: LinearModel, corners: cython.double[:, ::1]) -> tuple[Stack, Stack]:
    """A (n, 3, 3) and B (n, 3, m) of a model at (n, 2) pairs lambda_f, lambda_r; see `LinearModel.at`."""
    vertex: cython.Py_ssize_t
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    k: cython.Py_ssize_t
    n: cython.Py_ssize_t = corners.shape[0]
    A: cython.double[:, ::1] = model.A
    B: cython.double[:, ::1] = model.B
    H: cython.double[:, ::1] = model.H
    N1: cython.double[:, ::1] = model.N1
    N2: cython.double[:, ::1] = model.N2
    m: cython.Py_ssize_t = B.shape[1]
    all_A, all_B = np.empty((n, N, N)), np.empty((n, N, m))
    at_A: cython.double[:, :, ::1] = all_A
    at_B: cython.double[:, :, ::1] = all_B
    force: cython.double
    for vertex in range(n):
        for i in range(N):
            for j in range(N):
                at_A[vertex, i, j] = A[i, j]
            for j in range(m):
                at_B[vertex, i, j] = B[i, j]
            # The third uncertain force is the rear axle's.
            for k in range(N):
                force = H[i, k] * corners[vertex, 1 if k == 2 else 0]
                for j in range(N):
                    at_A[vertex, i, j] += force * N1[k, j]
                for j in range(m):
                    at_B[vertex, i, j] += force * N2[k, j]
    return all_A, all_B
