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
    from cython.cimports.bench.control.flat_matrices import invert
    from cython.cimports.libc.math import isfinite, sqrt
else:
    from math import isfinite, sqrt

    from bench.control.certificate import proven_cost
    from bench.control.flat_matrices import blank, invert

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Stack = NDArray[np.float64]

N = cython.declare(cython.Py_ssize_t, 3)
_ROUNDING = cython.declare(cython.double, 1e-12)
"""The direction of a deviation below this (scaled units) is that of its rounding errors, and not used."""
_SMALLEST = cython.declare(cython.double, 0.01)
"""Deviations below this (scaled units) are treated as this large."""
_LARGEST_ROOM = cython.declare(cython.double, 10.0)
"""Input room is limited to this multiple of the deviation (scaled units): more is hardly used and costs accuracy."""
_LARGEST_COST_RATIO = 1.5
_NAN = cython.declare(cython.double, np.nan)


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


@cython.cclass
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
        self._x = np.ascontiguousarray(state_scale, dtype=np.float64)
        self._u = np.ascontiguousarray(input_scale, dtype=np.float64)
        self._rho = input_weight
        low, high = LAMBDA_MIN, LAMBDA_MAX
        corners = [(high, high), (low, low), (high, low), (low, high)]
        self._corners = np.array(corners if independent else corners[:2])
        n, m = len(self._corners), len(input_scale)
        self._A, self._B = np.empty((n, N, N)), np.empty((n, N, m))
        self._programs = tuple(programs)

    def solve(self, model: LinearModel, chi: Vector, u_max: Vector) -> Gain:
        """Return the gain of this step.

        Args:
            model: model with m inputs, physical units.
            chi: (3,) deviation from the target.
            u_max: (m,) range of each input about its target, positive.
        """
        i: cython.Py_ssize_t
        j: cython.Py_ssize_t
        limit: cython.double[::1] = u_max
        m: cython.Py_ssize_t = self._u.shape[0]
        scaled = self._scaled(model)
        # The program is homogeneous: in units of the deviation all its numbers are near one. A very small deviation is
        # treated as a larger one in the same direction; the proof for the larger one covers it.
        z, room = np.empty(N), np.empty(m)
        scaled_room: cython.double[::1] = room
        size: cython.double = max(_set_direction(z, chi, self._x), _SMALLEST)
        for i in range(m):
            scaled_room[i] = min(limit[i] / self._u[i] / size, _LARGEST_ROOM)

        for program in self._programs:
            answer = program.solve(scaled, z, room)
            K, tau, status = self._certify(answer, z, room)
            if status is SolverStatus.SOLVED or status is SolverStatus.INFEASIBLE:
                break
        P = np.empty((N, N))
        ellipsoid: cython.double[:, ::1] = P
        unit_ellipsoid: cython.double[:, ::1] = answer.P
        gain: cython.double[:, ::1] = K
        for j in range(N):
            for i in range(m):
                gain[i, j] *= self._u[i] / self._x[j]
            for i in range(N):
                ellipsoid[i, j] = unit_ellipsoid[i, j] * (size * size)
        return Gain(K, P, tau * size**2, status, answer.iterations, program.source)

    def _certify(self, answer: Answer, z: Vector, room: Vector) -> tuple[Matrix, float, SolverStatus]:
        """Return gain and cost in scaled units, and SOLVED only if the certificate holds; otherwise the gain is 0."""
        shape = (room.size, N)
        if answer.P.shape != (N, N) or answer.Y.shape != shape:
            raise ValueError(
                f"a program returned P {answer.P.shape} and Y {answer.Y.shape} instead of {(N, N)} and {shape}"
            )
        status = answer.status
        if status is not SolverStatus.SOLVED and status is not SolverStatus.ALMOST_SOLVED:
            return np.zeros(shape), answer.tau, status
        P = np.ascontiguousarray(answer.P, dtype=np.float64)
        K = _gain(P, np.ascontiguousarray(answer.Y, dtype=np.float64))
        proven: cython.double = proven_cost(K, P, self._rho, self._A, self._B, z, room)
        # The proven cost must be close to the solver's; otherwise the solve itself failed.
        if proven <= _LARGEST_COST_RATIO * answer.tau:
            return K, proven, SolverStatus.SOLVED
        return np.zeros(shape), answer.tau, SolverStatus.CHECK_FAILED

    def _scaled(self, model: LinearModel) -> LinearModel:
        """Return the same model in units of the states and inputs, and set A and B to its vertices."""
        i: cython.Py_ssize_t
        j: cython.Py_ssize_t
        m: cython.Py_ssize_t = self._u.shape[0]
        A: cython.double[:, ::1] = model.A
        B: cython.double[:, ::1] = model.B
        H: cython.double[:, ::1] = model.H
        N1: cython.double[:, ::1] = model.N1
        N2: cython.double[:, ::1] = model.N2
        # Few arrays, because an array costs more than the arithmetic.
        square, wide = np.empty((3, N, N)), np.empty((2, N, m))
        A_H_N1: cython.double[:, :, ::1] = square
        B_N2: cython.double[:, :, ::1] = wide
        x: cython.double[::1] = self._x
        u: cython.double[::1] = self._u
        for i in range(N):
            for j in range(N):
                A_H_N1[0, i, j] = A[i, j] / x[i] * x[j]
                A_H_N1[1, i, j] = H[i, j] / x[i]
                A_H_N1[2, i, j] = N1[i, j] * x[j]
            for j in range(m):
                B_N2[0, i, j] = B[i, j] / x[i] * u[j]
                B_N2[1, i, j] = N2[i, j] * u[j]
        self._set_vertices(A_H_N1, B_N2)
        return LinearModel(square[0], wide[0], square[1], square[2], wide[1])

    @cython.cfunc
    @cython.exceptval(check=False)
    def _set_vertices(self, A_H_N1: cython.double[:, :, ::1], B_N2: cython.double[:, :, ::1]) -> cython.void:
        """Set A and B at each corner of the uncertainty; see `LinearModel.at`."""
        vertex: cython.Py_ssize_t
        i: cython.Py_ssize_t
        j: cython.Py_ssize_t
        k: cython.Py_ssize_t
        m: cython.Py_ssize_t = self._u.shape[0]
        force: cython.double
        for vertex in range(self._corners.shape[0]):
            for i in range(N):
                for j in range(N):
                    self._A[vertex, i, j] = A_H_N1[0, i, j]
                for j in range(m):
                    self._B[vertex, i, j] = B_N2[0, i, j]
                # The third uncertain force is the rear axle's.
                for k in range(N):
                    force = A_H_N1[1, i, k] * self._corners[vertex, 1 if k == 2 else 0]
                    for j in range(N):
                        self._A[vertex, i, j] += force * A_H_N1[2, k, j]
                    for j in range(m):
                        self._B[vertex, i, j] += force * B_N2[1, k, j]


