"""The energy balance of violent manoeuvres: no energy is created, and every joule is accounted for.

The energy is E = M (v_x^2 + v_y^2)/2 + I_z gamma^2/2 + I_roll p^2/2 + I_w sum(omega^2)/2 + (K_phi - m_s g h_s) phi^2/2:
of translation, yaw, roll (about the vehicle's centre of mass, I_roll = I_x + m_s h_s^2 (1 - m_s/M)) and spins, of the
roll springs, less the potential energy that the leaning body loses. The load transfers are states, but store no energy:
they only distribute the weight among the wheels, and loads do no work on flat ground. On soft tyres of constant
pressure an axle's springs store K_axle (phi - tilt)^2/2 instead of their share of K_phi phi^2/2. Multiplying each
equation of motion by its velocity and adding them gives

    dE/dt = sum(T omega) + F_x,ext v_x + F_y,ext v_y + M_z,ext gamma - D,
    D = sum(F_x (R omega - v_long) - F_y v_lat + M_flat |omega|) + C_a |v_x|^3 + F_roll |v_x| + C_phi p^2 >= 0,

with the tyres' forces and the velocities of their contact points in wheel axes, the rolling radius R (R_w for a sound
tyre) and the rolling resistance moment M_flat of a soft tyre. Steering does no work: it turns the wheels about their
contact points, where the tyre has no aligning moment.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from platoon_fmu.importer import OpenFmu
from platoon_fmu.parameters import VehicleParameters
from platoon_fmu.physics.drive import STATES, Array, Car, of_wheels
from platoon_fmu.physics.figure import Figure, at_most, between
from platoon_fmu.wheels import WHEEL_NAMES

_H, _SECONDS = 0.001, 5.0
_NAMES = (
    *STATES,
    *of_wheels("F_x"),
    *of_wheels("F_y"),
    *of_wheels("F_z"),
    *of_wheels("inflation"),
    *of_wheels("wheel_torque"),
    *("force_x", "force_y", "moment_z", "steering_angle"),
)

Inputs = Callable[[float], Mapping[str, float]]
Torques = Callable[[float, Array], Array]


def _coasting(_: float, omega: Array) -> Array:
    return 0.0 * omega


@dataclass(frozen=True)
class Violence:
    """A violent manoeuvre.

    Attributes:
        name: for display.
        start: start values by name.
        inputs: inputs by name at a time [s].
        torques: wheel torques (4,) [N m] at a time [s] and the wheels' spins (4,) [rad/s].
    """

    name: str
    start: Mapping[str, float]
    inputs: Inputs
    torques: Torques = _coasting


def _always(**inputs: float) -> Inputs:
    return lambda _: inputs


def _swaying(t: float) -> Mapping[str, float]:
    return {
        "steering_angle": 0.15 * np.sin(4.0 * t),
        "lambda_f": np.sin(7.0 * t),
        "lambda_r": np.cos(5.0 * t),
        "mu": 0.6 + 0.4 * np.sin(3.0 * t),
    }


def _full_drive_then_brake(t: float, omega: Array) -> Array:
    return np.full(4, 1000.0) if t < 2.0 else np.clip(-60.0 * omega, -2000.0, 2000.0)


MANOEUVRES = (
    Violence(
        "Full drive, then full brake in a bend",
        {"v_x_start": 15.0},
        _always(steering_angle=0.06),
        _full_drive_then_brake,
    ),
    Violence(
        "Spin from 30 m/s", {"v_x_start": 30.0, "v_y_start": 5.0, "gamma_start": 2.0}, _always(steering_angle=-0.1)
    ),
    Violence("Backwards spin", {"v_x_start": -8.0, "v_y_start": 3.0, "gamma_start": 1.0}, _always(steering_angle=0.2)),
    Violence("Pirouette at walking speed", {"v_x_start": 3.0, "v_y_start": 6.0, "gamma_start": 4.0}, _always()),
    Violence("Slalom on changing friction and stiffness", {"v_x_start": 30.0}, _swaying),
    Violence(
        "Wheels spun up from rest on ice", {}, _always(steering_angle=0.1, mu=0.1), lambda _t, _o: np.full(4, 200.0)
    ),
    Violence(
        "Reverse gear at 15 m/s", {"v_x_start": 15.0}, _always(steering_angle=0.05), lambda _t, _o: np.full(4, -900.0)
    ),
    Violence(
        "Slalom on two flat tyres and one at half pressure",
        {"v_x_start": 30.0, "inflation_fl": 0.0, "inflation_rr": 0.0, "inflation_rl": 0.5},
        lambda t: {"steering_angle": 0.1 * np.sin(3.0 * t)},
        lambda t, omega: np.clip(-20.0 * omega, -1000.0, 1000.0) * np.array([t > 3.0, t > 2.0, t > 4.0, t > 3.5]),
    ),
    Violence("Body settling over two soft tyres at standstill", {"inflation_fl": 0.0, "inflation_rl": 0.5}, _always()),
    Violence(
        "Gale from all sides",
        {"v_x_start": 25.0},
        lambda t: {"force_x": -3000.0, "force_y": 6000.0 * np.sin(6.0 * t), "moment_z": 5000.0 * np.cos(5.0 * t)},
    ),
)
"""What is driven."""


@dataclass(frozen=True)
class Ledger:
    """The energy balance of one manoeuvre, (rows,) [J].

    Attributes:
        name: of the manoeuvre.
        t: time [s].
        energy: kinetic and roll energy.
        by_torques: work of the wheel torques since the start.
        by_forces: work of the external forces and moment since the start.
        dissipated: work done on the car less the rise in energy, which must have been dissipated.
        accounted: losses in tyres, air, rolling resistance and roll dampers, from their forces and velocities.
    """

    name: str
    t: Array
    energy: Array
    by_torques: Array
    by_forces: Array
    dissipated: Array
    accounted: Array

    @property
    def throughput(self) -> float:
        """The largest energy stored or dissipated, to which errors are relative [J]."""
        return float(max(self.energy.max(), self.accounted[-1]))

    @property
    def least_loss(self) -> float:
        """Smallest dissipation in any step, over the throughput; negative if energy was created."""
        return float(np.diff(self.dissipated).min()) / self.throughput

    @property
    def residual(self) -> float:
        """Largest difference between dissipated and accounted energy, over the throughput."""
        return float(np.abs(self.dissipated - self.accounted).max()) / self.throughput


@dataclass(frozen=True)
class EnergyBalance:
    """The energy balances of all manoeuvres, and the metrics."""

    ledgers: tuple[Ledger, ...]
    figures: tuple[Figure, ...]


def energy_balance(fmu: OpenFmu, P: VehicleParameters) -> EnergyBalance:
    """Drives `MANOEUVRES` and computes their energy balances.

    Args:
        fmu: the vehicle.
        P: the parameters that energy and losses are computed with.
    """
    ledgers = tuple(ledger(fmu, P, manoeuvre) for manoeuvre in MANOEUVRES)
    figures = (
        between(
            "Least energy lost in any step of 1 ms over the throughput",
            min(each.least_loss for each in ledgers),
            -1e-12,
            float("inf"),
            source="no energy is created: work less ΔE never falls, except by rounding",
        ),
        at_most(
            "Energy not accounted for over the throughput",
            max(each.residual for each in ledgers),
            1e-5,
            source="work less ΔE is the loss in tyres, air, rolling resistance and roll dampers",
        ),
    )
    return EnergyBalance(ledgers, figures)


def ledger(fmu: OpenFmu, P: VehicleParameters, manoeuvre: Violence) -> Ledger:
    """Drives one manoeuvre and computes its energy balance.

    Args:
        fmu: the vehicle.
        P: the parameters that energy and losses are computed with.
        manoeuvre: what is driven.
    """
    begins, ends = [], []
    with Car(fmu, manoeuvre.start) as car:
        for step in range(round(_SECONDS / _H)):
            car.set(manoeuvre.inputs(step * _H))
            car.torque(*manoeuvre.torques(step * _H, car.get(*of_wheels("omega"))))
            # Inputs jump between steps, so each step has separate values at its start and its end.
            begins.append(car.get(*_NAMES))
            car.step(_H)
            ends.append(car.get(*_NAMES))
    begin, end = (dict(zip(_NAMES, np.array(rows).T, strict=True)) for rows in (begins, ends))
    energy = np.append(_energy(begin, P), _energy(end, P)[-1])
    by_torques, by_forces, accounted = (
        _integral(power(begin, P), power(end, P)) for power in (_torque_power, _external_power, _losses)
    )
    dissipated = by_torques + by_forces - (energy - energy[0])
    return Ledger(
        manoeuvre.name, np.linspace(0.0, _SECONDS, len(energy)), energy, by_torques, by_forces, dissipated, accounted
    )


Values = Mapping[str, Array]


def _wheels(values: Values, quantity: str) -> Array:
    return np.array([values[name] for name in of_wheels(quantity)])


def _integral(begin: Array, end: Array) -> Array:
    """The running integral (steps + 1,) of a power given at the start and end of each step."""
    return np.concatenate([[0.0], np.cumsum((begin + end) * _H / 2)])


def _energy(values: Values, P: VehicleParameters) -> Array:
    I_roll = P.I_x + P.m_s * P.h_s**2 * (1 - P.m_s / P.M)
    twice: Array = (
        P.M * (values["v_x"] ** 2 + values["v_y"] ** 2)
        + P.I_z * values["gamma"] ** 2
        + P.I_w * (_wheels(values, "omega") ** 2).sum(axis=0)
        + I_roll * values["p"] ** 2
        - P.m_s * P.g * P.h_s * values["phi"] ** 2
    )
    for axle in ("f", "r"):
        stiffness, tilt = _axle_springs(values, P, axle)
        twice = twice + stiffness * (values["phi"] - tilt) ** 2
    return twice / 2


def _axle_springs(values: Values, P: VehicleParameters, axle: str) -> tuple[Array, Array]:
    """Roll stiffness [N m/rad] of an axle on its tyres, and the roll angle [rad] of zero moment.

    A tyre of stiffness k is compressed more than a sound one of stiffness K_z, by the static load times 1/k - 1/K_z.
    """
    share, load = (P.roll_share_f, P.F_zf) if axle == "f" else (1 - P.roll_share_f, P.F_zr)
    left, right = (
        1 / (P.K_z * (values[f"inflation_{axle}{side}"] * (1 - P.flat_vertical) + P.flat_vertical)) - 1 / P.K_z
        for side in ("l", "r")
    )
    by_suspension, by_tyres = 1 / (share * P.K_phi), (left + right) / P.l_t**2
    return 1 / (by_suspension + by_tyres), load * (right - left) / P.l_t


def _torque_power(values: Values, _: VehicleParameters) -> Array:
    power: Array = (_wheels(values, "wheel_torque") * _wheels(values, "omega")).sum(axis=0)
    return power


def _external_power(values: Values, _: VehicleParameters) -> Array:
    of_forces: Array = values["force_x"] * values["v_x"] + values["force_y"] * values["v_y"]
    of_moment: Array = values["moment_z"] * values["gamma"]
    return of_forces + of_moment


def _losses(values: Values, P: VehicleParameters) -> Array:
    """Dissipated power [W]."""
    v_x = np.abs(values["v_x"])
    fading = np.minimum(v_x / P.v_roll, 1.0)
    rolling = P.mu_d * P.M * P.g * fading * (3 - fading**2) / 2
    lost: Array = P.C_a * v_x**3 + rolling * v_x + P.C_phi * values["p"] ** 2
    F_x, F_y, F_z, omega = (_wheels(values, quantity) for quantity in ("F_x", "F_y", "F_z", "omega"))
    soft = 1 - _wheels(values, "inflation")
    rim_speed = P.R_w * (1 - soft * (1 - P.flat_radius)) * omega
    for i, wheel in enumerate(WHEEL_NAMES):
        v_long, v_lat = _contact_velocity(values, P, wheel)
        turning = np.minimum(np.abs(rim_speed[i]) / P.v_roll, 1.0)
        rolling = P.flat_rolling * soft[i] * F_z[i] * turning * (3 - turning**2) / 2
        lost = lost + F_x[i] * (rim_speed[i] - v_long) - F_y[i] * v_lat + rolling * np.abs(rim_speed[i])
    return lost


def _contact_velocity(values: Values, P: VehicleParameters, wheel: str) -> tuple[Array, Array]:
    """Velocity of a wheel's contact point along and across the wheel [m/s]."""
    front, left = wheel.startswith("f"), wheel.endswith("l")
    x_i, y_i = (P.l_f if front else -P.l_r), (P.l_t if left else -P.l_t) / 2
    along = values["v_x"] - values["gamma"] * y_i
    across = values["v_y"] + values["gamma"] * x_i + P.m_s * P.h_s / P.M * values["p"]
    delta = values["steering_angle"] if front else np.zeros_like(along)
    return np.cos(delta) * along + np.sin(delta) * across, np.cos(delta) * across - np.sin(delta) * along
