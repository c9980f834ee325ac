"""The lateral motion: its ends, its derivatives, its limits, and that no shorter one keeps to them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.control.lane_change import SHORTEST_S, STEP_S, LaneChange, lane_change

states = st.tuples(st.floats(-20.0, 20.0), st.floats(-3.0, 3.0), st.floats(-3.0, 3.0))
targets = st.floats(-20.0, 20.0)


@given(states, targets, st.floats(0.5, 20.0))
def test_it_leads_from_the_state_to_rest_on_the_target_and_stays_there(state, target, duration):
    change = LaneChange(*state, target, duration)
    assert change.at(0.0) == pytest.approx(state, abs=1e-12)
    assert change.at(-1.0) == change.at(0.0)
    assert change.at(duration - 1e-9) == pytest.approx((target, 0.0, 0.0), abs=1e-4)
    assert change.at(duration) == change.at(duration + 100.0) == (target, 0.0, 0.0)


@given(states, targets, st.floats(1.0, 10.0), st.floats(0.05, 0.95))
def test_velocity_and_acceleration_are_the_derivatives(state, target, duration, part):
    change, t, h = LaneChange(*state, target, duration), part * duration, 1e-5
    before, now, after = (np.array(change.at(t + each)) for each in (-h, 0.0, h))
    slopes = (after - before) / (2.0 * h)
    np.testing.assert_allclose(slopes[:2], now[1:], rtol=1e-4, atol=1e-4)


@given(states, targets, st.floats(0.5, 5.0), st.floats(1.0, 20.0))
def test_it_keeps_to_its_limits_and_a_shorter_one_does_not(state, target, acceleration, jerk):
    change = lane_change(*state, target, acceleration, jerk)
    t = np.linspace(0.0, change.duration_s, 400)
    a = np.array([change.at(each)[2] for each in t])
    # The limits are checked at 21 times; a polynomial of third order is hardly higher between them.
    assert np.abs(a).max() <= 1.05 * max(acceleration, abs(state[2])) + 1e-9
    assert np.abs(np.diff(a)).max() <= 1.1 * jerk * (t[1] - t[0]) + 1e-9
    if change.duration_s > SHORTEST_S:
        shorter = LaneChange(*state, target, change.duration_s - STEP_S)
        assert not shorter.keeps(acceleration, jerk)


def test_seven_metres_within_the_limits_of_comfort_take_less_than_five_seconds():
    change = lane_change(0.0, 0.0, 0.0, 7.0, 3.0, 5.0)
    # A quintic from rest to rest has a peak of 5.77 d / T^2, and a jerk of 60 d / T^3 at its ends.
    assert change.duration_s == pytest.approx(max((5.77 * 7.0 / 3.0) ** 0.5, (60.0 * 7.0 / 5.0) ** (1 / 3)), abs=STEP_S)
    assert change.target == 7.0


def test_who_is_there_needs_the_shortest_time_only():
    change = lane_change(3.5, 0.0, 0.0, 3.5, 3.0, 5.0)
    assert change.duration_s == SHORTEST_S
    assert change.at(0.2) == (3.5, 0.0, 0.0)
