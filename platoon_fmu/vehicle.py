"""The vehicle: longitudinal, lateral, yaw, roll and four wheel spins (8 degrees of freedom) and its pose.

ISO 8855 axes: x forward, y left, z up; steering, yaw and roll are positive right-handed about z and x. Wheels in the
paper's order: front left, rear left, rear right, front right. No equation is implicit: every quantity follows from the
states, the inputs and the parameters; the load-transfer states break the algebraic loop between tyre forces and loads.
The equations are written once, for CasADi's symbols; `codegen.py` generates the C code.

A tyre that loses pressure (`inflation_*` below 1) loses slip stiffness and vertical stiffness, rolls on a smaller
radius and resists rolling. While all tyres are sound, each of these terms is exactly 0 and each factor exactly 1.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import casadi as ca

from platoon_fmu import tyre
from platoon_fmu.parameters import VehicleParameters
from platoon_fmu.wheels import WHEELS, Wheel

SX = Any


@dataclass(frozen=True)
class WheelForces:
    """One wheel's forces and slips in wheel axes [N, 1], and its forces on the body in vehicle axes [N].

    R is the rolling radius [m], and `flat_moment` the rolling resistance that a soft tyre adds, on the spin [N m].
    """

    F_x: SX
    F_y: SX
    F_z: SX
    kappa: SX
    tan_alpha: SX
    R: SX
    flat_moment: SX
    body_x: SX
    body_y: SX
    body_yaw: SX


def _smooth_sign(z: SX) -> SX:
    """The sign of z for |z| >= 1, with a once differentiable transition between."""
    z = ca.fmin(ca.fmax(z, -1), 1)
    return z * (3 - z**2) / 2


def _roll_height(P: VehicleParameters) -> SX:
    """Roll arm [m] of the whole vehicle's centre of mass: m_s h_s / M."""
    return P.m_s * P.h_s / P.M


def _roll_share(front: bool, P: VehicleParameters) -> SX:
    """An axle's share of roll stiffness and roll damping."""
    return P.roll_share_f if front else 1 - P.roll_share_f


def _static_load(front: bool, P: VehicleParameters) -> SX:
    """Static load [N] of a tyre of an axle."""
    return P.F_zf if front else P.F_zr


def _moment_lost(front: bool, x: Mapping[str, SX], u: Mapping[str, SX], P: VehicleParameters) -> SX:
    """Roll moment [N m] that soft tyres take from an axle's spring moment K phi; 0 on sound ones.

    The extra compliances c of its tyres are springs in series with the axle's roll stiffness K, which includes sound
    tyres. So K falls to K/(1 + K (c_left + c_right)/l_t^2), and the axle is tilted at rest, because the static load
    deflects one tyre more than the other. The body rests on both axles, so the tilt of one moves load from the soft
    tyre and the one diagonally across to the other two. Deflections due to load transfer by braking, roll centres and
    dampers are neglected, so that the springs return no more energy than they store.
    """
    left, right = (
        tyre.extra_compliance(u[f"inflation_{w.name}"], P.K_z, P.flat_vertical) for w in WHEELS if w.front is front
    )
    K = _roll_share(front, P) * P.K_phi
    softened = 1 / (1 + K * (left + right) / P.l_t**2)
    tilt = _static_load(front, P) * (right - left) / P.l_t
    return K * (x["phi"] - softened * (x["phi"] - tilt))


def _load(wheel: Wheel, x: Mapping[str, SX], u: Mapping[str, SX], P: VehicleParameters) -> SX:
    """Load F_z [N] of a wheel: static, plus transfer states and roll; never negative."""
    share = _roll_share(wheel.front, P)
    lever = (P.l_r if wheel.front else P.l_f) / P.L
    static = _static_load(wheel.front, P)
    springs = share * (P.K_phi * x["phi"] + P.C_phi * x["p"]) - _moment_lost(wheel.front, x, u, P)
    through_springs = springs / P.l_t
    to_right = through_springs + lever * x["load_transfer_y"]
    to_rear = x["load_transfer_x"] / 2
    return ca.fmax(static - wheel.side * to_right + (-to_rear if wheel.front else to_rear), 0)


