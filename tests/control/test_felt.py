"""What a planner says of comfort, against what the analysis of a run finds."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from bench.control.comfort import ComfortLimits
from bench.control.felt import Felt
from bench.record.comfort import mean_jerk

T = 0.01
LIMITS = ComfortLimits(
    lateral_acceleration_mps2=2.0,
    lateral_jerk_mps3=4.0,
    longitudinal_acceleration_mps2=3.0,
    longitudinal_jerk_mps3=5.0,
)
accelerations = st.lists(st.floats(-4.0, 4.0), min_size=1, max_size=40)


def course(values: list[float]) -> np.ndarray:
    """Return accelerations that keep each value for a while."""
    return np.repeat(values, 9)


@given(accelerations, accelerations)
def test_it_finds_what_the_analysis_finds(longitudinal: list[float], lateral: list[float]) -> None:
    a_x, a_y = course(longitudinal), course(lateral)
    n = min(len(a_x), len(a_y))
    a_x, a_y, time_ns = a_x[:n], a_y[:n], np.arange(n) * 10_000_000
    with np.errstate(invalid="ignore"):
        wanted = (np.abs(a_x) > 3.0) | (np.abs(a_y) > 2.0)
        wanted |= np.abs(mean_jerk(time_ns, a_x)) > 5.0
        wanted |= np.abs(mean_jerk(time_ns, a_y)) > 4.0
    felt = Felt(LIMITS, T)
    np.testing.assert_array_equal([felt.exceeds(*each) for each in zip(a_x, a_y, strict=True)], wanted)


def test_after_a_gap_the_jerk_is_unknown_for_half_a_second() -> None:
    felt = Felt(LIMITS, T)
    for _ in range(60):
        assert not felt.exceeds(0.0, -1.9)
    assert felt.exceeds(0.0, 1.9)
    felt.forget()
    assert not any(felt.exceeds(0.0, 1.9) for _ in range(50))
    assert felt.exceeds(0.0, -1.9)
