# cython: boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""The multi-objective flocking law of Olfati-Saber as the paper uses it, (6)-(10) and (33).

Points q (m) and velocities p (m/s) are in the road frame, X along the road and Y to the left. The genetic search
evaluates the law thousands of times per interval.
"""

import math
from array import array
from collections.abc import Iterable

import cython

if cython.compiled:
    from cython.cimports.libc.math import cos, sqrt
else:
    from math import cos, sqrt

GAINS = ("Ga", "Gb", "p11", "p12", "p21", "p22")
"""The order of the gains in Lambda, the vector that is optimised."""

# Constants of C where the file is compiled, declared in flocking.pxd. The indices of the gains in Lambda:
GA = 0
GB = 1
P11 = 2
P12 = 3
P21 = 4
P22 = 5
_PI = math.pi


@cython.cclass
class Gains:
    """Lambda, the gains of the flocking law.

    Args:
        values: (6,) in the order of `GAINS`.
    """

    def __init__(self, values: Iterable[float]) -> None:
        self.values = array("d", values)
        self.complete()

    @cython.ccall
    @cython.exceptval(check=False)
    def complete(self) -> cython.void:
        """Raise Gb to Ga where it is below it, as the law requires; to be called when the values have been changed."""
        self.values[GB] = max(self.values[GA], self.values[GB])
        self._offset = offset(self.values[GA], self.values[GB])


@cython.cclass
class Field:
    """The constants of the flocking law.

    Attributes:
        eps: of the sigma-norm.
        distance: d, at which the force between two agents is zero (m).
        reach: r, beyond which agents are not neighbours (m).
        flat: G_h of the bump function.
    """

    def __init__(self, eps: float, distance: float, reach: float, flat: float) -> None:
        self.eps = eps
        self.distance = distance
        self.reach = reach
        self.flat = flat
        self._distance_norm = sigma_norm(distance, eps)
        self._per_reach_norm = 1.0 / sigma_norm(reach, eps)


@cython.cclass
class Neighbours:
    """The points S and velocities W of other vehicles.

    Attributes:
        count: number of them.
    """

    def __init__(self, count: int) -> None:
        self.count = count
        # Not empty, so that an array of no vehicles has a buffer too.
        self.X = array("d", bytes(8 * count + 8))
        self.Y = array("d", bytes(8 * count + 8))
        self.W_x = array("d", bytes(8 * count + 8))
        self.W_y = array("d", bytes(8 * count + 8))

    @cython.ccall
    @cython.exceptval(check=False)
    def put(
        self, place: cython.int, X: cython.double, Y: cython.double, W_x: cython.double, W_y: cython.double
    ) -> cython.void:
        """Set the vehicle at a place (from 0): point (m, m) and velocity (m/s, m/s)."""
        self.X[place] = X
        self.Y[place] = Y
        self.W_x[place] = W_x
        self.W_y[place] = W_y

    @cython.ccall
    @cython.exceptval(check=False)
    def advance(self, time_s: cython.double) -> cython.void:
        """Move all at constant velocity."""
        j: cython.int
        for j in range(self.count):
            self.X[j] += time_s * self.W_x[j]
            self.Y[j] += time_s * self.W_y[j]

    @cython.ccall
    @cython.exceptval(check=False)
    def within(self, X: cython.double, Y: cython.double, reach: cython.double) -> cython.int:
        """Return how many are nearer to a point (m, m) than `reach` (m)."""
        j: cython.int
        number: cython.int = 0
        for j in range(self.count):
            x: cython.double = self.X[j] - X
            y: cython.double = self.Y[j] - Y
            if x * x + y * y < reach * reach:
                number += 1
        return number


@cython.ccall
def copied(neighbours: Neighbours) -> Neighbours:
    """Return the same vehicles, which can be moved by themselves."""
    j: cython.int
    same: Neighbours = Neighbours(neighbours.count)
    for j in range(neighbours.count):
        same.put(j, neighbours.X[j], neighbours.Y[j], neighbours.W_x[j], neighbours.W_y[j])
    return same


@cython.ccall
@cython.exceptval(check=False)
def sigma_norm(distance: cython.double, eps: cython.double) -> cython.double:
    """`|z|_sigma` of a vector of the given length (m), (8): smooth at zero."""
    return (sqrt(1.0 + eps * distance * distance) - 1.0) / eps


@cython.ccall
@cython.exceptval(check=False)
def bump(z: cython.double, flat: cython.double) -> cython.double:
    """rho_h of (10f): 1 up to `flat`, then a cosine down to 0 at 1."""
    if z < 0.0 or z > 1.0:
        return 0.0
    if z < flat:
        return 1.0
    return 0.5 * (1.0 + cos(_PI * (z - flat) / (1.0 - flat)))


@cython.ccall
@cython.exceptval(check=False)
def offset(Ga: cython.double, Gb: cython.double) -> cython.double:
    """C of (10e), which makes the action zero at zero."""
    return abs(Ga - Gb) / sqrt(4.0 * Ga * Gb)


@cython.ccall
@cython.exceptval(check=False)
def action(z: cython.double, Ga: cython.double, Gb: cython.double, c: cython.double) -> cython.double:
    """The action function phi of (10e) for `0 < Ga <= Gb`: repels below 0, attracts above; c is their `offset`."""
    shifted: cython.double = z + c
    return 0.5 * ((Ga + Gb) * shifted / sqrt(1.0 + shifted * shifted) + (Ga - Gb))


@cython.ccall
@cython.exceptval(check=False)
def acceleration(
    q_x: cython.double,
    q_y: cython.double,
    p_x: cython.double,
    p_y: cython.double,
    neighbours: Neighbours,
    q_hat_x: cython.double,
    q_hat_y: cython.double,
    p_hat_x: cython.double,
    p_hat_y: cython.double,
    gains: Gains,
    field: Field,
) -> tuple[cython.double, cython.double]:
    """The commanded acceleration u_i (m/s^2, m/s^2) of one agent, (9)-(10) with the gains of (33).

    Args:
        q_x: own point q, m.
        q_y: m.
        p_x: own velocity p, m/s.
        p_y: m/s.
        neighbours: the other vehicles.
        q_hat_x: navigation target, m.
        q_hat_y: m.
        p_hat_x: its velocity, m/s.
        p_hat_y: m/s.
        gains: Lambda.
        field: constants of the law.
    """
    u_x: cython.double = -gains.values[P11] * (q_x - q_hat_x) - gains.values[P21] * (p_x - p_hat_x)
    u_y: cython.double = -gains.values[P12] * (q_y - q_hat_y) - gains.values[P22] * (p_y - p_hat_y)
    eps: cython.double = field.eps
    reach: cython.double = field.reach
    j: cython.int
    for j in range(neighbours.count):
        x: cython.double = neighbours.X[j] - q_x
        y: cython.double = neighbours.Y[j] - q_y
        squared: cython.double = x * x + y * y
        if squared >= reach * reach:
            continue
        # The sigma-norm and its gradient share a root.
        root: cython.double = sqrt(1.0 + eps * squared)
        z: cython.double = (root - 1.0) / eps
        near: cython.double = bump(z * field._per_reach_norm, field.flat)
        force: cython.double = near / root
        force *= action(z - field._distance_norm, gains.values[GA], gains.values[GB], gains._offset)
        u_x += force * x + near * (neighbours.W_x[j] - p_x)
        u_y += force * y + near * (neighbours.W_y[j] - p_y)
    return u_x, u_y
