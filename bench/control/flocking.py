"""The multi-objective flocking law of Olfati-Saber as the paper uses it, (6)-(10) and (33).

Points q (m) and velocities p (m/s) are in the road frame, X along the road and Y to the left. Compiled, because the
genetic search evaluates it thousands of times per interval.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bench.control.compiled import njit

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

GAINS = ("Ga", "Gb", "p11", "p12", "p21", "p22")
"""The order of the gains in Lambda, the vector that is optimised."""

GA, GB, P11, P12, P21, P22 = range(len(GAINS))
"""The indices of the gains in Lambda."""


class Field(NamedTuple):
    """The constants of the flocking law.

    Attributes:
        eps: of the sigma-norm.
        distance: d, at which the force between two agents is zero (m).
        reach: r, beyond which agents are not neighbours (m).
        flat: G_h of the bump function.
    """

    eps: float
    distance: float
    reach: float
    flat: float


@njit(cache=True)
def sigma_norm(distance: float, eps: float) -> float:
    """`|z|_sigma` of a vector of the given length (m), (8): smooth at zero."""
    return (math.sqrt(1.0 + eps * distance * distance) - 1.0) / eps


@njit(cache=True)
def bump(z: float, flat: float) -> float:
    """rho_h of (10f): 1 up to `flat`, then a cosine down to 0 at 1."""
    if z < 0.0 or z > 1.0:
        return 0.0
    if z < flat:
        return 1.0
    return 0.5 * (1.0 + math.cos(math.pi * (z - flat) / (1.0 - flat)))


@njit(cache=True)
def action(z: float, Ga: float, Gb: float) -> float:
    """The action function phi of (10e) for `0 < Ga <= Gb`: repels below zero, attracts above, and is zero at zero."""
    shifted = z + abs(Ga - Gb) / math.sqrt(4.0 * Ga * Gb)
    return 0.5 * ((Ga + Gb) * shifted / math.sqrt(1.0 + shifted * shifted) + (Ga - Gb))


@njit(cache=True)
def acceleration(
    q: Vector,
    p: Vector,
    peers_q: Matrix,
    peers_p: Matrix,
    q_hat: Vector,
    p_hat: Vector,
    gains: Vector,
    field: Field,
) -> tuple[float, float]:
    """The commanded acceleration u_i (m/s^2, m/s^2) of one agent, (9)-(10) with the gains of (33).

    Args:
        q: (2,) own point.
        p: (2,) own velocity.
        peers_q: (n, 2) points of the others.
        peers_p: (n, 2) their velocities.
        q_hat: (2,) navigation target.
        p_hat: (2,) its velocity.
        gains: (6,) Lambda in the order of `GAINS`.
        field: constants of the law.
    """
    eps = field.eps
    u_x = -gains[P11] * (q[0] - q_hat[0]) - gains[P21] * (p[0] - p_hat[0])
    u_y = -gains[P12] * (q[1] - q_hat[1]) - gains[P22] * (p[1] - p_hat[1])
    r_a = sigma_norm(field.reach, eps)
    d_a = sigma_norm(field.distance, eps)
    for j in range(peers_q.shape[0]):
        x, y = peers_q[j, 0] - q[0], peers_q[j, 1] - q[1]
        apart = math.sqrt(x * x + y * y)
        if apart >= field.reach:
            continue
        z = sigma_norm(apart, eps)
        near = bump(z / r_a, field.flat)
        force = near * action(z - d_a, gains[GA], gains[GB]) / math.sqrt(1.0 + eps * apart * apart)
        u_x += force * x + near * (peers_p[j, 0] - p[0])
        u_y += force * y + near * (peers_p[j, 1] - p[1])
    return u_x, u_y
