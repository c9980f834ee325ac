"""Straight braking with locked wheels and acceleration with spinning ones, determined by friction alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from platoon_fmu.importer import OpenFmu
from platoon_fmu.parameters import VehicleParameters
from platoon_fmu.physics.drive import Array, Car, Trace, of_wheels
from platoon_fmu.physics.figure import Figure, at_most, between, near
from platoon_fmu.physics.reference import sliding_distance

START_SPEED = 30.0
"""Initial speed of braking [m/s]."""
SLIPPERY = 0.1
"""Friction coefficient of the slippery road; the other road has the nominal one."""

_H = 0.002
_SPIN_S = 3.0
_SETTLED_S = 0.6
_FROM, _TO = 25.0, 2.0
_NAMES = ("v_x", "a_x", "X", "Y", *of_wheels("omega"), *of_wheels("kappa"))


@dataclass(frozen=True)
class Slide:
    """A straight run with sliding tyres, (rows,).

    Attributes:
        mu: friction coefficient.
        t: time [s].
        X: position [m].
        Y: lateral offset [m].
        v_x: speed [m/s].
        rim_speeds: R_w omega (4, rows) [m/s].
        kappa: smallest slip ratio of the four wheels, by magnitude [1].
        ground_a: acceleration by tyre forces, air drag excluded [m/s^2].
        expected_a: acceleration by friction and rolling resistance [m/s^2].
        steady: rows in which all tyres slide and the speed is not near zero.
    """

    mu: float
    t: Array
    X: Array
    Y: Array
    v_x: Array
    rim_speeds: Array
    kappa: Array
    ground_a: Array
    expected_a: float
    steady: np.ndarray

    @property
    def mean_a(self) -> float:
        """Mean of ground_a over the steady rows [m/s^2]."""
        return float(self.ground_a[self.steady].mean())


@dataclass(frozen=True)
class FrictionLimit:
    """The runs on the nominal and the slippery road, wheels locked and spinning, and the metrics."""

    locked: tuple[Slide, Slide]
    spinning: tuple[Slide, Slide]
    figures: tuple[Figure, ...]


def friction_limit(fmu: OpenFmu, P: VehicleParameters) -> FrictionLimit:
    """Brakes from `START_SPEED` with locked wheels, and spins up all wheels from rest.

    Args:
        fmu: the vehicle.
        P: the parameters for the expected values.
    """
    locked = _lock(fmu, P, P.mu_a), _lock(fmu, P, SLIPPERY)
    spinning = _spin(fmu, P, P.mu_a), _spin(fmu, P, SLIPPERY)
    slides = (*locked, *spinning)
    braking, driving = "friction and rolling resistance, (μ + μ_d) g", "friction less rolling resistance, (μ − μ_d) g"
    figures = (
        *(_acceleration(f"Deceleration, wheels locked, μ = {s.mu:g}", s, braking) for s in locked),
        *(_acceleration(f"Acceleration, wheels spinning, μ = {s.mu:g}", s, driving) for s in spinning),
        near(
            f"Sliding distance from {_FROM:g} to {_TO:g} m/s, μ = {P.mu_a:g}",
            _place(locked[0], _TO) - _place(locked[0], _FROM),
            sliding_distance(P, P.mu_a, _FROM, _TO),
            relative=1e-3,
            unit="m",
            source="closed form M v dv/dx = −((μ + μ_d) M g + C_a v²)",
        ),
        at_most(
            "Rim speed of the locked wheels",
            max(float(np.abs(s.rim_speeds[:, s.steady]).max()) for s in locked),
            0.01,
            unit="m/s",
            source="the test's brake holds them",
        ),
        between(
            "Least slip ratio of the spinning wheels",
            min(float(s.kappa[s.steady].min()) for s in spinning),
            1.0,
            float("inf"),
            source="spinning: at least twice the rolling speed",
        ),
        at_most(
            "Greatest lateral offset",
            max(float(np.abs(s.Y).max()) for s in slides),
            1e-9,
            unit="m",
            source="there is no lateral force",
        ),
    )
    return FrictionLimit(locked, spinning, figures)


def _acceleration(name: str, slide: Slide, source: str) -> Figure:
    return near(name, abs(slide.mean_a), abs(slide.expected_a), relative=1e-3, unit="m/s²", source=source)


def _place(slide: Slide, speed: float) -> float:
    """Position at which a braking car falls below a speed [m]."""
    return float(np.interp(-speed, -slide.v_x, slide.X))


def _lock(fmu: OpenFmu, P: VehicleParameters, mu: float) -> Slide:
    """Brakes until the wheels lock, holds them, and slides until nearly at rest."""

    def brake(car: Car, h: float) -> None:
        # The road's torque on the wheel, plus enough to halve its spin in this step.
        road, spin = P.R_w * car.get(*of_wheels("F_x")), car.get(*of_wheels("omega"))
        car.torque(*(road - 0.5 * P.I_w / h * spin))

    expected = -(mu + P.mu_d) * P.g
    with Car(fmu, {"v_x_start": START_SPEED, "mu": mu}) as car:
        return _slide(car.record(START_SPEED / -expected, _H, _NAMES, brake), P, mu, expected)


def _spin(fmu: OpenFmu, P: VehicleParameters, mu: float) -> Slide:
    """Drives all wheels from rest with twice the torque that friction transmits at static load."""
    with Car(fmu, {"mu": mu}) as car:
        car.torque(2.0 * mu * P.M * P.g / 4 * P.R_w)
        return _slide(car.record(_SPIN_S, _H, _NAMES), P, mu, (mu - P.mu_d) * P.g)


def _slide(trace: Trace, P: VehicleParameters, mu: float, expected_a: float) -> Slide:
    v_x = trace["v_x"]
    return Slide(
        mu=mu,
        t=trace.t,
        X=trace["X"],
        Y=trace["Y"],
        v_x=v_x,
        rim_speeds=P.R_w * trace.wheels("omega"),
        kappa=np.abs(trace.wheels("kappa")).min(axis=0),
        ground_a=trace["a_x"] + P.C_a * v_x * np.abs(v_x) / P.M,
        expected_a=expected_a,
        # Excludes low speeds, where regularisation removes most of the slip.
        steady=(trace.t > _SETTLED_S) & (np.abs(v_x) > (_TO if expected_a < 0 else 0.0)),
    )
