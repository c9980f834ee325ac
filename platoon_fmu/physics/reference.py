"""Reference solutions for the manoeuvres: the linear two-track model and closed forms, from the parameters alone.

None of the FMU's equations are used; the models are derived independently. Symbols as in
`platoon_fmu.parameters`. Linear steady-state values after M. Mitschke, H. Wallentowitz, Dynamik der Kraftfahrzeuge,
5th ed. 2014, part C, and the paper's Table 1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from platoon_fmu.parameters import VehicleParameters

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Stiffness:
    """Slip stiffnesses per tyre: cornering, front and rear [N/rad]; longitudinal, front and rear [N]."""

    C_f: float
    C_r: float
    C_xf: float
    C_xr: float


def table_stiffness(P: VehicleParameters, lambda_f: float = 0.0, lambda_r: float = 0.0) -> Stiffness:
    """The stiffnesses at static load, the cornering ones varied by lambda in [-1, 1]."""
    vary = P.cornering_variation
    return Stiffness(P.C_f * (1 + vary * lambda_f), P.C_r * (1 + vary * lambda_r), P.C_x, P.C_x)


def running_stiffness(P: VehicleParameters, lambda_f: float = 0.0, lambda_r: float = 0.0) -> Stiffness:
    """The stiffnesses at the loads of straight driving at constant speed, pushed at the centre of mass.

    Rolling resistance acts on the ground, so it moves the load h mu_d M g/L from the rear to the front axle; stiffness
    over load is Pacejka's (Tire and Vehicle Dynamics, 3rd ed. 2012, section 4.3) with its peak at load_peak.
    """
    to_front_tyre = P.h * P.mu_d * P.M * P.g / P.L / 2

    def grown(load: float, static: float) -> float:
        n = load / static
        return n * (P.load_peak**2 + 1) / (P.load_peak**2 + n**2)

    front, rear = grown(P.F_zf + to_front_tyre, P.F_zf), grown(P.F_zr - to_front_tyre, P.F_zr)
    at_rest = table_stiffness(P, lambda_f, lambda_r)
    return Stiffness(at_rest.C_f * front, at_rest.C_r * rear, at_rest.C_xf * front, at_rest.C_xr * rear)


def understeer_gradient(P: VehicleParameters, C: Stiffness) -> float:
    """K_us = (M/L)(l_r/(2 C_f) - l_f/(2 C_r)) [s^2/m], so that delta = L/R + K_us a_y."""
    return P.M / P.L * (P.l_r / (2 * C.C_f) - P.l_f / (2 * C.C_r))


def yaw_rate_gain(P: VehicleParameters, C: Stiffness, v: float) -> float:
    """Steady yaw rate over steering angle at speed v [m/s]: v/(L + K_us v^2) [1/s]."""
    return v / (P.L + understeer_gradient(P, C) * v**2)


def critical_speed(P: VehicleParameters, C: Stiffness) -> float:
    """Critical speed of an oversteering car, sqrt(-L/K_us) [m/s]; NaN for an understeering one."""
    K_us = understeer_gradient(P, C)
    return float(np.sqrt(P.L / -K_us)) if K_us < 0 else float("nan")


def roll_gradient(P: VehicleParameters) -> float:
    """Steady roll angle over lateral acceleration: m_s h_s/(K_phi - m_s g h_s) [rad s^2/m]."""
    return P.m_s * P.h_s / (P.K_phi - P.m_s * P.g * P.h_s)


def two_track(P: VehicleParameters, C: Stiffness, v: float) -> tuple[Array, Array]:
    """The linear two-track model with roll and wheel spins at constant speed, dx/dt = A x + B delta.

    x = [v_y, gamma, phi, p, s_fl, s_rl, s_rr, s_fr]: lateral velocity, yaw rate, roll angle and rate, and each wheel's
    rim speed R_w omega less v [m/s]. Every wheel has its own contact point (moved by roll), slip angle and slip ratio;
    loads are constant, because their change times a slip angle is of second order.

    Args:
        P: parameters.
        C: stiffnesses per tyre.
        v: speed [m/s].

    Returns:
        A (8, 8) and B (8,).
    """
    h_roll = P.m_s * P.h_s / P.M
    I_roll = P.I_x + P.m_s * P.h_s**2 * (1 - P.m_s / P.M)
    A, B = np.zeros((8, 8)), np.zeros(8)
    A[0, 1], A[2, 3] = -v, 1.0
    A[3, 2], A[3, 3] = (P.m_s * P.g * P.h_s - P.K_phi) / I_roll, -P.C_phi / I_roll
    for i, (front, side) in enumerate([(True, 1), (False, 1), (False, -1), (True, -1)], start=4):
        x_i, y_i = (P.l_f if front else -P.l_r), side * P.l_t / 2
        C_y, C_x = (C.C_f, C.C_xf) if front else (C.C_r, C.C_xr)
        # Rows that give a wheel's forces from the state, and the steering's contribution.
        F_y = -C_y / v * np.array([1.0, x_i, 0.0, h_roll, 0, 0, 0, 0])
        F_x = C_x / v * (np.eye(8)[i] + y_i * np.eye(8)[1])
        steered = C_y if front else 0.0
        effect = np.array([1 / P.M, x_i / P.I_z, 0.0, h_roll / I_roll])
        A[:4] += np.outer(effect, F_y)
        B[:4] += effect * steered
        A[1] -= y_i / P.I_z * F_x
        A[i] -= P.R_w**2 / P.I_w * F_x
    return A, B


def step_response(A: Array, B: Array, t: Array) -> Array:
    """States (rows, n) of dx/dt = A x + B after a unit step at t = 0, at evenly spaced times t (rows,) from 0."""
    n = len(B)
    augmented = np.zeros((n + 1, n + 1))
    augmented[:n, :n], augmented[:n, n] = A, B
    over_step = expm(augmented * (t[1] - t[0]))
    x, rows = np.append(np.zeros(n), 1.0), []
    for _ in t:
        rows.append(x[:n])
        x = over_step @ x
    return np.array(rows)


def effective_mass(P: VehicleParameters) -> float:
    """Effective mass including the rolling wheels' inertia: M + 4 I_w/R_w^2 [kg]."""
    return P.M + 4 * P.I_w / P.R_w**2


