# cython: boundscheck=False, cdivision=True
"""Random numbers that are the same on every machine, compiled or not: SplitMix64 (Steele, Lea and Flood 2014).

Its state is one integer of 64 bits. numpy's generators cost some 0.1 us a number when called one by one.
"""

import cython

if cython.compiled:
    from cython.cimports.libc.math import log, sqrt
else:
    from math import log, sqrt

_MASK = 0xFFFFFFFFFFFFFFFF
_STEP = 0x9E3779B97F4A7C15
_MIX_1 = 0xBF58476D1CE4E5B9
_MIX_2 = 0x94D049BB133111EB
_UNIT = 2.0**-53


@cython.cclass
class RandomNumbers:
    """A sequence of random numbers; the same seed gives the same sequence.

    Args:
        seed: in [0, 2^64).
    """

    def __init__(self, seed: int) -> None:
        self._state = seed
        self._spare = 0.0
        self._has_spare = False

    @cython.ccall
    @cython.exceptval(check=False)
    def bits(self) -> cython.ulonglong:
        """Return 64 random bits as an integer."""
        # Compiled, integers of 64 bits overflow by themselves, and the masks do nothing.
        self._state = (self._state + _STEP) & _MASK
        z: cython.ulonglong = self._state
        z = ((z ^ (z >> 30)) * _MIX_1) & _MASK
        z = ((z ^ (z >> 27)) * _MIX_2) & _MASK
        return z ^ (z >> 31)

    @cython.ccall
    @cython.exceptval(check=False)
    def uniform(self) -> cython.double:
        """Return a number in [0, 1), a multiple of 2^-53."""
        return (self.bits() >> 11) * _UNIT

    @cython.ccall
    @cython.exceptval(check=False)
    def below(self, count: cython.int) -> cython.int:
        """Return an integer in [0, count)."""
        return cython.cast(cython.int, self.uniform() * count)

    @cython.ccall
    @cython.exceptval(check=False)
    def normal(self) -> cython.double:
        """Return a number of the standard normal distribution, by Marsaglia's polar method."""
        if self._has_spare:
            self._has_spare = False
            return self._spare
        x: cython.double = 0.0
        y: cython.double = 0.0
        r: cython.double = 0.0
        while r >= 1.0 or r == 0.0:
            x = 2.0 * self.uniform() - 1.0
            y = 2.0 * self.uniform() - 1.0
            r = x * x + y * y
        factor: cython.double = sqrt(-2.0 * log(r) / r)
        self._spare = y * factor
        self._has_spare = True
        return x * factor


def mixed(*numbers: int) -> int:
    """Return a seed in [0, 2^64) that depends on all these numbers and on their order."""
    seed = 0
    for number in numbers:
        seed = RandomNumbers((seed + number) & _MASK).bits()
    return seed
