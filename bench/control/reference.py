# cython: boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""The reference input, which takes the model from one reference state to the next, (21)-(23).

A sequential quadratic programme on the nonlinear model: each pass linearises the model about the current input and
solves a box-constrained quadratic programme.
"""

from typing import NamedTuple

import cython
import numpy as np
from numpy.typing import NDArray

from bench.control.allocation import Allocation
from bench.control.quadratic import minimise
from bench.control.vehicle_model import VehicleModel

if cython.compiled:
    from cython.cimports.bench.control.quadratic import minimise_in_box
    from cython.cimports.bench.control.vehicle_model import linearise, step
else:
    from bench.control.quadratic import minimise_in_box
    from bench.control.vehicle_model import linearise, step

Vector = NDArray[np.float64]

STATES = cython.declare(cython.int, 3)
INPUTS = cython.declare(cython.int, 3)
REAL_INPUTS = cython.declare(cython.int, 5)


class ReferenceInput(NamedTuple):
    """The reference input of one step.

    Attributes:
        u: (3,) virtual input [delta, F, M] (rad, N, N m).
        residual: (3,) error of the model's next state from the next reference state, due to input bounds and weights:
            a known disturbance.
        solved: whether every quadratic programme was solved.
    """

    u: Vector
    residual: Vector
    solved: bool


def reference_input(
    model: VehicleModel,
    allocation: Allocation,
    xi: Vector,
    xi_next: Vector,
    start: Vector,
    state_weight: Vector,
    input_weight: Vector,
    passes: int = 2,
) -> ReferenceInput:
    """Solve (21)-(22) from a reference state to the next one; see `ReferenceSearch`.

    Args:
        model: the nonlinear model f of (22).
        allocation: virtual inputs and their limits.
        xi: (3,) this step's reference state.
        xi_next: (3,) the next step's.
        start: (3,) virtual input to start from (the last step's).
        state_weight: see `ReferenceSearch`.
        input_weight: see `ReferenceSearch`.
        passes: number of quadratic programmes; two reach the optimum if the next state is reachable, and come
            within 1 % of its cost if the bounds are active and the start is far away.
    """
    u, residual = np.empty(INPUTS), np.empty(STATES)
    search = ReferenceSearch(model, allocation, state_weight, input_weight)
    solved = bool(search.find(u, residual, xi, xi_next, start, passes))
    return ReferenceInput(u, residual, solved)


class ReferenceSearch:
    """Solves (21)-(22) step by step, without an array of its own for each step.

    Args:
        model: the nonlinear model f of (22).
        allocation: virtual inputs and their limits.
        state_weight: (3,) diagonal of Q_1, per squared state unit.
        input_weight: (3,) diagonal of R_1, for each input in units of its limit.
    """

    def __init__(self, model: VehicleModel, allocation: Allocation, state_weight: Vector, input_weight: Vector) -> None:
        self._numbers = model.numbers
        self._matrix = allocation.matrix
        self._limit = allocation.limit
        self._Q = state_weight
        self._R = input_weight
        work = np.empty((13, INPUTS))
        self._z, self._lower, self._upper, self._better, self._gradient = work[0], work[1], work[2], work[3], work[4]
        self._hessian = work[5:8]
        self._box_work = work[8:]
        self._spare = np.empty((17, REAL_INPUTS))
        self._lower[:], self._upper[:] = -1.0, 1.0

    def find(
        self,
        u: cython.double[::1],
        residual: cython.double[::1],
        xi: cython.double[::1],
        xi_next: cython.double[::1],
        start: cython.double[::1],
        passes: cython.int,
    ) -> cython.bint:
        """Set u and residual to those of `ReferenceInput`, and return whether every programme was solved."""
        i: cython.Py_ssize_t
        z: cython.double[::1] = self._z
        better: cython.double[::1] = self._better
        hessian: cython.double[:, ::1] = self._hessian
        gradient: cython.double[::1] = self._gradient
        lower: cython.double[::1] = self._lower
        upper: cython.double[::1] = self._upper
        limit: cython.double[::1] = self._limit
        solved: cython.bint = True
        for i in range(INPUTS):
            z[i] = max(-1.0, min(1.0, start[i] / limit[i]))
        for _ in range(passes):
            _set_cost(
                hessian, gradient, self._spare, self._numbers, self._matrix, limit, xi, xi_next, z, self._Q, self._R
            )
            if not minimise_in_box(better, hessian, gradient, lower, upper, self._box_work):
                found = minimise(np.array(hessian), np.array(gradient), np.array(lower), np.array(upper))
                if not found.solved:
                    solved = False
                    break
                better = found.x
            for i in range(INPUTS):
                z[i] = better[i]
        _set_real_input(self._spare[0], self._matrix, limit, z)
        step(residual, self._numbers, xi, self._spare[0])
        for i in range(INPUTS):
            u[i] = limit[i] * z[i]
        for i in range(STATES):
            residual[i] -= xi_next[i]
        return solved


@cython.cfunc
@cython.exceptval(check=False)
def _set_real_input(
    U: cython.double[::1], allocation: cython.double[:, ::1], limit: cython.double[::1], z: cython.double[::1]
) -> cython.void:
    """Set U (5,) to that of the virtual input `limit * z`."""
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    for i in range(REAL_INPUTS):
        U[i] = 0.0
        for j in range(INPUTS):
            U[i] += allocation[i, j] * (limit[j] * z[j])


@cython.cfunc
@cython.exceptval(check=False)
def _set_cost(
    hessian: cython.double[:, ::1],
    gradient: cython.double[::1],
    spare: cython.double[:, ::1],
    numbers: cython.double[::1],
    allocation: cython.double[:, ::1],
    limit: cython.double[::1],
    xi: cython.double[::1],
    xi_next: cython.double[::1],
    z: cython.double[::1],
    state_weight: cython.double[::1],
    input_weight: cython.double[::1],
) -> cython.void:
    """Hessian (3, 3) and gradient (3,) of (21) about the input `limit * z`; `spare` (17, 5) is overwritten."""
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    k: cython.Py_ssize_t
    U: cython.double[::1] = spare[0]
    miss: cython.double[::1] = spare[1]
    of_input: cython.double[:, ::1] = spare[2:5]
    B: cython.double[:, ::1] = spare[5:8]
    _set_real_input(U, allocation, limit, z)
    # Of the linear model, only B is used.
    linearise(spare[8:11], of_input, spare[11:14], spare[8:11], spare[14:17], numbers, xi, U)
    step(miss, numbers, xi, U)
    for i in range(STATES):
        miss[i] -= xi_next[i]
        for j in range(INPUTS):
            B[i, j] = 0.0
            for k in range(REAL_INPUTS):
                B[i, j] += of_input[i, k] * allocation[k, j]
            B[i, j] *= limit[j]
            miss[i] -= B[i, j] * z[j]
    for i in range(INPUTS):
        gradient[i] = 0.0
        for j in range(INPUTS):
            hessian[i, j] = input_weight[i] if i == j else 0.0
        for k in range(STATES):
            gradient[i] += B[k, i] * state_weight[k] * miss[k]
            for j in range(INPUTS):
                hessian[i, j] += B[k, i] * state_weight[k] * B[k, j]
