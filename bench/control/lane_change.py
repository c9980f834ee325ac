# cython: boundscheck=False, cdivision=True
"""A lateral motion to rest at another place across the road: the polynomial of fifth order.

Of all motions with the same ends and duration it has the least integral of the squared jerk (Takahashi et al. 1989;
Werling et al., ICRA 2010). The shortest duration is taken with which acceleration and jerk keep to their limits.
"""

import cython

SHORTEST_S = 0.5
STEP_S = 0.05
"""Durations (s) are tried from the shortest on, in this step."""

LONGEST_S = 60.0
_SAMPLES = 20


@cython.cclass
class LaneChange:
    """The motion from a lateral state to rest.

    Args:
        Y: lateral position at the start, m.
        v: lateral velocity at the start, m/s.
        a: lateral acceleration at the start, m/s^2.
        target: lateral position at the end, m.
        duration_s: s.
    """

    def __init__(self, Y: float, v: float, a: float, target: float, duration_s: float) -> None:
        T: cython.double = duration_s
        way: cython.double = target - Y - v * T - 0.5 * a * T * T
        speed: cython.double = -v - a * T
        self.target = target
        self.duration_s = T
        self._y = Y
        self._v = v
        self._a = a
        self._c3 = (10.0 * way - 4.0 * speed * T - 0.5 * a * T * T) / (T * T * T)
        self._c4 = (-15.0 * way + 7.0 * speed * T + a * T * T) / (T * T * T * T)
        self._c5 = (6.0 * way - 3.0 * speed * T - 0.5 * a * T * T) / (T * T * T * T * T)

    @cython.ccall
    def at(self, time_s: cython.double) -> tuple[cython.double, cython.double, cython.double]:
        """Return position (m), velocity (m/s) and acceleration (m/s^2) `time_s` after the start; then at rest."""
        t: cython.double = max(time_s, 0.0)
        if t >= self.duration_s:
            return self.target, 0.0, 0.0
        return (
            self._y + t * (self._v + t * (0.5 * self._a + t * (self._c3 + t * (self._c4 + t * self._c5)))),
            self._v + t * (self._a + t * (3.0 * self._c3 + t * (4.0 * self._c4 + t * 5.0 * self._c5))),
            self._a + t * (6.0 * self._c3 + t * (12.0 * self._c4 + t * 20.0 * self._c5)),
        )

    @cython.ccall
    def keeps(self, acceleration: cython.double, jerk: cython.double) -> cython.bint:
        """Return whether the motion keeps to an acceleration (m/s^2) from its start's on, and to a jerk (m/s^3)."""
        k: cython.int
        a: cython.double
        most: cython.double = max(acceleration, abs(self._a) + 1e-9)
        for k in range(_SAMPLES + 1):
            t: cython.double = self.duration_s * k / _SAMPLES
            _, _, a = self.at(t)
            j: cython.double = 6.0 * self._c3 + t * (24.0 * self._c4 + t * 60.0 * self._c5)
            if abs(a) > most or abs(j) > jerk:
                return False
        return True


def lane_change(Y: float, v: float, a: float, target: float, acceleration: float, jerk: float) -> LaneChange:
    """Return the shortest motion from a lateral state (m, m/s, m/s^2) to rest at `target` (m).

    Args:
        Y: lateral position, m.
        v: lateral velocity, m/s.
        a: lateral acceleration, m/s^2.
        target: lateral position at the end, m.
        acceleration: its limit, m/s^2.
        jerk: its limit, m/s^3.
    """
    duration_s = SHORTEST_S
    change = LaneChange(Y, v, a, target, duration_s)
    while not change.keeps(acceleration, jerk) and duration_s < LONGEST_S:
        duration_s += STEP_S
        change = LaneChange(Y, v, a, target, duration_s)
    return change
