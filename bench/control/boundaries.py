# cython: boundscheck=False, cdivision=True
"""The stability boundaries and the limiting of a reference to them, (27)-(32) and (35).

The lift-off limits of (31) are 25 to 29 m/s^2 and are never active on a real road, so the adhesion limit
`|a_x| <= mu g` and the friction circle `a_x^2 + a_y^2 <= (mu g)^2` with `a_y = gamma v_x` apply as well. (35) prints
l_f twice; here l_r limits acceleration and l_f braking.
"""

import cython

from bench.control.outcome import Limit
from platoon_fmu.parameters import VehicleParameters

if cython.compiled:
    from cython.cimports.bench.control.agents import LANES, Agents
    from cython.cimports.libc.math import sqrt
else:
    from math import sqrt

    from bench.control.agents import LANES, Agents

YAW_SHARE = 0.85
"""Fraction of the adhesion available for lateral acceleration, (29)."""

# Constants of C where the file is compiled, declared in boundaries.pxd.
_NONE = Limit.NONE
_YAW_RATE = Limit.YAW_RATE
_ACCELERATION = Limit.ACCELERATION
_FRICTION_CIRCLE = Limit.FRICTION_CIRCLE
_SPEED = Limit.SPEED


@cython.cclass
class Boundaries:
    """The boundaries of one vehicle on one road.

    Attributes:
        mu_g: adhesion times gravity, m/s^2.
        lift_front: g l_r / h, at which the front wheels lift, m/s^2.
        lift_rear: g l_f / h, at which the rear wheels lift, m/s^2.
        share: fraction of the boundaries that a reference may use, in (0, 1]; the remainder allows for tracking errors.
        acceleration_max: largest commanded acceleration and braking, m/s^2.
        yaw_acceleration_max: largest commanded change of the yaw rate, rad/s^2.
        speed_min: m/s.
        speed_max: m/s.
        lateral_max: largest lateral acceleration gamma v of (29), m/s^2.
    """

    def __init__(
        self,
        mu_g: float,
        lift_front: float,
        lift_rear: float,
        share: float,
        acceleration_max: float,
        yaw_acceleration_max: float,
        speed_min: float,
        speed_max: float,
    ) -> None:
        self.mu_g = mu_g
        self.lift_front = lift_front
        self.lift_rear = lift_rear
        self.share = share
        self.acceleration_max = acceleration_max
        self.yaw_acceleration_max = yaw_acceleration_max
        self.speed_min = speed_min
        self.speed_max = speed_max
        self.lateral_max = YAW_SHARE * mu_g
        self._grip = share * mu_g
        self._lowest = max(-acceleration_max, -min(lift_rear, mu_g) * share)
        self._highest = min(acceleration_max, min(lift_front, mu_g) * share)


def boundaries(
    vehicle: VehicleParameters,
    mu: float,
    share: float,
    acceleration_max: float,
    yaw_acceleration_max: float,
    speed_min: float,
    speed_max: float,
) -> Boundaries:
    """Return the boundaries of a vehicle on a road with adhesion `mu`."""
    return Boundaries(
        mu_g=mu * vehicle.g,
        lift_front=vehicle.g * vehicle.l_r / vehicle.h,
        lift_rear=vehicle.g * vehicle.l_f / vehicle.h,
        share=share,
        acceleration_max=acceleration_max,
        yaw_acceleration_max=yaw_acceleration_max,
        speed_min=speed_min,
        speed_max=speed_max,
    )


@cython.ccall
@cython.exceptval(check=False)
def yaw_rate_max(v_x: cython.double, mu_g: cython.double) -> cython.double:
    """gamma_max (rad/s) at a speed v_x > 0 (m/s), (29)."""
    return YAW_SHARE * mu_g / v_x


