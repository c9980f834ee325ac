"""An acceleration with limited jerk: at every moment, and over half a second."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.control.comfort import JERK_WINDOW_S
from bench.control.ramp import STEEPNESS, Ramp

T = 0.01
WINDOW = round(JERK_WINDOW_S / T)


@given(st.lists(st.floats(-10.0, 10.0), min_size=1, max_size=300), st.floats(0.5, 20.0))
def test_the_mean_jerk_over_half_a_second_keeps_to_the_limit(wanted, jerk):
    ramp = Ramp(jerk, T)
    values = np.array([0.0] * WINDOW + [ramp.towards(each) for each in wanted])
    assert np.abs(values[WINDOW:] - values[:-WINDOW]).max() <= jerk * JERK_WINDOW_S + 1e-9
    assert np.abs(np.diff(values)).max() <= STEEPNESS * jerk * T + 1e-9


def test_a_step_is_followed_as_fast_as_the_limits_allow():
    ramp = Ramp(4.0, T)
    values = [ramp.towards(3.0) for _ in range(80)]
    assert values[:2] == pytest.approx([STEEPNESS * 0.04, STEEPNESS * 0.08])
    # Two metres per second squared are reached at once, and no more before half a second has passed.
    assert max(values[:WINDOW]) == pytest.approx(2.0)
    assert values[WINDOW + 12] == pytest.approx(3.0)


def test_what_is_put_counts_as_the_past():
    ramp = Ramp(4.0, T)
    ramp.put(-8.0)
    assert ramp.value == -8.0
    assert ramp.towards(0.0) == pytest.approx(-8.0 + STEEPNESS * 0.04)


def test_after_a_reset_the_acceleration_has_been_constant():
    ramp = Ramp(4.0, T)
    ramp.put(-8.0)
    ramp.reset(1.0)
    values = [ramp.towards(10.0) for _ in range(WINDOW)]
    assert max(values) == pytest.approx(3.0)
