"""The reference input, which takes the model from one reference state to the next, (21)-(23).

A sequential quadratic programme on the nonlinear model: each pass linearises the model about the current input and
solves a box-constrained quadratic programme.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.control.allocation import Allocation
from bench.control.quadratic import minimise
from bench.control.vehicle_model import VehicleModel, linearise, step

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
    ones = np.ones(limit.size)
    z = np.clip(start / limit, -ones, ones)
    solved = True
    for _ in range(passes):
        cost = _cost(model.numbers, allocation.matrix, limit, xi, xi_next, z, state_weight, input_weight)
        found = minimise(*cost, -ones, ones)
        if not found.solved:
            solved = False
            break
        z = found.x
    u = limit * z
    residual = model.step(xi, allocation.matrix @ u) - xi_next
    return ReferenceInput(u, residual, solved)


def _cost(
    numbers: Vector,
    allocation: Matrix,
    limit: Vector,
    xi: Vector,
    xi_next: Vector,
    z: Vector,
    state_weight: Vector,
    input_weight: Vector,
) -> tuple[Matrix, Vector]:
    """Hessian (3, 3) and gradient (3,) of (21) about the input `limit * z`; see `reference_input`."""
    U = allocation @ (limit * z)
    _, of_input, _, _, _ = linearise(numbers, xi, U)
    B = of_input @ allocation * limit
    miss = step(numbers, xi, U) - xi_next - B @ z
    weighted = np.ascontiguousarray(B.T) * state_weight
    return weighted @ B + np.diag(input_weight), weighted @ miss
