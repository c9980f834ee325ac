"""The stability boundaries and what keeps a reference inside them, (27)-(32) and (35).

The lift-off limits of (31) are 25 to 29 m/s^2 and never bind on a real road, so the adhesion limit `|a_x| <= mu g` and
the friction circle `a_x^2 + a_y^2 <= (mu g)^2` with `a_y = gamma v_x` hold as well. Of (35), which prints l_f twice,
acceleration is limited by l_r and braking by l_f.
"""

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from bench.control.outcome import Limit
from platoon_fmu.parameters import VehicleParameters

Vector = NDArray[np.float64]

YAW_SHARE = 0.85
"""Share of the adhesion that lateral acceleration may use, (29)."""


@dataclass(frozen=True)
class Boundaries:
    """The boundaries of one vehicle on one road.

    Attributes:
        mu_g: adhesion times gravity, m/s^2.
        lift_front: g l_r / h, at which the front wheels lift, m/s^2.
        lift_rear: g l_f / h, at which the rear wheels lift, m/s^2.
        share: part of the boundaries that a reference may use, in (0, 1]; the rest is for the tracking error.
        acceleration_max: largest acceleration and braking asked for, m/s^2.
        yaw_acceleration_max: largest change of the yaw rate asked for, rad/s^2.
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

    def as_vector(self) -> Vector:
        """The numbers in the order of the attributes, for the compiled functions."""
        return np.array(
            [
                self.mu_g,
                self.lift_front,
                self.lift_rear,
                self.share,
                self.acceleration_max,
                self.yaw_acceleration_max,
                self.speed_min,
                self.speed_max,
            ]
        )


def boundaries(
    vehicle: VehicleParameters,
    mu: float,
    share: float,
    acceleration_max: float,
    yaw_acceleration_max: float,
    speed_min: float,
    speed_max: float,
) -> Boundaries:
    """The boundaries of a vehicle on a road of adhesion `mu`."""
    return Boundaries(
        mu * vehicle.g,
        vehicle.g * vehicle.l_r / vehicle.h,
        vehicle.g * vehicle.l_f / vehicle.h,
        share,
        acceleration_max,
        yaw_acceleration_max,
        speed_min,
        speed_max,
    )


@njit(cache=True)
def yaw_rate_max(v_x: float, mu_g: float) -> float:
    """gamma_max (rad/s) at a speed v_x > 0 (m/s), (29)."""
    return YAW_SHARE * mu_g / v_x


@njit(cache=True)
def largest_acceleration(gamma: float, v: float, limits: Vector) -> float:
    """The largest |a_x| (m/s^2) beside a lateral acceleration gamma v: friction circle and what is asked for."""
    allowed = limits[3] * limits[0]
    lateral = gamma * v
    return float(min(math.sqrt(max(allowed * allowed - lateral * lateral, 0.0)), limits[4]))


@njit(cache=True)
def speed_reach(v: float, accelerating: bool, step_s: float, limits: Vector) -> float:
    """V_k (m/s) of (35) with the printed l_f corrected: the furthest speed one step can reach."""
    return float(v + limits[1] * step_s if accelerating else v - limits[2] * step_s)


@njit(cache=True)
def admissible(
    v: float, gamma: float, v_rate: float, gamma_rate: float, step_s: float, limits: Vector
) -> tuple[float, float, Limit]:
    """The next reference (m/s, rad/s), brought inside the boundaries, and the `Limit` that bound most.

    Args:
        v: this step's reference speed, m/s.
        gamma: this step's reference yaw rate, rad/s.
        v_rate: dv/dt asked for, m/s^2.
        gamma_rate: dgamma/dt asked for, rad/s^2.
        step_s: T, s.
        limits: (8,) `Boundaries.as_vector()`.
    """
    bound = Limit.NONE
    a_max = limits[4]
    if abs(v_rate) > a_max:
        v_rate = a_max if v_rate > 0.0 else -a_max
        bound = Limit.ACCELERATION
    lowest, highest = -min(limits[2], limits[0]) * limits[3], min(limits[1], limits[0]) * limits[3]
    if v_rate < lowest or v_rate > highest:
        v_rate = min(max(v_rate, lowest), highest)
        bound = Limit.ACCELERATION

    swing = limits[5]
    gamma_next = gamma + step_s * min(max(gamma_rate, -swing), swing)
    # The boundary at the fastest speed this step can end with, so that it holds there too.
    v_fast = max(v, v + step_s * v_rate, limits[6])
    gamma_max = limits[3] * yaw_rate_max(v_fast, limits[0])
    if abs(gamma_next) > gamma_max:
        gamma_next = gamma_max if gamma_next > 0.0 else -gamma_max
        bound = Limit.YAW_RATE

    circle = largest_acceleration(gamma_next, v_fast, limits)
    if abs(v_rate) > circle:
        v_rate = circle if v_rate > 0.0 else -circle
        if bound != Limit.YAW_RATE:
            bound = Limit.FRICTION_CIRCLE
    v_next = v + step_s * v_rate
    if v_next < limits[6] or v_next > limits[7]:
        v_next = min(max(v_next, limits[6]), limits[7])
        bound = Limit.SPEED
    return v_next, gamma_next, bound
