"""Draws the values of random scenarios, from a generator that is the bench's own: the same on every machine."""

from collections.abc import Sequence
from typing import TypeVar

from bench.control.random_numbers import RandomNumbers

T = TypeVar("T")


class Draw:
    """Draws values, rounded to as many digits as people write."""

    def __init__(self, seed: int) -> None:
        """Draw from the sequence of numbers of a seed in [0, 2^64)."""
        self._numbers = RandomNumbers(seed)

    def between(self, low: float, high: float, digits: int = 2) -> float:
        """Return a number from `low` to `high`, which have no more than these digits themselves."""
        share: float = self._numbers.uniform()
        # Adding zero turns -0.0 into 0.0.
        return round(low + (high - low) * share, digits) + 0.0

    def one_of(self, choices: Sequence[T]) -> T:
        """Return one of the choices."""
        place: int = self._numbers.below(len(choices))
        return choices[place]
