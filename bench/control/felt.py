# cython: boundscheck=False, wraparound=False, cdivision=True
"""Whether a vehicle's measured acceleration keeps to the limits of comfort.

A planner's references do, but a vehicle may feel more: a gust, or tyres whose stiffness changes in a curve.
"""

from array import array

import cython

from bench.control.comfort import JERK_WINDOW_S, ComfortLimits


@cython.cclass
class Felt:
    """The accelerations of the last half second against the limits, with the jerk as ISO 11270 has it.

    Args:
        limits: of comfort.
        step_s: T, s.
    """

    def __init__(self, limits: ComfortLimits, step_s: float) -> None:
        self._count = max(round(JERK_WINDOW_S / step_s), 1)
        self._x = array("d", bytes(8 * self._count))
        self._y = array("d", bytes(8 * self._count))
        self._known = 0
        self._a_x = limits.longitudinal_acceleration_mps2
        self._a_y = limits.lateral_acceleration_mps2
        self._swing_x = limits.longitudinal_jerk_mps3 * JERK_WINDOW_S
        self._swing_y = limits.lateral_jerk_mps3 * JERK_WINDOW_S

    @cython.ccall
    def forget(self) -> cython.void:
        """Start again: a value is missing."""
        self._known = 0

    @cython.ccall
    def exceeds(self, a_x: cython.double, a_y: cython.double) -> cython.bint:
        """Take the accelerations (m/s^2) of one more cycle; return whether they or their mean jerks exceed a limit."""
        place: cython.int = self._known % self._count
        much: cython.bint = abs(a_x) > self._a_x or abs(a_y) > self._a_y
        if self._known >= self._count:
            much = much or abs(a_x - self._x[place]) > self._swing_x or abs(a_y - self._y[place]) > self._swing_y
        self._x[place] = a_x
        self._y[place] = a_y
        self._known += 1
        return much
