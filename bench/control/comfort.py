"""What passengers find comfortable: limits of acceleration and jerk in the vehicle's axes."""

from dataclasses import dataclass
from typing import Annotated

from annotated_types import Ge, Le

JERK_WINDOW_S = 0.5
"""Jerk is limited as its moving average over this time, as in ISO 11270: (a(t) - a(t - 0.5 s)) / 0.5 s."""


@dataclass(frozen=True)
class ComfortLimits:
    """Limits of comfort.

    The defaults are those of ISO 11270 (lane keeping assistance) for the lateral axis and for braking; accelerating and
    longitudinal jerk, for which it has none, have the same numbers.

    Attributes:
        enabled: false for the shortest formation within the stability boundaries.
        lateral_acceleration_mps2: largest lateral acceleration, to either side.
        lateral_jerk_mps3: largest lateral jerk, averaged over `JERK_WINDOW_S`, to either side.
        longitudinal_acceleration_mps2: largest acceleration and largest braking.
        longitudinal_jerk_mps3: largest longitudinal jerk, averaged likewise, of either sign.
    """

    enabled: bool = True
    lateral_acceleration_mps2: Annotated[float, Ge(0.01), Le(20)] = 3.0
    lateral_jerk_mps3: Annotated[float, Ge(0.01), Le(1000)] = 5.0
    longitudinal_acceleration_mps2: Annotated[float, Ge(0.01), Le(20)] = 3.0
    longitudinal_jerk_mps3: Annotated[float, Ge(0.01), Le(1000)] = 5.0


ISO_LIMITS = ComfortLimits()
"""The standard's limits."""
