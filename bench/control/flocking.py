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
    from cython.cimports.bench.control.agents import LANES, Agents
    from cython.cimports.libc.math import sqrt
else:
    from math import sqrt

    from bench.control.agents import LANES, Agents

GAINS = ("Ga", "Gb", "p11", "p12", "p21", "p22")
"""The order of the gains in Lambda, the vector that is optimised."""

# Constants of C where the file is compiled, declared in flocking.pxd. The indices of the gains in Lambda:
GA = 0
GB = 1
P11 = 2
P12 = 3
P21 = 4
P22 = 5
_QUARTER_TURN = 0.5 * math.pi


@cython.cclass
class Gains:
    """Lambda, the gains of the flocking law.

    Args:
        values: (6,) in the order of `GAINS`.
    """

    def __init__(self, values: Iterable[float]) -> None:
        self.values = list(values)
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
        self._per_eps = 1.0 / eps
        self._distance_norm = sigma_norm(distance, eps)
        self._per_reach_norm = 1.0 / sigma_norm(reach, eps)


@cython.cclass
class Neighbours:
    """The points S and velocities W of other vehicles.

    Attributes:
        count: number of them.
        weight: how much they count, in [0, 1].
    """

    def __init__(self, count: int) -> None:
        self.count = count
        self.weight = 1.0
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
@cython.exceptval(check=False)
def sigma_norm(distance: cython.double, eps: cython.double) -> cython.double:
    """`|z|_sigma` of a vector of the given length (m), (8): smooth at zero."""
    return (sqrt(1.0 + eps * distance * distance) - 1.0) / eps


@cython.ccall
@cython.exceptval(check=False)
def bump(z: cython.double, flat: cython.double) -> cython.double:
    """rho_h of (10f): 1 up to `flat`, then a cosine down to 0 at 1; `(1 + cos a) / 2` is `cos^2(a / 2)`."""
    left: cython.double = min(max((1.0 - z) / (1.0 - flat), 0.0), 1.0)
    root: cython.double = _sine(_QUARTER_TURN * left)
    return root * root if z >= 0.0 else 0.0


@cython.cfunc
@cython.inline
@cython.exceptval(check=False)
def _sine(angle: cython.double) -> cython.double:
    """Return the sine of an angle (rad) of at most a quarter turn; what the series leaves out is below rounding."""
    z: cython.double = angle * angle
    tail: cython.double = (1.0 / 355687428096000.0) - z * (
        (1.0 / 121645100408832000.0) - z * (1.0 / 51090942171709440000.0)
    )
    tail = (1.0 / 39916800.0) - z * ((1.0 / 6227020800.0) - z * ((1.0 / 1307674368000.0) - z * tail))
    tail = (1.0 / 120.0) - z * ((1.0 / 5040.0) - z * ((1.0 / 362880.0) - z * tail))
    return angle - angle * z * ((1.0 / 6.0) - z * tail)


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
    u_x: cython.double
    u_y: cython.double
    a_x: cython.double
    a_y: cython.double
    u_x, u_y = _to_target(
        q_x - q_hat_x,
        q_y - q_hat_y,
        p_x - p_hat_x,
        p_y - p_hat_y,
        gains.values[P11],
        gains.values[P12],
        gains.values[P21],
        gains.values[P22],
    )
    j: cython.int
    for j in range(neighbours.count):
        a_x, a_y = _interaction(
            neighbours.X[j] - q_x,
            neighbours.Y[j] - q_y,
            neighbours.W_x[j] - p_x,
            neighbours.W_y[j] - p_y,
            gains.values[GA],
            gains.values[GB],
            gains._offset,
            neighbours.weight,
            field,
        )
        u_x += a_x
        u_y += a_y
    return u_x, u_y


@cython.cfunc
@cython.exceptval(check=False)
def take_gains(agents: Agents, place: cython.int, gains: Gains) -> cython.void:
    """Set the gains of one agent."""
    agents.Ga[place] = gains.values[GA]
    agents.Gb[place] = gains.values[GB]
    agents.C[place] = gains._offset
    agents.P11[place] = gains.values[P11]
    agents.P12[place] = gains.values[P12]
    agents.P21[place] = gains.values[P21]
    agents.P22[place] = gains.values[P22]


