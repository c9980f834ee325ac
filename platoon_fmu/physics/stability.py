"""The oversteering car: its critical speed, from the eigenvalues in Model Exchange and in the time domain."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from platoon_fmu.errors import FmuError
from platoon_fmu.importer import Instance, Kind, OpenFmu
from platoon_fmu.parameters import VehicleParameters
from platoon_fmu.physics.drive import Array, Car, SpeedHold
from platoon_fmu.physics.figure import Figure, near
from platoon_fmu.physics.reference import critical_speed, running_stiffness, table_stiffness, two_track
from platoon_fmu.wheels import WHEEL_NAMES

LAMBDAS = {"lambda_f": 1.0, "lambda_r": -1.0}
"""The stiffest front and the softest rear axle."""
DISTANCE = 0.04
"""Relative distance of the time-domain tests below and above the critical speed."""

_LEFT_OUT = ("X", "Y", "psi", "v_x")
_STEP = 1e-5
_PULSE_RAD, _PULSE_S, _WATCH_S = 1e-6, 0.5, 20.0


@dataclass(frozen=True)
class Disturbed:
    """Yaw rate after a small steering pulse, (rows,) [rad/s], its speed [m/s] and its growth rate [1/s]."""

    speed: float
    t: Array
    gamma: Array
    rate: float


@dataclass(frozen=True)
class Stability:
    """The oversteering car.

    Attributes:
        speeds: of the linearisations, (n,) [m/s].
        real_parts: largest real part of the FMU's eigenvalues there [1/s].
        linear: the same of the linear two-track model [1/s].
        below, above: the tests in the time domain, below and above the critical speed.
        figures: the metrics.
    """

    speeds: Array
    real_parts: Array
    linear: Array
    below: Disturbed
    above: Disturbed
    figures: tuple[Figure, ...]


def oversteer_stability(fmu: OpenFmu, P: VehicleParameters) -> Stability:
    """Finds the critical speed of the oversteering car and disturbs it below and above that speed.

    Args:
        fmu: the vehicle, with Model Exchange and Co-Simulation.
        P: the parameters for the expected values.

    Raises:
        FmuError: a car with these parameters does not oversteer, so it has no critical speed.
    """
    running = running_stiffness(P, **LAMBDAS)
    expected, at_running_loads = (critical_speed(P, C) for C in (table_stiffness(P, **LAMBDAS), running))
    if not (np.isfinite(expected) and np.isfinite(at_running_loads)):
        raise FmuError(
            "with the FMU's declared parameters the car does not oversteer even with lambda_f = 1 and lambda_r = -1"
        )

    def linear(speed: float) -> float:
        return _greatest_real_part(two_track(P, running, speed)[0])

    speeds = np.linspace(0.6 * expected, 1.4 * expected, 33)
    with Instance(fmu, Kind.MODEL_EXCHANGE) as model:
        model.start(LAMBDAS)

        def growth(speed: float) -> float:
            return _greatest_real_part(linearised(model, P, speed))

        found = _root(growth, 0.5 * expected, 2.0 * expected)
        real_parts = np.array([growth(speed) for speed in speeds])
    below, above = (_disturb(fmu, expected * (1 + share)) for share in (-DISTANCE, DISTANCE))
    rates = "eigenvalue of the linear two-track model with roll at that speed"
    figures = (
        near(
            "Critical speed",
            found,
            expected,
            relative=0.02,
            unit="m/s",
            source="√(−L/K_us), stiffnesses at static load; measured where an eigenvalue crosses zero",
        ),
        near(
            "Critical speed, running loads",
            found,
            at_running_loads,
            relative=0.001,
            unit="m/s",
            source="the same with the load moved to the front axle by rolling resistance",
        ),
        near(
            f"Decay rate {100 * DISTANCE:g} % below",
            below.rate,
            linear(below.speed),
            relative=0.01,
            unit="1/s",
            source=f"{rates}: negative, it decays",
        ),
        near(
            f"Growth rate {100 * DISTANCE:g} % above",
            above.rate,
            linear(above.speed),
            relative=0.01,
            unit="1/s",
            source=f"{rates}: positive, it grows",
        ),
    )
    return Stability(speeds, real_parts, np.array([linear(speed) for speed in speeds]), below, above, figures)


def linearised(model: Instance, P: VehicleParameters, speed: float) -> Array:
    """The Jacobian of the states' derivatives at steady straight driving, by central differences.

    It excludes the pose, on which nothing depends, and the speed, which is held.

    Args:
        model: a Model Exchange instance, started.
        P: its parameters.
        speed: v_x, which an external force at the centre of mass holds [m/s].
    """
    rolling = P.mu_d * P.M * P.g
    model.set(force_x=rolling + P.C_a * speed**2)
    steady = {"v_x": speed, "load_transfer_x": -P.h * rolling / P.L}
    steady |= {f"omega_{wheel}": speed / P.R_w for wheel in WHEEL_NAMES}
    x = np.array([steady.get(name, 0.0) for name in model.state_names])
    kept = [i for i, name in enumerate(model.state_names) if name not in _LEFT_OUT]
    columns = []
    for i in kept:
        step = np.zeros(len(x))
        step[i] = _STEP
        columns.append((_derivatives(model, x + step) - _derivatives(model, x - step))[kept] / (2 * _STEP))
    return np.array(columns).T


def _derivatives(model: Instance, x: Array) -> Array:
    model.set_states(x)
    return model.derivatives()


def _greatest_real_part(A: Array) -> float:
    return float(np.linalg.eigvals(A).real.max())


def _root(function: Callable[[float], float], low: float, high: float) -> float:
    """The zero crossing of a function; NaN if there is none between the two."""
    return float(brentq(function, low, high, xtol=1e-6)) if function(low) < 0 < function(high) else float("nan")


def _disturb(fmu: OpenFmu, speed: float) -> Disturbed:
    with Car(fmu, {"v_x_start": speed, **LAMBDAS}) as car:
        hold = SpeedHold(speed)
        car.record(5.0, 0.01, (), hold)
        car.set(steering_angle=_PULSE_RAD)
        pulse = car.record(_PULSE_S, 0.01, ("gamma",), hold)
        car.set(steering_angle=0.0)
        after = car.record(_WATCH_S, 0.01, ("gamma",), hold)
    gamma = np.concatenate([pulse["gamma"], after["gamma"][1:]])
    t = np.concatenate([pulse.t, pulse.t[-1] + after.t[1:]])
    # In the second half only the slowest mode remains.
    late = t >= (_PULSE_S + _WATCH_S) / 2
    with np.errstate(divide="ignore"):
        rate = np.polyfit(t[late], np.log(np.abs(gamma[late])), 1)[0]
    return Disturbed(speed, t, gamma, float(rate))