def _wheel(wheel: Wheel, x: Mapping[str, SX], u: Mapping[str, SX], P: VehicleParameters) -> WheelForces:
    """Forces of one wheel from its own slips and load."""
    x_i = P.l_f if wheel.front else -P.l_r
    y_i = wheel.side * P.l_t / 2
    delta = u["steering_angle"] if wheel.front else 0
    c, s = (ca.cos(delta), ca.sin(delta)) if wheel.front else (1, 0)

    # The contact point is below the centre of mass, so roll moves it sideways.
    v_xi = x["v_x"] - x["gamma"] * y_i
    v_yi = x["v_y"] + x["gamma"] * x_i + _roll_height(P) * x["p"]
    v_long, v_lat = c * v_xi + s * v_yi, -s * v_xi + c * v_yi

    inflation = u[f"inflation_{wheel.name}"]
    F_z = _load(wheel, x, u, P)
    R = P.R_w * tyre.remaining(P.flat_radius, inflation)
    rolling_speed = R * x[f"omega_{wheel.name}"]
    kappa, tan_alpha = tyre.slips(v_long, v_lat, rolling_speed, P.v_slip)
    lambda_axle = u["lambda_f"] if wheel.front else u["lambda_r"]
    F_x, F_y = tyre.forces(
        kappa,
        tan_alpha,
        C_x=P.C_x * tyre.remaining(P.flat_longitudinal, inflation),
        C_y=(P.C_f if wheel.front else P.C_r)
        * (1 + P.cornering_variation * lambda_axle)
        * tyre.remaining(P.flat_cornering, inflation),
        F_z=F_z,
        F_z0=_static_load(wheel.front, P),
        mu=u["mu"],
        load_peak=P.load_peak,
    )
    body_x, body_y = c * F_x - s * F_y, s * F_x + c * F_y
    body_yaw = x_i * body_y - y_i * body_x
    flat_moment = P.flat_rolling * (1 - inflation) * F_z * R * _smooth_sign(rolling_speed / P.v_roll)
    return WheelForces(F_x, F_y, F_z, kappa, tan_alpha, R, flat_moment, body_x, body_y, body_yaw)


