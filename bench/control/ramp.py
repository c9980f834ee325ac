# cython: boundscheck=False, wraparound=False, cdivision=True
"""An acceleration that a passenger can bear: its change is limited at every moment and over half a second.

ISO 11270 limits the jerk as its moving average over 0.5 s, which is the change of the acceleration within that time.
So a change may begin more quickly than the limit allows in the long run, as a driver's does.
"""

from array import array

import cython

from bench.control.comfort import JERK_WINDOW_S

STEEPNESS = 3.0
"""The largest jerk at any moment as a multiple of the limit of its average."""


@cython.cclass
class Ramp:
    """An acceleration with limited jerk.

    Attributes:
        value: the acceleration, m/s^2.

    Args:
        jerk: limit of the jerk's average over `JERK_WINDOW_S`, m/s^3.
        step_s: T, s.
    """

    def __init__(self, jerk: float, step_s: float) -> None:
        self.value = 0.0
        self._count = max(round(JERK_WINDOW_S / step_s), 1)
        self._past = array("d", bytes(8 * self._count))
        self._place = 0
        self._swing = jerk * JERK_WINDOW_S
        self._step = STEEPNESS * jerk * step_s

    @cython.ccall
    def reset(self, value: cython.double) -> cython.void:
        """Start again from an acceleration (m/s^2) as if it had been constant."""
        k: cython.int
        self.value = value
        for k in range(self._count):
            self._past[k] = value

    @cython.ccall
    def towards(self, wanted: cython.double) -> cython.double:
        """Change the acceleration towards the wanted one (m/s^2) for one step as far as the limits allow."""
        before: cython.double = self._past[self._place]
        low: cython.double = max(before - self._swing, self.value - self._step)
        high: cython.double = min(before + self._swing, self.value + self._step)
        self.put(min(max(wanted, low), high))
        return self.value

    @cython.ccall
    def put(self, value: cython.double) -> cython.void:
        """Set the acceleration (m/s^2) of one step whatever its change, where safety asks for it."""
        self.value = value
        self._past[self._place] = value
        self._place = 0 if self._place + 1 == self._count else self._place + 1
