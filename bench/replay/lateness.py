"""How late frames were sent, in a histogram of constant size."""

from __future__ import annotations

import math
from collections import Counter


class Lateness:
    """Lateness of each frame sent, kept to two significant digits.

    Attributes:
        frames: how many there are.
        largest_ns: the largest, exactly.
    """

    def __init__(self) -> None:
        """Begin with none."""
        self.frames = 0
        self.largest_ns = 0
        self._counts: Counter[int] = Counter()

    def add(self, late_ns: int) -> None:
        """Add the lateness of one frame; early counts as zero."""
        late_ns = max(0, late_ns)
        self.frames += 1
        self.largest_ns = max(self.largest_ns, late_ns)
        self._counts[_rounded_up(late_ns)] += 1

    def quantile_ns(self, share: float) -> int:
        """Return the lateness that this share of the frames did not exceed, at most 10 % too large; 0 if none."""
        wanted = math.ceil(share * self.frames)
        seen = 0
        for late_ns in sorted(self._counts):
            seen += self._counts[late_ns]
            if seen >= wanted:
                return min(late_ns, self.largest_ns)
        return 0


def _rounded_up(late_ns: int) -> int:
    """Return `late_ns` rounded to two significant digits."""
    unit: int = 10 ** max(0, len(str(late_ns)) - 2)
    return -(-late_ns // unit) * unit
