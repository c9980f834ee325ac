"""Standstill, pulling away and stopping: no drift at rest, no creep after a stop."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from platoon_fmu.importer import OpenFmu
from platoon_fmu.parameters import VehicleParameters
from platoon_fmu.physics.drive import STATES, Array, Car, of_wheels
from platoon_fmu.physics.figure import Figure, at_most, near
from platoon_fmu.physics.reference import pull_away_speed

REST_S, PULL_S, STOP_S = 60.0, 5.0, 30.0
"""Durations of standing, pulling away, and stopping and standing again [s]."""
TORQUE = 200.0
"""Torque on each wheel while pulling away [N m]."""
_BRAKE = 60.0
"""The brake's torque over a wheel's spin [N m s], at most `_BRAKE_TORQUE`."""
_BRAKE_TORQUE = 400.0


@dataclass(frozen=True)
class Standstill:
    """Speed from pulling away on, (rows,), and the metrics.

    Attributes:
        t: time [s].
        v_x: speed of the FMU [m/s].
        t_expected: times of the closed form, while pulling away [s].
        v_expected: speed of the closed form [m/s].
        figures: the metrics.
    """

    t: Array
    v_x: Array
    t_expected: Array
    v_expected: Array
    figures: tuple[Figure, ...]


def standstill(fmu: OpenFmu, P: VehicleParameters) -> Standstill:
    """Stands with steered wheels for a minute; then, wheels straight, pulls away, brakes to rest and stands again.

    Args:
        fmu: the vehicle.
        P: the parameters for the expected values.
    """
    with Car(fmu, {"X_start": 3.0, "Y_start": -2.0, "psi_start": 0.4}) as car:
        car.set(steering_angle=0.3)
        rest = car.record(REST_S, 0.01, STATES)
        car.set(steering_angle=0.0)
        car.torque(TORQUE)
        pull = car.record(PULL_S, 0.01, STATES)
        stop = car.record(STOP_S, 0.01, STATES, _brake)
    drift = max(float(np.abs(rest[name] - rest[name][0]).max()) for name in STATES)
    expected = pull_away_speed(P, 4 * TORQUE / P.R_w, pull.t)
    v_x = np.concatenate([pull["v_x"], stop["v_x"][1:]])
    figures = (
        at_most(
            f"Greatest change of any state in {REST_S:g} s of standing, SI units",
            drift,
            1e-9,
            source="a car at rest on level ground stays there",
        ),
        near(
            f"Speed after {PULL_S:g} s with {TORQUE:g} N m on each wheel",
            pull["v_x"][-1],
            expected[-1],
            absolute=fade_tolerance(P),
            unit="m/s",
            source="closed form of m dv/dt = 4 T/R_w − μ_d M g − C_a v²; rolling resistance fades in up to v_roll",
        ),
        at_most(
            f"Speed {STOP_S:g} s after the brake was applied",
            abs(float(v_x[-1])),
            1e-6,
            unit="m/s",
            source="it stops and stays; the brake is a damper, so the speed decays to zero",
        ),
        at_most(
            "Greatest reverse speed while stopping",
            max(0.0, -float(stop["v_x"].min())),
            1e-6,
            unit="m/s",
            source="a brake does not drive backwards",
        ),
    )
    t = np.concatenate([pull.t, pull.t[-1] + stop.t[1:]])
    return Standstill(t, v_x, pull.t, expected, figures)


def fade_tolerance(P: VehicleParameters) -> float:
    """Speed [m/s] gained while rolling resistance fades in: from rest to v_roll 3/8 of it are absent."""
    rolling = P.mu_d * P.M * P.g
    return 3 / 8 * P.v_roll * rolling / (4 * TORQUE / P.R_w - rolling)


def _brake(car: Car, _: float) -> None:
    torques = np.clip(-_BRAKE * car.get(*of_wheels("omega")), -_BRAKE_TORQUE, _BRAKE_TORQUE)
    car.torque(*torques)
