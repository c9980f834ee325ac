"""Step steer at constant speed, after ISO 7401, against the linear two-track model with roll and wheel spins."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from platoon_fmu.importer import OpenFmu
from platoon_fmu.parameters import VehicleParameters
from platoon_fmu.physics.drive import Array, Car, SpeedHold, Trace
from platoon_fmu.physics.figure import Figure, at_most, near
from platoon_fmu.physics.reference import running_stiffness, step_response, table_stiffness, two_track, yaw_rate_gain

SPEED = 20.0
"""Speed of the test [m/s]."""
SMALL_ANGLE = 1e-4
"""Steering step at which the tyres are still linear [rad]."""
STANDARD_ACCELERATION = 4.0
"""Steady lateral acceleration of the second, larger step: the standard's level [m/s^2]."""

_H, _SECONDS, _SETTLE_S = 0.001, 5.0, 5.0


@dataclass(frozen=True)
class Response:
    """The characteristics of a step response; times are measured from the step.

    Attributes:
        steady: the value at the end.
        rise_time: to 90 % of it, ISO 7401's response time [s].
        peak_time: to the maximum [s].
        overshoot: of the maximum, relative to the steady value [1].
    """

    steady: float
    rise_time: float
    peak_time: float
    overshoot: float


@dataclass(frozen=True)
class StepSteer:
    """Yaw rate over steering angle after the step, (rows,) [1/s], and the metrics.

    Attributes:
        t: time from the step [s].
        small: of the FMU, small step.
        standard: of the FMU, step to about `STANDARD_ACCELERATION`.
        linear: of the linear two-track model.
        standard_angle: steering angle of that larger step [rad].
        tolerance: allowed relative deviation of the small step from the linear model.
        figures: the metrics.
    """

    t: Array
    small: Array
    standard: Array
    linear: Array
    standard_angle: float
    tolerance: float
    figures: tuple[Figure, ...]


def step_steer(fmu: OpenFmu, P: VehicleParameters) -> StepSteer:
    """Steps the steering angle at constant speed, by a small angle and to the standard's lateral acceleration.

    Args:
        fmu: the vehicle.
        P: the parameters for the expected values.
    """
    C = running_stiffness(P)
    standard_angle = STANDARD_ACCELERATION / (SPEED * yaw_rate_gain(P, C, SPEED))
    small, standard = _step(fmu, SMALL_ANGLE), _step(fmu, standard_angle)
    linear = step_response(*two_track(P, C, SPEED), small.t)[:, 1]
    found, expected = (response(small.t, values) for values in (small["gamma"] / SMALL_ANGLE, linear))
    tolerance = linear_tolerance(P)
    model = "linear two-track model with roll"
    figures = (
        near(
            "Yaw-rate gain at 20 m/s",
            found.steady,
            yaw_rate_gain(P, table_stiffness(P), SPEED),
            relative=0.02,
            unit="1/s",
            source="v/(L + K_us v²), stiffnesses at static load",
        ),
        near("Response time to 90 %", found.rise_time, expected.rise_time, relative=tolerance, unit="s", source=model),
        near("Peak response time", found.peak_time, expected.peak_time, relative=tolerance, unit="s", source=model),
        near("Overshoot", found.overshoot, expected.overshoot, absolute=tolerance, source=model),
        at_most(
            "Largest deviation of the curves over the steady yaw rate",
            float(np.abs(small["gamma"] / SMALL_ANGLE - linear).max()) / expected.steady,
            tolerance,
            source=model,
        ),
    )
    return StepSteer(
        small.t,
        small["gamma"] / SMALL_ANGLE,
        standard["gamma"] / standard_angle,
        linear,
        standard_angle,
        tolerance,
        figures,
    )


def linear_tolerance(P: VehicleParameters) -> float:
    """Bound of the tyres' nonlinearity in the small step, doubled for the two axles.

    A brush tyre's force is C alpha (1 - r/3 + r^2/27), r = C alpha/(mu F_z): it is below the linear force by at most
    r/3, with alpha at most the steering angle; a relative change in stiffness changes the response by at most as much.
    """
    return 2 * P.C_f * SMALL_ANGLE / (P.mu_a * P.F_zf) / 3


def _step(fmu: OpenFmu, angle: float) -> Trace:
    with Car(fmu, {"v_x_start": SPEED}) as car:
        hold = SpeedHold(SPEED)
        car.record(_SETTLE_S, 0.01, (), hold)
        car.set(steering_angle=angle)
        return car.record(_SECONDS, _H, ("gamma",), hold)


def response(t: Array, values: Array) -> Response:
    """The characteristics of a step response.

    Args:
        t: times from the step (rows,) [s].
        values: the response (rows,), steady at the end.
    """
    steady = float(values[-1])
    first = int(np.argmax(values >= 0.9 * steady))
    share = (0.9 * steady - values[first - 1]) / (values[first] - values[first - 1])
    top = min(max(int(np.argmax(values)), 1), len(values) - 2)
    # The vertex of the parabola through the largest sample and its neighbours.
    left, middle, right = values[top - 1 : top + 2]
    curvature = left - 2 * middle + right
    offset = (left - right) / (2 * curvature) if curvature < 0 else 0.0
    peak = middle - (left - right) * offset / 4
    h = t[1] - t[0]
    return Response(steady, float(t[first - 1] + share * h), float(t[top] + offset * h), float(peak / steady - 1))