def equations(x: Mapping[str, SX], u: Mapping[str, SX], P: VehicleParameters) -> tuple[dict[str, SX], dict[str, SX]]:
    """The model: derivatives of the states, and the outputs that are not states.

    Args:
        x: states by name (`interface.STATES`).
        u: inputs by name (`interface.INPUTS`).
        P: parameters; its fields may be symbols.

    Returns:
        (time derivatives by state name, outputs by name).
    """
    wheels = {wheel.name: _wheel(wheel, x, u, P) for wheel in WHEELS}
    tyres_x = sum(w.body_x for w in wheels.values())
    tyres_y = sum(w.body_y for w in wheels.values())
    tyres_yaw = sum(w.body_yaw for w in wheels.values())

    v_x, v_y, gamma, psi = x["v_x"], x["v_y"], x["gamma"], x["psi"]
    # Rolling resistance acts on the body, not on the spins, so that T = R_w F_x in steady rolling; and on the body as a
    # whole, as in the paper, so that it does not affect the cornering of a car whose load has moved to one side. A soft
    # tyre's extra resistance is a moment on its own wheel: it drags at that corner, and is zero on a locked wheel.
    ground_x = tyres_x - P.mu_d * P.M * P.g * _smooth_sign(v_x / P.v_roll)
    a_x = (ground_x - P.C_a * v_x * ca.fabs(v_x) + u["force_x"]) / P.M
    a_y = (tyres_y + u["force_y"]) / P.M

    # Roll about the vehicle's centre of mass: forces there do no work on roll, tyre forces act h_roll below.
    h_roll = _roll_height(P)
    I_roll = P.I_x + P.m_s * P.h_s**2 * (1 - P.m_s / P.M)
    springs = P.K_phi * x["phi"] - (_moment_lost(True, x, u, P) + _moment_lost(False, x, u, P))
    roll_moment = h_roll * tyres_y + P.m_s * P.g * P.h_s * x["phi"] - springs - P.C_phi * x["p"]

    # The remaining part of the lateral moment h tyres_y acts through the roll centres, not the springs.
    transfer_x = P.h * ground_x / P.L
    transfer_y = (P.h - h_roll) * tyres_y / P.l_t

    derivatives = {
        "X": v_x * ca.cos(psi) - v_y * ca.sin(psi),
        "Y": v_x * ca.sin(psi) + v_y * ca.cos(psi),
        "psi": gamma,
        "phi": x["p"],
        "v_x": a_x + v_y * gamma,
        "v_y": a_y - v_x * gamma,
        "gamma": (tyres_yaw + u["moment_z"]) / P.I_z,
        "p": roll_moment / I_roll,
        **{f"omega_{n}": (u[f"wheel_torque_{n}"] - w.R * w.F_x - w.flat_moment) / P.I_w for n, w in wheels.items()},
        "load_transfer_x": (transfer_x - x["load_transfer_x"]) / P.tau_z,
        "load_transfer_y": (transfer_y - x["load_transfer_y"]) / P.tau_z,
    }
    outputs = {
        "a_x": a_x,
        "a_y": a_y,
        "beta": ca.atan(v_y / tyre.regularised_speed(v_x, P.v_slip)),
        **{f"F_x_{n}": w.F_x for n, w in wheels.items()},
        **{f"F_y_{n}": w.F_y for n, w in wheels.items()},
        **{f"F_z_{n}": w.F_z for n, w in wheels.items()},
        **{f"alpha_{n}": ca.atan(w.tan_alpha) for n, w in wheels.items()},
        **{f"kappa_{n}": w.kappa for n, w in wheels.items()},
    }
    return derivatives, outputs


def initial_state(start: Mapping[str, SX], P: VehicleParameters) -> dict[str, SX]:
    """The initial states: the given pose and motion, sound wheels rolling freely, body level, static loads.

    Args:
        start: start parameters by name (`interface.STARTS`).
        P: parameters; its fields may be symbols.
    """
    rolling = {
        f"omega_{wheel.name}": (start["v_x_start"] - start["gamma_start"] * wheel.side * P.l_t / 2) / P.R_w
        for wheel in WHEELS
    }
    given = {name: start[f"{name}_start"] for name in ("X", "Y", "psi", "v_x", "v_y", "gamma")}
    level = {name: ca.SX(0) for name in ("phi", "p", "load_transfer_x", "load_transfer_y")}
    return {**given, **rolling, **level}


def fastest_rate(P: VehicleParameters) -> SX:
    """Approximate upper bound of the decay rates [1/s]: of a wheel's spin or of side-slip, both at rest.

    With sensible parameters nothing is faster: at rest the slips' reference speed is v_slip/2. A flat wheel's spin has
    less slip stiffness, but its rolling resistance changes sign within v_roll.
    """
    spin = P.R_w**2 * P.C_x / P.I_w
    side_slip = 2 * (P.C_f + P.C_r) * (1 + P.cornering_variation) / P.M
    flat_moment = P.R_w**2 * P.flat_rolling * ca.fmax(P.F_zf, P.F_zr) / P.I_w * 3 / (2 * P.v_roll)
    flat_spin = spin * P.flat_longitudinal * 2 / P.v_slip + flat_moment
    return ca.fmax(ca.fmax(spin, side_slip) * 2 / P.v_slip, flat_spin)
