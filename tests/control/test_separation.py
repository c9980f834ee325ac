"""The distance to keep, against simulated braking: it is enough, and not more than needed."""

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from bench.control.separation import Separation
from platoon_fmu.parameters import BODY

BRAKING, RESPONSE, CLEARANCE = 5.0, 0.04, 1.2
SEPARATION = Separation(CLEARANCE, RESPONSE, BRAKING, 1.0, 1.0)
T = 1e-3

speeds = st.floats(1.0, 40.0)


def least_gap(distance: float, v_follower: float, v_leader: float) -> float:
    """The least gap between bodies while both brake to a standstill, the follower after the response."""
    least = gap = distance - BODY.length
    t, follower, leader = 0.0, v_follower, v_leader
    while follower > 0.0:
        follower_next = max(follower - BRAKING * T, 0.0) if t >= RESPONSE else follower
        leader_next = max(leader - BRAKING * T, 0.0)
        gap += 0.5 * T * (leader + leader_next - follower - follower_next)
        follower, leader, t = follower_next, leader_next, t + T
        least = min(least, gap)
    return least


@given(speeds, speeds, st.floats(0.0, 5.0))
def test_while_the_excess_is_positive_braking_keeps_the_clearance(v_follower, v_leader, excess):
    distance = BODY.length + CLEARANCE + v_follower * RESPONSE + max((v_follower**2 - v_leader**2) / (2 * BRAKING), 0.0)
    assert SEPARATION.excess(distance + excess, v_follower, v_leader) == pytest.approx(excess, abs=1e-9)
    assert least_gap(distance + excess, v_follower, v_leader) >= CLEARANCE - 0.01


@given(speeds, speeds)
def test_without_excess_the_clearance_is_just_kept_where_the_follower_is_faster(v_follower, v_leader):
    assume(v_follower >= v_leader)
    distance = BODY.length + CLEARANCE + v_follower * RESPONSE + (v_follower**2 - v_leader**2) / (2 * BRAKING)
    assert least_gap(distance, v_follower, v_leader) == pytest.approx(CLEARANCE, abs=0.02)


@given(speeds, speeds, st.floats(0.05, 30.0), st.floats(-BRAKING, 3.0))
def test_the_largest_acceleration_lets_the_excess_fall_at_its_rate(v_follower, v_leader, excess, a_leader):
    # Its derivative has a step where the speeds are equal.
    assume(abs(v_follower - v_leader) > 0.1)
    distance = BODY.length + CLEARANCE + v_follower * RESPONSE + max((v_follower**2 - v_leader**2) / (2 * BRAKING), 0.0)
    distance += excess
    a = SEPARATION.acceleration(distance, v_follower, v_leader, a_leader)
    h = 1e-6
    later = SEPARATION.excess(distance + h * (v_leader - v_follower), v_follower + h * a, v_leader + h * a_leader)
    assert (later - SEPARATION.excess(distance, v_follower, v_leader)) / h == pytest.approx(-excess, rel=1e-3, abs=1e-3)


def gap_at_equal_speeds(distance: float, closing: float, braking: float, a_leader: float) -> float:
    """The gap between bodies when a follower that brakes after the response is as slow as its leader."""
    gap, t = distance - BODY.length, 0.0
    while closing > 0.0:
        gap -= T * closing
        closing -= T * ((braking if t >= RESPONSE else 0.0) + (a_leader if t >= RESPONSE else 0.0))
        t += T
    return gap


@given(speeds, st.floats(0.5, 10.0), st.floats(6.0, 60.0), st.floats(-2.0, 2.0))
def test_the_needed_braking_just_keeps_the_clearance(v_leader, closing, distance, a_leader):
    needed = SEPARATION.needed(distance, v_leader + closing, v_leader, a_leader)
    assert 0.0 <= needed <= BRAKING
    if 0.0 < needed < BRAKING:
        gap = gap_at_equal_speeds(distance, closing, needed, a_leader)
        assert gap == pytest.approx(CLEARANCE, abs=0.02 * closing)


def test_who_is_not_faster_needs_no_braking_and_who_has_no_room_all_of_it():
    assert SEPARATION.needed(6.0, 20.0, 20.0, -3.0) == 0.0
    assert SEPARATION.needed(BODY.length + CLEARANCE, 21.0, 20.0, 0.0) == BRAKING


@pytest.mark.parametrize(
    ("corridors", "meet"),
    [
        ((0.0, 0.0, 3.5, 3.5), False),
        ((0.0, 7.0, 3.5, 3.5), True),
        ((0.0, 0.0, 7.0, 2.0), True),
        ((0.0, 0.0, 7.0, 2.9), False),
        ((7.0, 0.0, -3.5, -3.5), False),
        ((-3.5, -3.5, 7.0, 0.0), False),
        ((0.0, -3.5, 3.5, 7.0), False),
    ],
)
def test_corridors_meet_if_bodies_abreast_would_be_too_near(corridors, meet):
    assert SEPARATION.meet(*corridors) == meet
