"""Steady-state circular driving at constant speed, after ISO 4138 (constant-speed test method)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from platoon_fmu.importer import OpenFmu
from platoon_fmu.parameters import VehicleParameters
from platoon_fmu.physics.drive import Array, Car, SpeedHold, of_wheels
from platoon_fmu.physics.figure import Figure, between, near
from platoon_fmu.physics.reference import (
    roll_gradient,
    running_stiffness,
    table_stiffness,
    understeer_gradient,
)

SPEED = 20.0
"""Speed of the test [m/s]."""
HOLD_S = 4.0
"""How long each steering angle is held before it is measured [s]."""
LINEAR_RANGE = 1.0
"""Lateral acceleration up to which the understeer gradient is fitted [m/s^2]."""

_ANGLES = np.concatenate([np.arange(0.0, 0.021, 0.001), np.arange(0.025, 0.2501, 0.005)])


@dataclass(frozen=True)
class CircularDriving:
    """Steady values at each steering angle, (angles,), and the metrics.

    Attributes:
        delta: steering angle [rad].
        a_y: lateral acceleration [m/s^2].
        gamma: yaw rate [rad/s].
        phi: roll angle [rad].
        alpha_f: mean slip angle of the front tyres, positive where it pushes left [rad].
        alpha_r: the same of the rear tyres [rad].
        figures: the metrics.
    """

    delta: Array
    a_y: Array
    gamma: Array
    phi: Array
    alpha_f: Array
    alpha_r: Array
    figures: tuple[Figure, ...]


def circular_driving(fmu: OpenFmu, P: VehicleParameters) -> CircularDriving:
    """Steers in steps up to the limit at constant speed, each step held until the motion is steady.

    Args:
        fmu: the vehicle.
        P: the parameters for the expected values.
    """
    names = ("a_y", "gamma", "phi", *of_wheels("alpha"))
    rows = []
    with Car(fmu, {"v_x_start": SPEED}) as car:
        hold = SpeedHold(SPEED)
        for delta in _ANGLES:
            car.set(steering_angle=delta)
            car.record(HOLD_S, 0.01, (), hold)
            rows.append(car.get(*names))
    a_y, gamma, phi, alpha_fl, alpha_rl, alpha_rr, alpha_fr = np.array(rows).T
    gradient = _slope_at_zero(a_y, _ANGLES - P.L * gamma / SPEED)
    figures = (
        near(
            "Understeer gradient",
            gradient,
            understeer_gradient(P, table_stiffness(P)),
            relative=0.02,
            unit="s²/m",
            source="(M/L)(l_r/2C_f − l_f/2C_r), stiffnesses at static load",
        ),
        near(
            "Understeer gradient, running loads",
            gradient,
            understeer_gradient(P, running_stiffness(P)),
            relative=0.003,
            unit="s²/m",
            source="the same with the load moved to the front axle by rolling resistance",
        ),
        near(
            "Roll gradient",
            _slope_at_zero(a_y, phi),
            roll_gradient(P),
            relative=0.001,
            unit="rad s²/m",
            source="m_s h_s/(K_φ − m_s g h_s), moments about the roll axis",
        ),
        between(
            "Greatest lateral acceleration over μ g",
            float(a_y.max()) / (P.mu_a * P.g),
            0.9,
            1.01,
            source="friction: an axle's force is at most μ times its load",
        ),
    )
    return CircularDriving(_ANGLES, a_y, gamma, phi, (alpha_fl + alpha_fr) / 2, (alpha_rl + alpha_rr) / 2, figures)


def _slope_at_zero(a_y: Array, values: Array) -> float:
    """The slope over a_y at a_y = 0 of a cubic through zero, which excludes the tyres' degression."""
    small = a_y <= LINEAR_RANGE
    powers = np.stack([a_y[small], a_y[small] ** 2, a_y[small] ** 3], axis=1)
    return float(np.linalg.lstsq(powers, values[small], rcond=None)[0][0])
