"""The steady-state target: where the disturbed model can rest, as near the reference as the inputs allow.

(47)-(49) in deviations from the reference, as Muske and Badgwell (2002) state it: `xi_t = A xi_t + B U_t + d`.
Speed and yaw rate have no offset wherever the inputs can bring that about, which is a constraint and not a
weight; v_y takes the value that this needs. Where the inputs cannot, which is mostly a rate limit that passes,
the target stays there with the inputs that come nearest to holding it: the longitudinal motion is almost an
integrator, and a force too small by a little would rest only at an absurd speed.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.control.quadratic import minimise

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

_TRACKED = (0, 2)
"""v_x and gamma."""
_DRIFT_COST = 1e6
"""Cost of leaving the target by one unit a step, against 1 for an input at its limit, where it cannot be held."""
_SIDE_SLIP_COST = 1e-3
"""Cost of a target v_y of one unit: inputs are preferred to be small rather than v_y."""


@dataclass(frozen=True)
class Target:
    """A steady state of the disturbed model, in deviations from the reference.

    Attributes:
        xi: (3,) state target xi_t.
        u: (3,) virtual input target U_t.
        solved: a quadratic programme was solved.
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
    """Solve the target problem; where no programme is solved, the reference itself inside the bounds is the target.

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
    n, inputs = A.shape[0], B.shape[1]
    # Variables in units: z = [xi_t / state_unit, (u_ref + U_t) / input_unit].
    rest = np.hstack([(np.eye(n) - A) * state_unit, -B * input_unit]) / state_unit[:, None]
    value = (disturbance - B @ u_ref) / state_unit
    bounds = (
        np.concatenate([np.full(n, -np.inf), lower / input_unit]),
        np.concatenate([np.full(n, np.inf), upper / input_unit]),
    )
    cost = np.concatenate([np.full(n, _SIDE_SLIP_COST), np.ones(inputs)])
    for state in _TRACKED:
        bounds[0][state] = bounds[1][state] = 0.0
    found = minimise(np.diag(cost), np.zeros(n + inputs), *bounds, (rest, value))
    if not found.solved:
        found = minimise(np.diag(cost) + _DRIFT_COST * rest.T @ rest, -_DRIFT_COST * rest.T @ value, *bounds)
    if not found.solved:
        return Target(np.zeros(n), np.clip(u_ref, lower, upper) - u_ref, False)
    return Target(found.x[:n] * state_unit, found.x[n:] * input_unit - u_ref, True)
