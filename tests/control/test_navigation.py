"""The navigation target: it reaches its slot within its limits, from wherever it starts."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.control.navigation import MotionLimits, NavigationTarget

T = 0.01
LIMITS = MotionLimits(lateral=2.6, lateral_jerk=5.0, longitudinal=2.6, longitudinal_jerk=4.5)
SPEED = 20.0


def trail(
    target: NavigationTarget, slot_x: float, seconds: float, least: float = -1e3, most: float = 1e3
) -> np.ndarray:
    """Return x - slot, v_x - speed, a_x, y, v_y, a_y of each cycle, (n, 6)."""
    rows = []
    for cycle in range(round(seconds / T)):
        slot = slot_x + SPEED * T * cycle
        rows.append((target.x - slot, target.v_x - SPEED, target.a_x, target.y, target.v_y, target.a_y))
        target.advance(slot + SPEED * T, SPEED, least, most)
    return np.array(rows)


@given(st.floats(-60.0, 60.0), st.floats(-6.0, 6.0), st.floats(-14.0, 14.0))
def test_it_comes_to_its_slot_within_its_limits_and_stays(ahead, faster, lane_y):
    target = NavigationTarget(LIMITS, T)
    target.start(ahead, 0.0, SPEED + faster, 0.0, 0.0)
    target.change_to(lane_y)
    rows = trail(target, 0.0, 30.0)
    x, v, a, y, _, a_y = rows.T
    assert np.abs(rows[-1, [0, 1, 2]]).max() < 0.02
    assert rows[-1, 3:] == pytest.approx([lane_y, 0.0, 0.0])
    assert np.abs(a).max() <= LIMITS.longitudinal + 1e-9
    assert np.abs(a[50:] - a[:-50]).max() <= 0.5 * LIMITS.longitudinal_jerk + 1e-9
    assert np.abs(a_y).max() <= 1.05 * LIMITS.lateral
    # It hardly passes its slot, but for the way that the speed it starts with takes to brake.
    if abs(faster) < 0.1 and abs(ahead) > 1.0:
        assert (np.sign(ahead) * x).min() > -0.15
    np.testing.assert_allclose(np.diff(x) / T, v[:-1], atol=0.03)
    np.testing.assert_allclose(np.diff(y) / T, rows[:-1, 4], atol=0.03)


def test_it_stays_in_its_lane_until_it_changes():
    target = NavigationTarget(LIMITS, T)
    target.start(0.0, 3.5, SPEED, 0.0, 0.0)
    rows = trail(target, 10.0, 3.0)
    assert (rows[:, 3:] == [3.5, 0.0, 0.0]).all()
    assert not target.changing


def test_it_keeps_to_what_others_leave_it():
    target = NavigationTarget(LIMITS, T)
    target.start(-20.0, 0.0, SPEED, 0.0, 0.0)
    rows = trail(target, 0.0, 2.0, most=-1.0)
    assert rows[-1, 2] == pytest.approx(-1.0)


def test_it_leaves_those_behind_what_they_need_unless_it_must_keep_clear_itself():
    target = NavigationTarget(LIMITS, T)
    target.start(20.0, 0.0, SPEED, 0.0, 0.0)
    assert trail(target, 0.0, 2.0, least=0.5)[-1, 2] == pytest.approx(0.5)
    target.start(20.0, 0.0, SPEED, 0.0, 0.0)
    assert trail(target, 0.0, 2.0, least=0.5, most=-1.0)[-1, 2] == pytest.approx(-1.0)


@given(st.floats(0.0, 0.4), st.floats(-14.0, 14.0))
def test_its_lead_makes_no_step_in_the_lateral_acceleration(lead_s, lane_y):
    target = NavigationTarget(LIMITS, T, lead_s)
    target.start(0.0, 0.0, SPEED, 0.0, 0.0)
    target.change_to(lane_y)
    a_y = trail(target, 0.0, 15.0)[:, 5]
    assert np.abs(np.diff(a_y)).max() <= 1.6 * LIMITS.lateral_jerk * T
    assert np.abs(a_y).max() <= 1.05 * LIMITS.lateral
    assert a_y[-1] == 0.0


def test_harder_braking_than_its_limit_is_immediate():
    target = NavigationTarget(LIMITS, T)
    target.start(-20.0, 0.0, SPEED, 0.0, 0.0)
    target.advance(0.0, SPEED, -1e3, -4.5)
    assert target.a_x == -4.5


def test_a_vehicle_that_falls_back_takes_its_target_along_but_not_across_the_road():
    target = NavigationTarget(LIMITS, T)
    target.start(0.0, 0.0, SPEED, 0.0, 0.0)
    target.change_to(3.5)
    for _ in range(600):
        target.fall_back(-7.0, 15.0, -2.0)
    assert (target.x, target.v_x, target.a_x) == (-7.0, 15.0, -2.0)
    assert (target.y, target.v_y, target.a_y) == (3.5, 0.0, 0.0)


@given(st.floats(0.0, 1.0))
def test_what_it_says_of_the_future_comes_true_while_the_acceleration_is_constant(seconds):
    target = NavigationTarget(LIMITS, T)
    target.start(0.0, 0.0, SPEED, 0.0, 0.0)
    target.change_to(7.0)
    cycles = round(seconds / T)
    told = target.ahead(cycles * T)
    for cycle in range(cycles):
        target.advance(SPEED * T * (cycle + 1), SPEED, -1e3, 1e3)
    assert told == pytest.approx((target.x, target.y, target.v_x, target.v_y, target.a_x, target.a_y), abs=1e-9)


def test_a_new_start_ends_the_lane_change():
    target = NavigationTarget(LIMITS, T)
    target.start(0.0, 0.0, SPEED, 0.0, 0.0)
    target.change_to(7.0)
    trail(target, 0.0, 1.0)
    target.start(1.0, 2.0, 19.0, 0.5, -1.0)
    assert not target.changing
    assert (target.x, target.y, target.v_x, target.v_y, target.a_x, target.a_y) == (1.0, 2.0, 19.0, 0.5, -1.0, 0.0)
