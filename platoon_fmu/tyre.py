"""The tyre: a brush model with combined slip (Fiala), degressive in load, on the friction circle.

After H. B. Pacejka, Tire and Vehicle Dynamics, 3rd ed. 2012, section 3.2 (brush model) and section 4.3 (load
dependence), with the cornering stiffnesses of the paper's Table 1. The properties of a tyre that loses pressure are
interpolated between a sound and a flat tyre's. Symbolic: arguments and results are CasADi SX.
"""

from __future__ import annotations

from typing import Any

import casadi as ca

SX = Any

# Keeps the derivative of |slip| finite at zero slip; changes the initial slope by a relative 3e-11.
_TINY = 1e-20
# Lower bound of mu, below any real road: avoids a division by zero at mu = 0.
_LEAST_MU = 1e-3


def remaining(flat: SX, inflation: SX) -> SX:
    """Factor on a property of the sound tyre: 1 at nominal pressure, `flat` without pressure, linear between.

    It is exactly 1 at inflation 1, so that the forces of a sound tyre do not depend on `flat`, bit for bit.
    """
    return 1 - (1 - flat) * (1 - inflation)


def extra_compliance(inflation: SX, K_z: SX, flat_vertical: SX) -> SX:
    """A tyre's additional compliance over a sound one's [m/N]; 0 at inflation 1.

    Args:
        inflation: pressure over nominal [1].
        K_z: vertical stiffness of the sound tyre [N/m].
        flat_vertical: the remaining share of it without pressure [1].
    """
    return (1 / remaining(flat_vertical, inflation) - 1) / K_z


def regularised_speed(v: SX, v_slip: SX) -> SX:
    """The slips' reference speed [m/s]: |v| at or above v_slip, (v^2 + v_slip^2)/(2 v_slip) below; never 0."""
    return ca.fabs(v) + (v_slip - ca.fmin(ca.fabs(v), v_slip)) ** 2 / (2 * v_slip)


def slips(v_long: SX, v_lat: SX, rolling_speed: SX, v_slip: SX) -> tuple[SX, SX]:
    """Slip ratio kappa and lateral slip tan(alpha) of a wheel.

    Args:
        v_long: velocity of the contact point along the wheel plane [m/s].
        v_lat: the same across it, positive to the left [m/s].
        rolling_speed: R_w omega [m/s].
        v_slip: regularisation speed [m/s].

    Returns:
        (kappa, tan(alpha)), signed as the forces they produce: kappa > 0 drives, tan(alpha) > 0 pushes left.
    """
    v = regularised_speed(v_long, v_slip)
    return (rolling_speed - v_long) / v, -v_lat / v


def stiffness_per_load(n: SX, load_peak: SX) -> SX:
    """Slip stiffness per load, relative to that at static load, for the load ratio n = F_z/F_z0.

    Pacejka's C = c_1 sin(2 arctan(n/c)) over n, scaled to one at n = 1: the stiffness is proportional to the load at
    light load and greatest at n = c = load_peak.
    """
    return (load_peak**2 + 1) / (load_peak**2 + n**2)


def forces(kappa: SX, tan_alpha: SX, *, C_x: SX, C_y: SX, F_z: SX, F_z0: SX, mu: SX, load_peak: SX) -> tuple[SX, SX]:
    """Longitudinal and lateral force [N] in wheel axes; always |F| <= mu F_z.

    Args:
        kappa: slip ratio [1].
        tan_alpha: lateral slip [1].
        C_x: longitudinal slip stiffness at the static load [N].
        C_y: cornering stiffness at the static load [N/rad].
        F_z: load [N], not negative.
        F_z0: static load [N].
        mu: friction coefficient [1].
        load_peak: see `stiffness_per_load`.
    """
    mu = ca.fmax(mu, _LEAST_MU)
    # The force without sliding over mu F_z; F_z itself cancels, so that a lifted wheel gives no 0/0.
    demand = stiffness_per_load(F_z / F_z0, load_peak) / (F_z0 * mu)
    demand_x = demand * C_x * kappa
    demand_y = demand * C_y * tan_alpha
    r = ca.sqrt(demand_x**2 + demand_y**2 + _TINY)
    used = ca.fmin(r, 3)
    use = used - used**2 / 3 + used**3 / 27
    return mu * F_z * use * demand_x / r, mu * F_z * use * demand_y / r
