"""The stability boundaries and the limiting of a reference to them, (27)-(32) and (35).

The lift-off limits of (31) are 25 to 29 m/s^2 and are never active on a real road, so the adhesion limit
`|a_x| <= mu g` and the friction circle `a_x^2 + a_y^2 <= (mu g)^2` with `a_y = gamma v_x` apply as well. (35) prints
l_f twice; here l_r limits acceleration and l_f braking.
"""

import math
from typing import NamedTuple

from bench.control.compiled import njit
from bench.control.outcome import Limit
from platoon_fmu.parameters import VehicleParameters

YAW_SHARE = 0.85
"""Fraction of the adhesion available for lateral acceleration, (29)."""


class Boundaries(NamedTuple):
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
    """

    mu_g: float
    lift_front: float
    lift_rear: float
    share: float
    acceleration_max: float
    yaw_acceleration_max: float
    speed_min: float
    speed_max: float


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
    # An integer would make numba compile the functions again.
    return Boundaries(
        mu_g=mu * vehicle.g,
        lift_front=vehicle.g * vehicle.l_r / vehicle.h,
        lift_rear=vehicle.g * vehicle.l_f / vehicle.h,
        share=float(share),
        acceleration_max=float(acceleration_max),
        yaw_acceleration_max=float(yaw_acceleration_max),
        speed_min=float(speed_min),
        speed_max=float(speed_max),
    )


@njit(cache=True)
def yaw_rate_max(v_x: float, mu_g: float) -> float:
    """gamma_max (rad/s) at a speed v_x > 0 (m/s), (29)."""
    return YAW_SHARE * mu_g / v_x


@njit(cache=True)
def largest_acceleration(gamma: float, v: float, limits: Boundaries) -> float:
    """The largest |a_x| (m/s^2) at lateral acceleration gamma v, by the friction circle and `acceleration_max`."""
    allowed = limits.share * limits.mu_g
    lateral = gamma * v
    return float(min(math.sqrt(max(allowed * allowed - lateral * lateral, 0.0)), limits.acceleration_max))


@njit(cache=True)
def speed_reach(v: float, accelerating: bool, step_s: float, limits: Boundaries) -> float:
    """V_k (m/s) of (35) with the printed l_f corrected: the extreme speed reachable in one step."""
    return float(v + limits.lift_front * step_s if accelerating else v - limits.lift_rear * step_s)


@njit(cache=True)
def admissible(
    v: float, gamma: float, v_rate: float, gamma_rate: float, step_s: float, limits: Boundaries
) -> tuple[float, float, Limit]:
    """The next reference (m/s, rad/s), limited to the boundaries, and the decisive `Limit`.

    Args:
        v: this step's reference speed, m/s.
        gamma: this step's reference yaw rate, rad/s.
        v_rate: requested dv/dt, m/s^2.
        gamma_rate: requested dgamma/dt, rad/s^2.
        step_s: T, s.
        limits: the boundaries.
    """
    bound = Limit.NONE
    a_max = limits.acceleration_max
    if abs(v_rate) > a_max:
        v_rate = a_max if v_rate > 0.0 else -a_max
        bound = Limit.ACCELERATION
    lowest, highest = (
        -min(limits.lift_rear, limits.mu_g) * limits.share,
        min(limits.lift_front, limits.mu_g) * limits.share,
    )
    if v_rate < lowest or v_rate > highest:
        v_rate = min(max(v_rate, lowest), highest)
        bound = Limit.ACCELERATION

    swing = limits.yaw_acceleration_max
    gamma_next = gamma + step_s * min(max(gamma_rate, -swing), swing)
    # The boundary at the highest speed within this step, so that it holds throughout.
    v_fast = max(v, v + step_s * v_rate, limits.speed_min)
    gamma_max = limits.share * yaw_rate_max(v_fast, limits.mu_g)
    if abs(gamma_next) > gamma_max:
        gamma_next = gamma_max if gamma_next > 0.0 else -gamma_max
        bound = Limit.YAW_RATE

    circle = largest_acceleration(gamma_next, v_fast, limits)
    if abs(v_rate) > circle:
        v_rate = circle if v_rate > 0.0 else -circle
        if bound != Limit.YAW_RATE:
            bound = Limit.FRICTION_CIRCLE
    v_next = v + step_s * v_rate
    if v_next < limits.speed_min or v_next > limits.speed_max:
        v_next = min(max(v_next, limits.speed_min), limits.speed_max)
        bound = Limit.SPEED
    return v_next, gamma_next, bound
