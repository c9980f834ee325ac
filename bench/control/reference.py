# cython: boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""The reference input, which takes the model from one reference state to the next, (21)-(23).

A sequential quadratic programme on the nonlinear model: each pass linearises the model about the current input and
solves a box-constrained quadratic programme.
"""

from dataclasses import dataclass

import cython
import numpy as np
from numpy.typing import NDArray

from bench.control.allocation import Allocation
from bench.control.quadratic import minimise
from bench.control.vehicle_model import VehicleModel

if cython.compiled:
    from cython.cimports.bench.control.vehicle_model import linearise, step
else:
    from bench.control.vehicle_model import linearise, step

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


@dataclass(frozen=True)
class ReferenceInput:
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
    """Solve (21)-(22) from a reference state to the next one.

    Args:
        model: the nonlinear model f of (22).
        allocation: virtual inputs and their limits.
        xi: (3,) this step's reference state.
        xi_next: (3,) the next step's.
        start: (3,) virtual input to start from (the last step's).
        state_weight: (3,) diagonal of Q_1, per squared state unit.
        input_weight: (3,) diagonal of R_1, for each input in units of its limit.
        passes: number of quadratic programmes; two reach the optimum if the next state is reachable, and come
            within 1 % of its cost if the bounds are active and the start is far away.
    """
    limit = allocation.limit
    count: cython.Py_ssize_t = limit.size
    i: cython.Py_ssize_t
    limits: cython.double[::1] = limit
    begin: cython.double[::1] = start
    z = np.empty(count)
    inside: cython.double[::1] = z
    for i in range(count):
        inside[i] = max(-1.0, min(1.0, begin[i] / limits[i]))
    ones = np.ones(count)
    solved = True
    for _ in range(passes):
        cost = _cost(model.numbers, allocation.matrix, limit, xi, xi_next, z, state_weight, input_weight)
        found = minimise(*cost, -ones, ones)
        if not found.solved:
            solved = False
            break
        z = found.x
    u = limit * z
    reached = np.empty(xi.size)
    step(reached, model.numbers, xi, _real_input(allocation.matrix, limit, z))
    return ReferenceInput(u, reached - xi_next, solved)


def _real_input(allocation: cython.double[:, ::1], limit: cython.double[::1], z: cython.double[::1]) -> Vector:
    """U (5,) of the virtual input `limit * z`."""
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    out = np.zeros(allocation.shape[0])
    U: cython.double[::1] = out
    for i in range(allocation.shape[0]):
        for j in range(allocation.shape[1]):
            U[i] += allocation[i, j] * (limit[j] * z[j])
    return out


def _cost(
    numbers: cython.double[::1],
    allocation: cython.double[:, ::1],
    limit: cython.double[::1],
    xi: cython.double[::1],
    xi_next: cython.double[::1],
    z: cython.double[::1],
    state_weight: cython.double[::1],
    input_weight: cython.double[::1],
) -> tuple[Matrix, Vector]:
    """Hessian (3, 3) and gradient (3,) of (21) about the input `limit * z`; see `reference_input`."""
    states: cython.Py_ssize_t = xi.shape[0]
    inputs: cython.Py_ssize_t = z.shape[0]
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    k: cython.Py_ssize_t
    U: cython.double[::1] = _real_input(allocation, limit, z)
    # Of the linear model, only B is used.
    square: cython.double[:, ::1] = np.empty((3, 3))
    H: cython.double[:, ::1] = np.empty((3, 3))
    of_input: cython.double[:, ::1] = np.empty((3, 5))
    N2: cython.double[:, ::1] = np.empty((3, 5))
    linearise(square, of_input, H, square, N2, numbers, xi, U)
    miss: cython.double[::1] = np.empty(states)
    step(miss, numbers, xi, U)
    B: cython.double[:, ::1] = np.zeros((states, inputs))
    for i in range(states):
        miss[i] -= xi_next[i]
        for j in range(inputs):
            for k in range(U.shape[0]):
                B[i, j] += of_input[i, k] * allocation[k, j]
            B[i, j] *= limit[j]
            miss[i] -= B[i, j] * z[j]
    hessian, gradient = np.zeros((inputs, inputs)), np.zeros(inputs)
    curvature: cython.double[:, ::1] = hessian
    slope: cython.double[::1] = gradient
    for i in range(inputs):
        for k in range(states):
            slope[i] += B[k, i] * state_weight[k] * miss[k]
            for j in range(inputs):
                curvature[i, j] += B[k, i] * state_weight[k] * B[k, j]
        curvature[i, i] += input_weight[i]
    return hessian, gradient
