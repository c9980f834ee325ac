"""The near-identity diffeomorphism: steering a car as if it were a point, (11)-(15).

The point S lies `l` ahead of the centre of mass in the direction of motion theta, and can be accelerated in any
direction: `dS/dt = R_l [v; gamma]` with `R_l = [[c, -l s], [s, l c]]`. The printed R_lambda is singular; this one has
determinant l. theta is the course, yaw angle plus side-slip angle: with the yaw angle alone, a car that crabs in a
side wind would settle beside its lane.
"""

import math

import numpy as np
from numpy.typing import NDArray

from bench.control.compiled import njit

Vector = NDArray[np.float64]


@njit(cache=True)
def point(X: float, Y: float, theta: float, length: float) -> tuple[float, float]:
    """S (m, m) of (12) from the centre of mass (m, m) and the course (rad)."""
    return X + length * math.cos(theta), Y + length * math.sin(theta)


@njit(cache=True)
def velocity(theta: float, v: float, gamma: float, length: float) -> tuple[float, float]:
    """W = dS/dt (m/s, m/s) of (13) from course (rad), speed (m/s) and yaw rate (rad/s)."""
    c, s = math.cos(theta), math.sin(theta)
    return c * v - length * s * gamma, s * v + length * c * gamma


@njit(cache=True)
def input_rates(theta: float, v: float, gamma: float, length: float, eta_x: float, eta_y: float) -> tuple[float, float]:
    """d[v; gamma]/dt (m/s^2, rad/s^2) that accelerates S by eta (m/s^2, m/s^2), (14)."""
    c, s = math.cos(theta), math.sin(theta)
    along = c * eta_x + s * eta_y
    across = -s * eta_x + c * eta_y
    return along + length * gamma * gamma, (across - v * gamma) / length
