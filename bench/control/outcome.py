"""Outcomes of a controller step, as in the value tables of the diagnostic messages.

A separate module, so that reading a log does not load the solvers.
"""

import enum


class Limit(enum.IntEnum):
    """The boundary that limited a reference; the values are those of the bus signal `Limit`."""

    NONE = 0
    YAW_RATE = 1
    ACCELERATION = 2
    FRICTION_CIRCLE = 3
    SPEED = 4
    CLEARANCE = 5
    """The distance to a vehicle ahead; within the limits of comfort."""
    HARD_BRAKING = 6
    """The distance to a vehicle ahead, where comfortable braking does not keep it."""
    COMFORT = 7
    """None; but the vehicle's measured acceleration, or its jerk, exceeds the limits of comfort."""


class SolverStatus(enum.IntEnum):
    """How a solve ended; the values are those of the bus signal `SolverStatus`."""

    SOLVED = 0
    ALMOST_SOLVED = 1
    MAX_ITERATIONS = 2
    INFEASIBLE = 3
    NUMERICAL_ERROR = 4
    CHECK_FAILED = 5
    NOT_RUN = 6


class GainSource(enum.IntEnum):
    """Where the feedback of a step came from; the values are those of the bus signal `GainSource`.

    `SDP` is the semidefinite program of this step, `RICCATI` its optimum from the Riccati equation.
    """

    SDP = 0
    PREVIOUS_GAIN = 1
    LQR = 2
    NONE = 3
    RICCATI = 4

    @property
    def is_certified(self) -> bool:
        """Whether the gain is the certified one of its step; otherwise it is a fallback."""
        return self in (GainSource.SDP, GainSource.RICCATI)
