"""The steady-state target: the steady state of the disturbed model closest to the reference within the input limits.

(47)-(49) in deviations from the reference, as in Muske and Badgwell (2002): `xi_t = A xi_t + B U_t + d`. The offset of
speed and yaw rate is constrained to zero, and v_y takes the required value. While the input limits make that
infeasible, mostly a temporary rate limit, the target stays near zero offset with the inputs that hold it best: the
longitudinal motion is almost an integrator, and with a slightly insufficient force its steady state would be an absurd
speed.
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
"""Cost of drifting from the target by one unit per step, if it cannot be held; an input at its limit costs 1."""
_SIDE_SLIP_COST = 1e-3
"""Cost of a target v_y of one unit: small inputs take priority over small v_y."""


@dataclass(frozen=True)
class Target:
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
