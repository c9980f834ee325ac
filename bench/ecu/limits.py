"""Signal ranges, rates of change and message timeouts from the DBC."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import cython

from bench.bus.codec import DBC_DIR, Codec
from bench.bus.topic import Signals
from bench.cycle import CYCLE_S


@dataclass(frozen=True, slots=True)
class Limit:
    """Possible values of one signal.

    Attributes:
        low: lower end of its range; a value there is saturated, so the true value is unknown.
        high: upper end.
        change: largest change from one cycle to the next; infinite if the DBC does not define it.
    """

    low: float
    high: float
    change: float

    def allows(self, value: float, before: float | None, cycles: int = 1) -> bool:
        """Whether a value is possible `cycles` cycles after the value `before`; false for NaN."""
        if not self.low < value < self.high:
            return False
        return before is None or abs(value - before) <= self.change * cycles


@cache
def limits_of(dbc: str, message: str) -> Mapping[str, Limit]:
    """Return the limits of a message's signals by name.

    Args:
        dbc: name of the DBC file: `vehicle.dbc`.
        message: name of the message in it.
    """
    limits = {}
    for signal in Codec(DBC_DIR / dbc).described(message).signals:
        # Rounding can add half a quantum at either end.
        change = signal.most_change_per_s * CYCLE_S + signal.scale if signal.most_change_per_s else math.inf
        limits[signal.name] = Limit(signal.low, signal.high, change)
    return limits


@cache
def timeout_cycles(dbc: str, message: str) -> int:
    """Return the number of cycles without a valid frame after which a message is lost.

    Args:
        dbc: name of the DBC file: `vehicle.dbc`.
        message: name of the message in it.
    """
    return Codec(DBC_DIR / dbc).timeout_cycles(message)


def possible(limits: Mapping[str, Limit], frame: Signals | None, names: Sequence[str]) -> cython.bint:
    """Whether all these signals of a frame are within their ranges; true for a missing frame."""
    if frame is None:
        return True
    value: cython.double
    for name in names:
        limit = limits[name]
        value = frame[name]
        if not limit.low < value < limit.high:
            return False
    return True