@cython.ccall
@cython.exceptval(check=False)
def largest_acceleration(gamma: cython.double, v: cython.double, limits: Boundaries) -> cython.double:
    """The largest |a_x| (m/s^2) at lateral acceleration gamma v, by the friction circle and `acceleration_max`."""
    lateral: cython.double = gamma * v
    return min(sqrt(max(limits._grip * limits._grip - lateral * lateral, 0.0)), limits.acceleration_max)


@cython.ccall
@cython.exceptval(check=False)
def speed_reach(
    v: cython.double, accelerating: cython.bint, step_s: cython.double, limits: Boundaries
) -> cython.double:
    """V_k (m/s) of (35) with the printed l_f corrected: the extreme speed reachable in one step."""
    return v + limits.lift_front * step_s if accelerating else v - limits.lift_rear * step_s


@cython.ccall
@cython.exceptval(check=False)
def admissible(
    v: cython.double,
    gamma: cython.double,
    v_rate: cython.double,
    gamma_rate: cython.double,
    step_s: cython.double,
    limits: Boundaries,
) -> tuple[cython.double, cython.double, cython.int]:
    """The next reference (m/s, rad/s), limited to the boundaries, and the number of the decisive `Limit`.

    Args:
        v: this step's reference speed, m/s.
        gamma: this step's reference yaw rate, rad/s.
        v_rate: requested dv/dt, m/s^2.
        gamma_rate: requested dgamma/dt, rad/s^2.
        step_s: T, s.
        limits: the boundaries.
    """
    # Without branches, so that the loop over many agents is vectorised.
    asked: cython.double = v_rate
    v_rate = min(max(v_rate, limits._lowest), limits._highest)
    bound: cython.int = _NONE if v_rate == asked else _ACCELERATION

    swing: cython.double = limits.yaw_acceleration_max
    # The boundary at the highest speed within this step, so that it holds throughout.
    v_fast: cython.double = max(v, v + step_s * v_rate, limits.speed_min)
    gamma_max: cython.double = limits.share * yaw_rate_max(v_fast, limits.mu_g)
    gamma_next: cython.double = gamma + step_s * min(max(gamma_rate, -swing), swing)
    asked = gamma_next
    gamma_next = min(max(gamma_next, -gamma_max), gamma_max)
    turns_less: cython.bint = gamma_next != asked

    circle: cython.double = largest_acceleration(gamma_next, v_fast, limits)
    asked = v_rate
    v_rate = min(max(v_rate, -circle), circle)
    bound = bound if v_rate == asked else _FRICTION_CIRCLE
    bound = _YAW_RATE if turns_less else bound

    asked = v + step_s * v_rate
    v_next: cython.double = min(max(asked, limits.speed_min), limits.speed_max)
    return v_next, gamma_next, bound if v_next == asked else _SPEED


@cython.cfunc
@cython.exceptval(check=False)
def limit(agents: Agents, step_s: cython.double, limits: Boundaries) -> cython.void:
    """Advance each agent's speed and yaw rate by a step (s) as requested, within the boundaries."""
    i: cython.int
    for i in range(LANES):
        agents.v[i], agents.gamma[i], _ = admissible(
            agents.v[i], agents.gamma[i], agents.v_rate[i], agents.gamma_rate[i], step_s, limits
        )


@cython.cfunc
@cython.exceptval(check=False)
def set_yaw_rates_max(agents: Agents, limits: Boundaries) -> cython.void:
    """Set each agent's largest yaw rate at its speed."""
    i: cython.int
    for i in range(LANES):
        agents.gamma_max[i] = yaw_rate_max(agents.v[i], limits.mu_g)


@cython.cfunc
@cython.exceptval(check=False)
def set_speeds_reach(agents: Agents, step_s: cython.double, limits: Boundaries) -> cython.void:
    """Set the extreme speed that each agent could have reached in the direction in which its speed has changed."""
    i: cython.int
    for i in range(LANES):
        agents.v_reach[i] = speed_reach(agents.v_before[i], agents.v[i] >= agents.v_before[i], step_s, limits)
