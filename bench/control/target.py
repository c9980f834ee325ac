# cython: boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""The steady-state target: the steady state of the disturbed model closest to the reference within the input limits.

(47)-(49) in deviations from the reference, as in Muske and Badgwell (2002): `xi_t = A xi_t + B U_t + d`. The offset of
speed and yaw rate is constrained to zero, and v_y takes the required value. While the input limits make that
infeasible, mostly a temporary rate limit, the target stays near zero offset with the inputs that hold it best: the
longitudinal motion is almost an integrator, and with a slightly insufficient force its steady state would be an absurd
speed.
"""

from typing import NamedTuple

import cython
import numpy as np
from numpy.typing import NDArray

from bench.control.quadratic import minimise

if cython.compiled:
    from cython.cimports.bench.control.matrices import invert
    from cython.cimports.bench.control.quadratic import minimise_in_box
    from cython.cimports.libc.math import fabs, isfinite
else:
    from math import fabs, isfinite

    from bench.control.matrices import invert
    from bench.control.quadratic import minimise_in_box

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

_N = cython.declare(cython.int, 3)
_DRIFT_COST = cython.declare(cython.double, 1e6)
"""Cost of drifting from the target by one unit per step, if it cannot be held; an input at its limit costs 1."""
_SIDE_SLIP_COST = cython.declare(cython.double, 1e-3)
"""Cost of a target v_y of one unit: small inputs take priority over small v_y."""
_INFINITY = cython.declare(cython.double, float("inf"))
_SLACK = cython.declare(cython.double, 1e-9)
"""An input beyond its bound by this part of its unit is at the bound."""


class Target(NamedTuple):
    """A steady state of the disturbed model, in deviations from the reference.

    Attributes:
        xi: (3,) state target xi_t.
        u: (3,) virtual input target U_t.
        solved: whether a quadratic programme was solved.
    """

    xi: Vector
    u: Vector
    solved: bool


def steady_state_target(
    A: Matrix,
    B: Matrix,
    disturbance: Vector,
    u_ref: Vector,
    lower: Vector,
    upper: Vector,
    state_unit: Vector,
    input_unit: Vector,
) -> Target:
    """Solve the target problem; if no programme is solved, the target is the reference, clipped to the bounds.

    Args:
        A: (3, 3) nominal model.
        B: (3, 3) nominal model, virtual inputs.
        disturbance: (3,) disturbance per step, state units.
        u_ref: (3,) reference input; the cost is on the whole input, `u_ref + U_t`.
        lower: (3,) lower bound of the whole input (input bounds and rate bounds together).
        upper: (3,) upper bound of the whole input.
        state_unit: (3,) size of one unit of each state.
        input_unit: (3,) size of one unit of each input.
    """
    xi, u = np.empty(_N), np.empty(_N)
    solved = TargetSearch(state_unit, input_unit).find(xi, u, A, B, disturbance, u_ref, lower, upper)
    return Target(xi, u, bool(solved))


class TargetSearch:
    """Solves the target problem step by step, without an array of its own for each step.

    Args:
        state_unit: (3,) size of one unit of each state.
        input_unit: (3,) size of one unit of each input.
    """

    def __init__(self, state_unit: Vector, input_unit: Vector) -> None:
        self._state_unit = state_unit
        self._input_unit = input_unit
        self._inverse = np.empty((_N, _N))
        square, rows = np.empty((_N + 1, _N + 1)), np.empty((7, _N + 1))
        self._H = square
        self._g, self._low, self._high, self._rest, self._z = rows[0], rows[1], rows[2], rows[3], rows[4]
        self._needed, self._per_v_y = rows[5], rows[6]
        self._box_work = np.empty((_N + 3, _N + 1))

    def find(
        self,
        xi: cython.double[::1],
        u: cython.double[::1],
        A: cython.double[:, ::1],
        B: cython.double[:, ::1],
        disturbance: cython.double[::1],
        u_ref: cython.double[::1],
        lower: cython.double[::1],
        upper: cython.double[::1],
    ) -> cython.bint:
        """Set xi and u to those of `steady_state_target`, and return whether a programme was solved."""
        i: cython.Py_ssize_t
        if self._is_exact(xi, u, A, B, disturbance, u_ref, lower, upper):
            return True
        if self._is_nearest(xi, u, A, B, disturbance, u_ref, lower, upper):
            return True
        for i in range(_N):
            xi[i] = 0.0
            u[i] = min(max(u_ref[i], lower[i]), upper[i]) - u_ref[i]
        return False

    def _is_exact(
        self,
        xi: cython.double[::1],
        u: cython.double[::1],
        A: cython.double[:, ::1],
        B: cython.double[:, ::1],
        disturbance: cython.double[::1],
        u_ref: cython.double[::1],
        lower: cython.double[::1],
        upper: cython.double[::1],
    ) -> cython.bint:
        """Set the target at rest without offset; return False if the bounds allow none.

        Only v_y is free. In units, the whole input is `hold + per_v_y v_y`, so the programme has one variable: its
        unconstrained minimum, moved into the range that the input bounds leave.
        """
        i: cython.Py_ssize_t
        j: cython.Py_ssize_t
        hold: cython.double
        slope: cython.double
        least: cython.double
        most: cython.double
        v_y: cython.double
        one: cython.double
        other: cython.double
        gradient: cython.double = 0.0
        curvature: cython.double = _SIDE_SLIP_COST
        needed: cython.double[::1] = self._needed
        per_v_y: cython.double[::1] = self._per_v_y
        state_unit: cython.double[::1] = self._state_unit
        input_unit: cython.double[::1] = self._input_unit
        inverse: cython.double[:, ::1] = self._inverse
        determinant: cython.double = invert(inverse, B)
        if determinant == 0.0 or not isfinite(determinant):
            return False
        for i in range(_N):
            hold = u_ref[i]
            slope = 0.0
            for j in range(_N):
                hold -= inverse[i, j] * disturbance[j]
                slope += inverse[i, j] * ((1.0 if j == 1 else 0.0) - A[j, 1])
            needed[i] = hold / input_unit[i]
            per_v_y[i] = slope * state_unit[1] / input_unit[i]
            gradient += needed[i] * per_v_y[i]
            curvature += per_v_y[i] * per_v_y[i]
        v_y = -gradient / curvature
        least, most = -_INFINITY, _INFINITY
        for i in range(_N):
            one = lower[i] / input_unit[i] - _SLACK - needed[i]
            other = upper[i] / input_unit[i] + _SLACK - needed[i]
            if fabs(per_v_y[i]) > 0.0:
                one, other = one / per_v_y[i], other / per_v_y[i]
                least, most = max(least, min(one, other)), min(most, max(one, other))
            elif not one <= 0.0 <= other:
                return False
        if not least <= most or not isfinite(v_y):
            return False
        v_y = min(max(v_y, least), most)
        xi[0], xi[1], xi[2] = 0.0, v_y * state_unit[1], 0.0
        for i in range(_N):
            u[i] = (needed[i] + per_v_y[i] * v_y) * input_unit[i]
            u[i] = min(max(u[i], lower[i]), upper[i]) - u_ref[i]
        return True

    def _is_nearest(
        self,
        xi: cython.double[::1],
        u: cython.double[::1],
        A: cython.double[:, ::1],
        B: cython.double[:, ::1],
        disturbance: cython.double[::1],
        u_ref: cython.double[::1],
        lower: cython.double[::1],
        upper: cython.double[::1],
    ) -> cython.bint:
        """Set the target nearest to rest, without offset; return False if it cannot be computed."""
        i: cython.Py_ssize_t
        j: cython.Py_ssize_t
        k: cython.Py_ssize_t
        # Variables in units: z = [v_y, u_ref + U_t]; the drift is `rest z - value`.
        H: cython.double[:, ::1] = self._H
        g: cython.double[::1] = self._g
        low: cython.double[::1] = self._low
        high: cython.double[::1] = self._high
        rest: cython.double[::1] = self._rest
        z: cython.double[::1] = self._z
        state_unit: cython.double[::1] = self._state_unit
        input_unit: cython.double[::1] = self._input_unit
        value: cython.double
        g[:] = 0.0
        H[:, :] = 0.0
        for k in range(_N):
            rest[0] = ((1.0 if k == 1 else 0.0) - A[k, 1]) * state_unit[1] / state_unit[k]
            value = disturbance[k]
            for j in range(_N):
                rest[j + 1] = -B[k, j] * input_unit[j] / state_unit[k]
                value -= B[k, j] * u_ref[j]
            value /= state_unit[k]
            for i in range(_N + 1):
                g[i] -= _DRIFT_COST * rest[i] * value
                for j in range(_N + 1):
                    H[i, j] += _DRIFT_COST * rest[i] * rest[j]
        H[0, 0] += _SIDE_SLIP_COST
        low[0], high[0] = -_INFINITY, _INFINITY
        for i in range(_N):
            H[i + 1, i + 1] += 1.0
            low[i + 1] = lower[i] / input_unit[i]
            high[i + 1] = upper[i] / input_unit[i]
        if not minimise_in_box(z, H, g, low, high, self._box_work):
            found = minimise(np.array(H), np.array(g), np.array(low), np.array(high))
            if not found.solved:
                return False
            z = found.x
        xi[0], xi[1], xi[2] = 0.0, z[0] * state_unit[1], 0.0
        for i in range(_N):
            u[i] = z[i + 1] * input_unit[i] - u_ref[i]
        return True