@cython.cfunc
def _set_direction(z: cython.double[::1], chi: cython.double[::1], unit: cython.double[::1]) -> cython.double:
    """Set z (3,) to the direction of chi (3,) in these units and return its length; the first axis if it has none."""
    i: cython.Py_ssize_t
    size: cython.double = 0.0
    for i in range(N):
        z[i] = chi[i] / unit[i]
        size += z[i] * z[i]
    size = sqrt(size)
    for i in range(N):
        z[i] = (1.0 if i == 0 else 0.0) if size < _ROUNDING else z[i] / size
    return size


def _gain(P: cython.double[:, ::1], Y: cython.double[:, ::1]) -> Matrix:
    """K = Y P^-1 (m, 3); NaN if P is singular."""
    m: cython.Py_ssize_t = Y.shape[0]
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    determinant: cython.double
    known: cython.double
    K = np.empty((m, N))
    gain: cython.double[:, ::1] = K
    flat: cython.double[9]
    inverse: cython.double[9]
    if not cython.compiled:
        flat, inverse = blank(2)
    for i in range(N):
        for j in range(N):
            flat[3 * i + j] = P[i, j]
    determinant = invert(inverse, flat)
    invertible: cython.bint = determinant > 0.0 and isfinite(determinant)
    for i in range(m):
        for j in range(N):
            known = Y[i, 0] * inverse[j] + Y[i, 1] * inverse[3 + j] + Y[i, 2] * inverse[6 + j]
            gain[i, j] = known if invertible else _NAN
    return K