@cython.cfunc
@cython.exceptval(check=False)
def accelerate(
    agents: Agents,
    neighbours: Neighbours,
    time_s: cython.double,
    q_hat_x: cython.double,
    q_hat_y: cython.double,
    p_hat_x: cython.double,
    p_hat_y: cython.double,
    field: Field,
) -> cython.void:
    """Set the commanded acceleration of agents that do not see each other, when the neighbours are `time_s` later."""
    a_x: cython.double
    a_y: cython.double
    i: cython.int
    j: cython.int
    for i in range(LANES):
        agents.u_x[i], agents.u_y[i] = _to_target(
            agents.q_x[i] - q_hat_x,
            agents.q_y[i] - q_hat_y,
            agents.p_x[i] - p_hat_x,
            agents.p_y[i] - p_hat_y,
            agents.P11[i],
            agents.P12[i],
            agents.P21[i],
            agents.P22[i],
        )
    for j in range(neighbours.count):
        w_x: cython.double = neighbours.W_x[j]
        w_y: cython.double = neighbours.W_y[j]
        x: cython.double = neighbours.X[j] + time_s * w_x
        y: cython.double = neighbours.Y[j] + time_s * w_y
        if not _any_within(agents, x, y, field.reach):
            continue
        for i in range(LANES):
            a_x, a_y = _interaction(
                x - agents.q_x[i],
                y - agents.q_y[i],
                w_x - agents.p_x[i],
                w_y - agents.p_y[i],
                agents.Ga[i],
                agents.Gb[i],
                agents.C[i],
                neighbours.weight,
                field,
            )
            agents.u_x[i] += a_x
            agents.u_y[i] += a_y


@cython.cfunc
@cython.inline
@cython.exceptval(check=False)
def _to_target(
    e_x: cython.double,
    e_y: cython.double,
    w_x: cython.double,
    w_y: cython.double,
    p11: cython.double,
    p12: cython.double,
    p21: cython.double,
    p22: cython.double,
) -> tuple[cython.double, cython.double]:
    """Return the acceleration towards the target by the errors of position (m) and velocity (m/s), (9) with (33)."""
    return -p11 * e_x - p21 * w_x, -p12 * e_y - p22 * w_y


@cython.cfunc
@cython.inline
@cython.exceptval(check=False)
def _interaction(
    x: cython.double,
    y: cython.double,
    w_x: cython.double,
    w_y: cython.double,
    Ga: cython.double,
    Gb: cython.double,
    c: cython.double,
    weight: cython.double,
    field: Field,
) -> tuple[cython.double, cython.double]:
    """Return the acceleration due to a neighbour at a relative point (m) with a relative velocity (m/s), (10).

    Without branches, so that the loop over many agents is vectorised.
    """
    squared: cython.double = x * x + y * y
    # The sigma-norm and its gradient share a root.
    root: cython.double = sqrt(1.0 + field.eps * squared)
    z: cython.double = (root - 1.0) * field._per_eps
    near: cython.double = bump(z * field._per_reach_norm, field.flat)
    near = weight * near if squared < field.reach * field.reach else 0.0
    force: cython.double = near * action(z - field._distance_norm, Ga, Gb, c) / root
    return force * x + near * w_x, force * y + near * w_y


@cython.cfunc
@cython.exceptval(check=False)
def _any_within(agents: Agents, x: cython.double, y: cython.double, reach: cython.double) -> cython.int:
    """Return whether an agent is nearer to a point (m, m) than `reach` (m)."""
    i: cython.int
    number: cython.int = 0
    for i in range(LANES):
        way_x: cython.double = x - agents.q_x[i]
        way_y: cython.double = y - agents.q_y[i]
        number += way_x * way_x + way_y * way_y < reach * reach
    return number
