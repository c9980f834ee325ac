"""What the DBC says of signals and messages: their ranges, the fastest that they can change, and when they are lost."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

from bench.bus.codec import DBC_DIR, Codec
from bench.bus.topic import Signals
from bench.cycle import CYCLE_S


@dataclass(frozen=True, slots=True)
class Limit:
    """What one signal can be.

    Attributes:
        low: lower end of its range; a value there is saturated, so it may be anything.
        high: upper end.
        change: most that it can change from one cycle to the next; infinite where the DBC does not tell.
    """

    low: float
    high: float
    change: float

    def allows(self, value: float, before: float | None, cycles: int = 1) -> bool:
        """Whether a value is possible `cycles` cycles after the value `before`; NaN never is."""
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
    for signal in Codec(DBC_DIR / dbc).message(message).signals:
        rate = signal.dbc.attributes.get("GenSigRateMax") if signal.dbc else None
        # Half a quantum may go up and half a quantum down.
        change = float(rate.value) * CYCLE_S + signal.scale if rate is not None and rate.value else math.inf
        limits[signal.name] = Limit(float(signal.minimum or 0.0), float(signal.maximum or 0.0), change)
    return limits


@cache
def timeout_cycles(dbc: str, message: str) -> int:
    """Return after how many cycles without a good frame a message is lost.

    Args:
        dbc: name of the DBC file: `vehicle.dbc`.
        message: name of the message in it.
    """
    return Codec(DBC_DIR / dbc).timeout_cycles(message)


def possible(limits: Mapping[str, Limit], frame: Signals | None, names: tuple[str, ...]) -> bool:
    """Whether all these signals of a frame are inside their ranges; a frame that did not come has nothing wrong."""
    return frame is None or all(limits[name].allows(frame[name], None) for name in names)
