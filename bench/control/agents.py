# cython: boundscheck=False, wraparound=False, initializedcheck=False
"""Vehicles of the planning model side by side: the same operation on each is one vector instruction for several.

The flocking law, the near-identity step and the boundaries each have one definition for a single vehicle, and a loop
over these lanes that applies it. Such loops have a fixed length and no branches, so the C compiler vectorises them.
"""

import cython

if not cython.compiled:
    # As in agents.pxd, where it is a constant of C.
    LANES = 8

_ROWS = (
    *("X", "Y", "c", "s", "v", "gamma"),
    *("q_x", "q_y", "p_x", "p_y", "u_x", "u_y", "v_rate", "gamma_rate", "gamma_max"),
    *("Ga", "Gb", "C", "P11", "P12", "P21", "P22"),
    *("v_before", "v_reach", "cost"),
)


@cython.cclass
class Agents:
    """As many vehicles as there are lanes, each with its state and gains.

    Attributes:
        X, Y: position along the road and to the left (m).
        c, s: cosine and sine of the course.
        v, gamma: reference speed (m/s) and yaw rate (rad/s).
        q_x, q_y, p_x, p_y: point S (m) and its velocity W (m/s).
        u_x, u_y: commanded acceleration (m/s^2).
        v_rate, gamma_rate: requested rates of v and gamma (m/s^2, rad/s^2).
        gamma_max: largest yaw rate at v (rad/s).
        Ga, Gb, C, P11, P12, P21, P22: gains and their offset.
        v_before: v one step of the horizon before (m/s).
        v_reach: extreme speed reachable from there (m/s).
        cost: of the rollout so far.
    """

    def __init__(self) -> None:
        if not cython.compiled:
            for row in _ROWS:
                setattr(self, row, [0.0] * LANES)
