"""Coast-down against drag and rolling resistance, including the wheels' inertia."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from platoon_fmu.importer import OpenFmu
from platoon_fmu.parameters import VehicleParameters
from platoon_fmu.physics.drive import Array, Car
from platoon_fmu.physics.figure import Figure, at_most, near
from platoon_fmu.physics.reference import coast_down_speed, coast_down_time, effective_mass

START_SPEED, END_SPEED = 40.0, 10.0
"""Speeds between which the time is measured [m/s]."""
_H = 0.1


@dataclass(frozen=True)
class CoastDown:
    """Speed over time, (rows,), and the metrics.

    Attributes:
        t: time [s].
        v_x: speed of the FMU [m/s].
        expected: speed of the closed form [m/s].
        figures: the metrics.
    """

    t: Array
    v_x: Array
    expected: Array
    figures: tuple[Figure, ...]


def coast_down(fmu: OpenFmu, P: VehicleParameters) -> CoastDown:
    """Coasts from `START_SPEED` to below `END_SPEED`.

    Args:
        fmu: the vehicle.
        P: the parameters for the expected values.
    """
    expected_time = coast_down_time(P, START_SPEED, END_SPEED)
    with Car(fmu, {"v_x_start": START_SPEED}) as car:
        trace = car.record(1.05 * expected_time, _H, ("v_x",))
    v_x = trace["v_x"]
    expected = coast_down_speed(P, START_SPEED, trace.t)
    tolerance = slip_tolerance(P)
    source = "closed form of m dv/dt = −(μ_d M g + C_a v²), m = M + 4 I_w/R_w²"
    figures = (
        near(
            f"Time from {START_SPEED:g} to {END_SPEED:g} m/s",
            float(np.interp(-END_SPEED, -v_x, trace.t)),
            expected_time,
            relative=tolerance,
            unit="s",
            source=source,
        ),
        at_most(
            "Greatest deviation of the speed",
            float(np.abs(v_x - expected).max()),
            tolerance * START_SPEED,
            unit="m/s",
            source=source,
        ),
    )
    return CoastDown(trace.t, v_x, expected, figures)


def slip_tolerance(P: VehicleParameters) -> float:
    """The allowed relative deviation from the closed form, which neglects the tyres' slip.

    A tyre that slows its wheel's spin slips by kappa = I_w a/(R_w^2 C_x), so the wheels have 2 kappa more energy than
    rolling ones, whose share of the car's energy is (4 I_w/R_w^2)/m.
    """
    a = (P.mu_d * P.M * P.g + P.C_a * START_SPEED**2) / effective_mass(P)
    kappa = P.I_w * a / (P.R_w**2 * P.C_x)
    return 2 * kappa * (1 - P.M / effective_mass(P))