def coast_down_speed(P: VehicleParameters, v_0: float, t: Array) -> Array:
    """Speed [m/s] of a car that coasts from v_0 against drag and rolling resistance, m dv/dt = -(F_r + C_a v^2)."""
    F_r = P.mu_d * P.M * P.g
    root = np.sqrt(F_r / P.C_a)
    speed: Array = root * np.tan(np.arctan(v_0 / root) - np.sqrt(F_r * P.C_a) / effective_mass(P) * t)
    return speed


def coast_down_time(P: VehicleParameters, v_0: float, v_1: float) -> float:
    """Time [s] in which a coasting car slows from v_0 to v_1 [m/s]."""
    F_r = P.mu_d * P.M * P.g
    root = np.sqrt(F_r / P.C_a)
    return float(effective_mass(P) / np.sqrt(F_r * P.C_a) * (np.arctan(v_0 / root) - np.arctan(v_1 / root)))


def pull_away_speed(P: VehicleParameters, force: float, t: Array) -> Array:
    """Speed [m/s] from rest under a constant drive force [N], against drag and rolling resistance."""
    F = force - P.mu_d * P.M * P.g
    root = np.sqrt(F / P.C_a)
    speed: Array = root * np.tanh(np.sqrt(F * P.C_a) / effective_mass(P) * t)
    return speed


def sliding_distance(P: VehicleParameters, mu: float, v_0: float, v_1: float) -> float:
    """Distance [m] in which a car with locked wheels slides from v_0 down to v_1 [m/s].

    The wheels do not turn, so only M counts: M v dv/dx = -((mu + mu_d) M g + C_a v^2).
    """
    F = (mu + P.mu_d) * P.M * P.g
    return float(P.M / (2 * P.C_a) * np.log((F + P.C_a * v_0**2) / (F + P.C_a * v_1**2)))
