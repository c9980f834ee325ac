# cython: boundscheck=False, cdivision=True
"""The near-identity diffeomorphism: steering a car as if it were a point, (11)-(15).

The point S lies `l` ahead of the centre of mass in the direction of motion theta, and can be accelerated in any
direction: `dS/dt = R_l [v; gamma]` with `R_l = [[c, -l s], [s, l c]]`, `c = cos theta`, `s = sin theta`. The printed
R_lambda is singular; this one has determinant l. theta is the course, yaw angle plus side-slip angle: with the yaw
angle alone, a car that crabs in a side wind would settle beside its lane.
"""

import cython

if cython.compiled:
    from cython.cimports.bench.control.agents import LANES, Agents
    from cython.cimports.libc.math import cos, sin
else:
    from math import cos, sin

    from bench.control.agents import LANES, Agents

SMALL = 0.1
"""Angle (rad) up to which the terms of the series that are left out are below the rounding error."""


@cython.ccall
@cython.exceptval(check=False)
def point(
    X: cython.double, Y: cython.double, c: cython.double, s: cython.double, length: cython.double
) -> tuple[cython.double, cython.double]:
    """S (m, m) of (12) from the centre of mass (m, m) and the course."""
    return X + length * c, Y + length * s


@cython.ccall
@cython.exceptval(check=False)
def velocity(
    c: cython.double, s: cython.double, v: cython.double, gamma: cython.double, length: cython.double
) -> tuple[cython.double, cython.double]:
    """W = dS/dt (m/s, m/s) of (13) from course, speed (m/s) and yaw rate (rad/s)."""
    return c * v - length * s * gamma, s * v + length * c * gamma


@cython.ccall
@cython.exceptval(check=False)
def input_rates(
    c: cython.double,
    s: cython.double,
    v: cython.double,
    gamma: cython.double,
    length: cython.double,
    eta_x: cython.double,
    eta_y: cython.double,
) -> tuple[cython.double, cython.double]:
    """d[v; gamma]/dt (m/s^2, rad/s^2) that accelerates S by eta (m/s^2, m/s^2), (14)."""
    along: cython.double = c * eta_x + s * eta_y
    across: cython.double = c * eta_y - s * eta_x
    return along + length * gamma * gamma, (across - v * gamma) / length


@cython.ccall
@cython.exceptval(check=False)
def turned(c: cython.double, s: cython.double, angle: cython.double) -> tuple[cython.double, cython.double]:
    """The cosine and sine of the course turned by an angle (rad): a small one costs less than its cosine and sine."""
    if -SMALL < angle < SMALL:
        c, s = _slightly_turned(c, s, angle)
    else:
        c, s = _added(c, s, cos(angle), sin(angle))
    return c, s


@cython.cfunc
@cython.inline
@cython.exceptval(check=False)
def _slightly_turned(c: cython.double, s: cython.double, angle: cython.double) -> tuple[cython.double, cython.double]:
    """Return the same for an angle below `SMALL`, without branches."""
    z: cython.double = angle * angle
    zz: cython.double = z * z
    cos_angle: cython.double = 1.0 - z * 0.5 + zz * ((1.0 / 24.0) - z * (1.0 / 720.0) + zz * (1.0 / 40320.0))
    sin_angle: cython.double = angle - angle * z * (
        (1.0 / 6.0) - z * (1.0 / 120.0) + zz * ((1.0 / 5040.0) - z * (1.0 / 362880.0))
    )
    c, s = _added(c, s, cos_angle, sin_angle)
    return c, s


@cython.cfunc
@cython.inline
@cython.exceptval(check=False)
def _added(
    c: cython.double, s: cython.double, cos_angle: cython.double, sin_angle: cython.double
) -> tuple[cython.double, cython.double]:
    """Return the cosine and sine of the sum of two angles."""
    return c * cos_angle - s * sin_angle, s * cos_angle + c * sin_angle


@cython.cfunc
@cython.exceptval(check=False)
def locate(agents: Agents, length: cython.double) -> cython.void:
    """Set each agent's point S and its velocity W."""
    i: cython.int
    for i in range(LANES):
        agents.q_x[i], agents.q_y[i] = point(agents.X[i], agents.Y[i], agents.c[i], agents.s[i], length)
        agents.p_x[i], agents.p_y[i] = velocity(agents.c[i], agents.s[i], agents.v[i], agents.gamma[i], length)


@cython.cfunc
@cython.exceptval(check=False)
def request(agents: Agents, length: cython.double) -> cython.void:
    """Set the rates of speed and yaw rate that give each agent its acceleration."""
    i: cython.int
    for i in range(LANES):
        agents.v_rate[i], agents.gamma_rate[i] = input_rates(
            agents.c[i], agents.s[i], agents.v[i], agents.gamma[i], length, agents.u_x[i], agents.u_y[i]
        )


@cython.cfunc
@cython.exceptval(check=False)
def move(agents: Agents, step_s: cython.double) -> cython.void:
    """Move each agent by a step (s) of its speed, then turn it by its yaw rate."""
    i: cython.int
    large: cython.int = 0
    for i in range(LANES):
        agents.X[i] += step_s * agents.v[i] * agents.c[i]
        agents.Y[i] += step_s * agents.v[i] * agents.s[i]
        large |= abs(step_s * agents.gamma[i]) >= SMALL
    if large:
        for i in range(LANES):
            agents.c[i], agents.s[i] = turned(agents.c[i], agents.s[i], step_s * agents.gamma[i])
    else:
        for i in range(LANES):
            agents.c[i], agents.s[i] = _slightly_turned(agents.c[i], agents.s[i], step_s * agents.gamma[i])
