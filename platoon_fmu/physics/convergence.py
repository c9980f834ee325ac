"""Convergence of the Co-Simulation's solvers: the error as a function of the step and of the tolerance.

The manoeuvre is smooth: all slips keep their sign (the brush tyre's force has a term in |slip|), no tyre saturates, no
wheel lifts, and the inputs are constant from the start. The fixed steps are compared after 40 ms, before the wheels'
spins, the car's fastest motion with a time constant of 4 ms, have settled; the adaptive ones after 2 s.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from platoon_fmu.importer import OpenFmu
from platoon_fmu.physics.drive import STATES, Array, Car, of_wheels
from platoon_fmu.physics.figure import Figure, at_most, between
from platoon_fmu.physics.numbers import bound

SHORT_S, LONG_S = 0.04, 2.0
"""Length of the manoeuvre for the fixed-step and for the adaptive solver [s]."""
TOLERANCES = (1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9)
"""Tolerances of the adaptive solver."""
DEFAULT_TOLERANCE = 1e-6
"""The FMU's default tolerance."""

_START = {
    "v_x_start": 20.0,
    "v_y_start": -0.5,
    "steering_angle": 0.03,
    **dict.fromkeys(of_wheels("wheel_torque"), 100.0),
}
# Divisions of the short manoeuvre: where the asymptotic range of the step begins, and where rounding dominates.
_COARSE, _FINE, _REFERENCE = (10, 16, 20, 25), (40, 50, 80, 100, 160, 200, 320), 2560
_RUNGE_KUTTA, _DORMAND_PRINCE = 1.0, 2.0


@dataclass(frozen=True)
class Convergence:
    """Errors: the largest of all states relative to their nominal values, at the end of the manoeuvre.

    Attributes:
        steps: of the fixed-step solver (n,) [s].
        errors: of the fixed-step solver (n,).
        order: slope of log(error) over log(step), steps up to 1 ms.
        tolerances: of the adaptive solver (m,); empty if the FMU has none.
        adaptive_errors: of the adaptive solver (m,).
        figures: the metrics.
    """

    steps: Array
    errors: Array
    order: float
    tolerances: Array
    adaptive_errors: Array
    figures: tuple[Figure, ...]


def convergence(fmu: OpenFmu) -> Convergence:
    """Drives the manoeuvre with several steps and, if the FMU has the adaptive solver, several tolerances.

    Args:
        fmu: the vehicle.
    """
    names = {variable.name for variable in fmu.description.modelVariables}
    settable = "solver_step" in names
    # An FMU without this parameter uses communication steps up to 1 ms as they are.
    divisions = (*_COARSE, *_FINE) if settable else _FINE
    nominals = _nominals(fmu)

    def end_of(division: int) -> Array:
        step = SHORT_S / division
        return _end(fmu, SHORT_S, step, {"solver_step": step} if settable else {})

    reference = end_of(_REFERENCE)
    steps = SHORT_S / np.array(divisions)
    errors = np.array([_error(end_of(division), reference, nominals) for division in divisions])
    fine = slice(-len(_FINE), None)
    order = float(np.polyfit(np.log(steps[fine]), np.log(errors[fine]), 1)[0])
    figures = [
        between(
            "Order of the fixed-step solver",
            order,
            3.5,
            4.5,
            source="the classical Runge-Kutta method is of order 4; slope over steps of 0.125 to 1 ms",
        )
    ]
    tolerances, adaptive = np.empty(0), np.empty(0)
    if {"solver", "solver_tolerance"} <= names:
        tolerances, adaptive = np.array(TOLERANCES), _adaptive_errors(fmu, nominals)
        figures += _adaptive_figures(adaptive)
    return Convergence(steps, errors, order, tolerances, adaptive, tuple(figures))


def _adaptive_errors(fmu: OpenFmu, nominals: Array) -> Array:
    fine = {"solver": _RUNGE_KUTTA, "solver_step": 1e-4}
    reference = _end(fmu, LONG_S, LONG_S, fine)
    return np.array(
        [
            _error(
                _end(fmu, LONG_S, LONG_S, {"solver": _DORMAND_PRINCE, "solver_tolerance": tolerance}),
                reference,
                nominals,
            )
            for tolerance in TOLERANCES
        ]
    )


def _adaptive_figures(errors: Array) -> list[Figure]:
    slope = float(np.polyfit(np.log(TOLERANCES), np.log(errors), 1)[0])
    return [
        at_most(
            f"Error of the adaptive solver at tolerance {bound(DEFAULT_TOLERANCE)}",
            float(errors[TOLERANCES.index(DEFAULT_TOLERANCE)]),
            10 * DEFAULT_TOLERANCE,
            source="the tolerance applies to each step; ten times that for their sum",
        ),
        between(
            "Slope of the adaptive solver's error over its tolerance",
            slope,
            0.7,
            1.3,
            source="error proportional to the tolerance",
        ),
    ]


def _nominals(fmu: OpenFmu) -> Array:
    declared = {variable.name: variable.nominal for variable in fmu.description.modelVariables}
    return np.array([float(declared[name] or 1.0) for name in STATES])


def _end(fmu: OpenFmu, seconds: float, h: float, settings: Mapping[str, float]) -> Array:
    """The states at the end of the manoeuvre."""
    with Car(fmu, {**_START, **settings}) as car:
        for _ in range(round(seconds / h)):
            car.step(h)
        return car.get(*STATES)


def _error(found: Array, reference: Array, nominals: Array) -> float:
    return float(np.abs((found - reference) / nominals).max())
