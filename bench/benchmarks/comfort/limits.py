"""The limits of comfort: what they are called, their defaults, and how a run gets others."""

from collections.abc import Sequence
from dataclasses import asdict

from bench.control.comfort import ISO_LIMITS

LIMITS: dict[str, float] = {name: value for name, value in asdict(ISO_LIMITS).items() if name != "enabled"}
"""The limits by which every run is judged, by name."""

NAMES = tuple(LIMITS)
WORDS = {name: name.rpartition("_")[0].replace("_", " ") for name in NAMES}
UNITS = {name: {"mps2": "m/s²", "mps3": "m/s³"}[name.rpartition("_")[2]] for name in NAMES}

GIVES_WAY = frozenset({"HARD_BRAKING", "COMFORT"})
"""The values of the bus signal `Limit` with which a planner says that its vehicle feels more than is comfortable."""


def overrides(acceleration: float, jerk: float) -> Sequence[str]:
    """Return the overrides of a scenario with other limits, the same in both directions, m/s^2 and m/s^3."""
    values = {"mps2": acceleration, "mps3": jerk}
    return [f"planner.comfort.{name}={values[name.rpartition('_')[2]]}" for name in NAMES]
