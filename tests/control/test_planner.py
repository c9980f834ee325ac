"""The planner: who takes which slot, references inside the boundaries always, and a platoon that forms."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.control.outcome import Limit
from bench.control.planner import (
    RESPONSE_S,
    Motion,
    Planner,
    PlannerOutput,
    PlatoonGoal,
    course_lag,
    slot_order,
)
from bench.control.settings import GeneticSettings, PlannerSettings, planning_cycles
from platoon_fmu.parameters import VehicleParameters

T = 0.01
GOAL = PlatoonGoal(lane_y=7.0, speed=20.0, gap=10.0)
SMALL_SEARCH = PlannerSettings(genetic=GeneticSettings(population=4, generations=1, horizon_steps=5))


def planner(
    number: int = 1, count: int = 3, seed: int = 1, chosen: PlannerSettings | None = None, goal: PlatoonGoal = GOAL
) -> Planner:
    return Planner(chosen or PlannerSettings(), goal, VehicleParameters(), number, count, seed, T)


def straight_on(X: float, Y: float, speed: float = 20.0) -> Motion:
    return Motion(X, Y, speed, 0.0, 0.0)


STARTS = {1: straight_on(8.0, 0.0, 20.0), 2: straight_on(0.0, 3.5, 22.0), 3: straight_on(-8.0, 0.0, 18.0)}


class Formation:
    """Vehicles that follow their planners' references exactly, as unicycles, and hear each other at once."""

    def __init__(
        self,
        starts: dict[int, Motion],
        goal: PlatoonGoal = GOAL,
        seed: int = 1,
        chosen: PlannerSettings | None = None,
    ) -> None:
        self.motion = dict(starts)
        self.planners = {n: planner(n, len(starts), seed, chosen, goal) for n in starts}
        for each in self.planners.values():
            each.assign_slots(starts, 0.0)
        self.outputs: list[dict[int, PlannerOutput]] = []
        self.path: list[dict[int, Motion]] = [self.motion]

    def run(self, seconds: float) -> None:
        for cycle in range(len(self.outputs), len(self.outputs) + round(seconds / T)):
            before = self.motion
            out = {
                n: each.step(cycle, cycle * T, before[n], before[n].speed, {m: before[m] for m in before if m != n})
                for n, each in self.planners.items()
            }
            self.motion = {n: self._follow(before[n], o) for n, o in out.items()}
            self.outputs.append(out)
            self.path.append(self.motion)

    @staticmethod
    def _follow(car: Motion, reference: PlannerOutput) -> Motion:
        way = T * reference.v_x
        return Motion(
            car.X + way * math.cos(car.course),
            car.Y + way * math.sin(car.course),
            reference.v_x,
            car.course + T * reference.yaw_rate,
            reference.yaw_rate,
        )

    def least_distance(self) -> float:
        numbers = sorted(self.motion)
        return min(
            math.hypot(now[a].X - now[b].X, now[a].Y - now[b].Y)
            for now in self.path
            for a in numbers
            for b in numbers
            if a < b
        )


@pytest.fixture(scope="module")
def formation() -> Formation:
    formed = Formation(STARTS)
    formed.run(8.0)
    return formed


def test_slots_follow_the_longitudinal_order() -> None:
    assert slot_order([(0.0, 0.0), (20.0, 3.5), (-5.0, 7.0)]) == [1, 0, 2]


def test_side_by_side_the_left_one_goes_first() -> None:
    assert slot_order([(0.0, 0.0), (0.0, 3.5), (0.0, -3.5)]) == [1, 0, 2]


def test_at_the_same_place_the_lower_number_goes_first() -> None:
    assert slot_order([(0.0, 0.0), (0.0, 0.0)]) == [0, 1]


def test_who_joins_a_platoon_under_way_has_its_slots() -> None:
    each = planner(2, chosen=SMALL_SEARCH)
    each.join(2, 500.0, 10.0)
    own = straight_on(440.0, 7.0)
    out = each.step(1000, 10.0, own, 20.0, {})
    assert (out.slot, out.leader_x) == (2, 500.0)
    # Its slot is 50 m ahead; it goes there as if it were 6 m, so that it does not come with too much speed.
    np.testing.assert_allclose(out.target, [446.0, 7.0])
    near = each.step(1001, 10.01, straight_on(489.0, 7.0), 20.0, {})
    np.testing.assert_allclose(near.target, [490.2, 7.0])


def test_falling_back_brakes_as_told_and_still_goes_to_the_lane() -> None:
    each = planner(2, chosen=SMALL_SEARCH)
    each.assign_slots(STARTS, 0.0)
    own, v = STARTS[2], 22.0
    for cycle in range(100):
        out = each.step(cycle, cycle * T, own, v, {}, 4.0)
        assert v - out.v_x == pytest.approx(4.0 * T)
        own, v = Formation._follow(own, out), out.v_x
    assert own.Y > 3.9


def test_falling_back_is_harder_further_back_and_harder_than_slowing_down() -> None:
    each = planner(1, count=3)
    brakings = [each.fall_back_braking(slot) for slot in (1, 2, 3)]
    assert brakings == [1.5, 2.0, 2.5]


def test_making_way_moves_the_target_ahead() -> None:
    each = planner(1, chosen=SMALL_SEARCH)
    each.assign_slots(STARTS, 0.0)
    assert each.step(1, 0.0, STARTS[1], 20.0, {}, None, 12.5).target[0] == 12.5
    assert each.step(2, 0.0, STARTS[1], 20.0, {}, None, 9.0).target[0] == pytest.approx(10.0)


def test_the_reference_does_not_run_away_from_a_vehicle_that_does_not_follow() -> None:
    each = planner(1, chosen=SMALL_SEARCH)
    each.assign_slots(STARTS, 0.0)
    for cycle in range(300):
        out = each.step(cycle, cycle * T, straight_on(8.0, 0.0, 12.0), 12.0, {})
    assert out.v_x <= 13.0 + 3.0 * T + 1e-9


def test_after_cycles_that_it_was_not_there_for_it_begins_with_the_own_motion() -> None:
    each = planner(1, chosen=SMALL_SEARCH)
    each.assign_slots(STARTS, 0.0)
    each.step(0, 0.0, STARTS[1], 20.0, {})
    own = Motion(100.0, 0.0, 14.0, 0.0, 0.1)
    out = each.step(300, 3.0, own, 14.0, {})
    assert out.v_x == pytest.approx(14.0, abs=3.0 * T + 1e-9)
    assert out.yaw_rate == pytest.approx(0.1, abs=1.5 * T + 1e-9)


def test_slowing_down_leaves_the_slot_and_keeps_it_in_mind() -> None:
    each = planner(2, chosen=SMALL_SEARCH)
    each.assign_slots(STARTS, 0.0)
    out = each.slow_down(0, 0.0, STARTS[2], 22.0)
    assert out.v_x == pytest.approx(22.0 - 1.5 * T)
    assert (out.slot, out.neighbours) == (2, 0)


coordinates = st.tuples(st.floats(-100, 100), st.floats(-10, 10))


@given(st.lists(coordinates, max_size=16))
def test_slots_are_a_permutation_in_which_nobody_overtakes(starts: list[tuple[float, float]]) -> None:
    slots = slot_order(starts)
    assert sorted(slots) == list(range(len(starts)))
    places = [starts[slots.index(slot)][0] for slot in range(len(starts))]
    assert places == sorted(places, reverse=True)


@settings(max_examples=30)
@given(st.lists(coordinates, min_size=2, max_size=6), st.floats(0, 5))
def test_all_planners_agree_on_the_slots(starts: list[tuple[float, float]], time_s: float) -> None:
    """Each works the slots out for itself; together they are all slots, a gap apart, about the vehicles' middle."""
    motions = {n: straight_on(*start) for n, start in enumerate(starts, start=1)}
    outputs = []
    for number in motions:
        each = planner(number, len(starts), chosen=SMALL_SEARCH)
        # The order in which the others were heard must not matter.
        each.assign_slots(dict(reversed(motions.items())) if number % 2 else motions, time_s)
        others = {n: m for n, m in motions.items() if n != number}
        outputs.append(each.step(1, time_s, motions[number], 20.0, others))
    assert sorted(out.slot for out in outputs) == list(range(1, len(starts) + 1))
    assert [out.slot - 1 for out in outputs] == slot_order(starts)
    targets = np.array([out.target for out in sorted(outputs, key=lambda out: out.slot)])
    np.testing.assert_allclose(np.diff(targets[:, 0]), -GOAL.gap, atol=1e-9)
    np.testing.assert_array_equal(targets[:, 1], GOAL.lane_y)
    assert targets[:, 0].mean() == pytest.approx(np.mean([X for X, _ in starts]), abs=1e-9)


def test_slots_move_at_the_platoons_speed() -> None:
    each = planner(1, chosen=SMALL_SEARCH)
    each.assign_slots(STARTS, 2.0)
    peers = {n: STARTS[n] for n in (2, 3)}
    first = each.step(1, 2.0, STARTS[1], 20.0, peers).target
    later = each.step(2, 5.0, STARTS[1], 20.0, peers).target
    np.testing.assert_allclose(first, [10.0, 7.0])
    np.testing.assert_allclose(np.subtract(later, first), [3.0 * 20.0, 0.0])


def test_until_slots_are_known_the_start_is_held() -> None:
    each = planner(2)
    assert not each.assigned
    outputs = [each.step(k, k * T, STARTS[2], 22.0, {}) for k in range(3)]
    for out in outputs:
        assert (out.v_x, out.yaw_rate, out.slot, out.limit) == (22.0, 0.0, 0, Limit.NONE)
        assert out.optimise_s == 0.0
    each.assign_slots(STARTS, 0.0)
    assert each.assigned


@pytest.mark.parametrize(("v_x", "reference"), [(2.0, 5.0), (60.0, 45.0), (17.5, 17.5)])
def test_first_reference_is_the_own_speed_inside_the_bounds(v_x: float, reference: float) -> None:
    assert planner().step(0, 0.0, straight_on(0.0, 0.0, v_x), v_x, {}).v_x == reference


wild = st.builds(
    Motion,
    st.floats(-1e3, 1e3),
    st.floats(-50, 50),
    st.floats(0, 60),
    st.floats(-math.pi, math.pi),
    st.floats(-1, 1),
)


@settings(max_examples=40)
@given(st.lists(wild, min_size=2, max_size=5), st.integers(0, 1000), st.floats(5, 45))
def test_references_stay_inside_the_boundaries_whatever_is_heard(heard: list[Motion], seed: int, v_x: float) -> None:
    chosen = SMALL_SEARCH
    motions = dict(enumerate(heard, start=1))
    each = planner(1, len(heard), seed, chosen)
    each.assign_slots(motions, 0.0)
    v = v_x
    grip = chosen.boundary_share * chosen.adhesion * 9.8
    for cycle in range(12):
        own = motions[1 + cycle % len(heard)]
        out = each.step(cycle, cycle * T, own, v_x, {n: m for n, m in motions.items() if n != 1})
        assert chosen.speed_min_mps <= out.v_x <= chosen.speed_max_mps
        gamma_max = 0.85 * chosen.adhesion * 9.8 / out.v_x
        assert abs(out.yaw_rate) <= chosen.boundary_share * gamma_max * (1 + 1e-9)
        assert out.margin == pytest.approx(1 - abs(out.yaw_rate) / gamma_max)
        # Some of these are on a collision course.
        most = chosen.emergency_braking_mps2 if out.v_x < v else chosen.acceleration_max_mps2
        assert abs(out.v_x - v) <= most * T + 1e-12
        assert math.hypot((out.v_x - v) / T, out.v_x * out.yaw_rate) <= grip * (1 + 1e-9)
        v = out.v_x


def test_gains_are_searched_at_every_planning_interval_and_held_between() -> None:
    formed = Formation(STARTS)
    formed.run(2.0)
    searched = [out[1].optimise_s > 0.0 for out in formed.outputs]
    assert searched == [k % 5 == 0 for k in range(200)]
    gains = np.array([out[1].gains for out in formed.outputs]).reshape(40, 5, 6)
    assert (gains == gains[:, :1]).all()
    assert len({block[0].tobytes() for block in gains}) > 1
    assert formed.outputs[-1][1].cost > 0


def test_gains_in_use_go_a_share_of_the_way_to_the_optimised_ones() -> None:
    lower, upper = GeneticSettings().bounds()
    middle = 0.5 * (lower + upper)

    def first_gains(share: float) -> np.ndarray:
        formed = Formation(STARTS, chosen=PlannerSettings(gain_share=share))
        formed.run(3.0)
        found = (np.array(gains) for out in formed.outputs for gains in [out[n].gains for n in out])
        return next(gains for gains in found if np.abs(gains - middle).max() > 0.01)

    optimised = first_gains(1.0)
    np.testing.assert_allclose(first_gains(0.25), middle + 0.25 * (optimised - middle), rtol=1e-12)


def deviation(lag_s: float, speed: float) -> float:
    """Return how far (m) a car is from its target at most, if its course is late by a multiple of its yaw rate."""
    each = planner(1, 1, goal=PlatoonGoal(lane_y=7.0, speed=speed, gap=10.0))
    X = Y = yaw = yaw_rate = most = 0.0
    each.assign_slots({1: Motion(X, Y, speed, 0.0, 0.0)}, 0.0)
    for cycle in range(600):
        course = yaw - lag_s * yaw_rate
        out = each.step(cycle, cycle * T, Motion(X, Y, speed, course, yaw_rate), speed, {})
        most = max(most, abs(each._navigation.y - Y - each.settings.near_identity_length_m * math.sin(course)))
        X, Y, yaw = X + T * speed * math.cos(course), Y + T * speed * math.sin(course), yaw + T * yaw_rate
        yaw_rate = out.yaw_rate
    return most


@pytest.mark.parametrize("speed", [20.0, 28.0])
def test_a_vehicle_follows_its_target_although_its_course_lags(speed: float, monkeypatch: pytest.MonkeyPatch) -> None:
    lag_s = course_lag(VehicleParameters(), speed) + RESPONSE_S
    with_lead = deviation(lag_s, speed)
    monkeypatch.setattr("bench.control.planner.course_lag", lambda *_: -RESPONSE_S)
    assert with_lead < 0.9 * deviation(lag_s, speed)


def test_the_course_lags_less_when_slow() -> None:
    lags = [course_lag(VehicleParameters(), speed) for speed in (1.0, 10.0, 15.0, 20.0, 30.0)]
    assert lags == sorted(lags)
    assert lags[0] == 0.0


def test_gains_in_use_are_always_ones_of_the_flocking_law() -> None:
    """0 < Ga <= Gb from the first cycle on, also where the middle of the bounds has it the other way round."""
    search = GeneticSettings(population=4, generations=1, horizon_steps=5, ga=(1.0, 5.0), gb=(0.5, 5.0))
    each = planner(1, chosen=PlannerSettings(genetic=search))
    each.assign_slots(STARTS, 0.0)
    lower, upper = search.bounds()
    for cycle in range(1, 30):
        gains = np.array(each.step(cycle, cycle * T, STARTS[1], 20.0, {n: STARTS[n] for n in (2, 3)}).gains)
        assert gains[1] >= gains[0]
        assert (gains >= lower).all()
        assert (gains <= upper).all()


def test_same_seed_gives_the_same_run_and_another_seed_another() -> None:
    def trace(seed: int) -> list[tuple[float, float]]:
        formed = Formation(STARTS, seed=seed)
        formed.run(1.5)
        return [(out[n].v_x, out[n].yaw_rate) for out in formed.outputs for n in out]

    assert trace(1) == trace(1)
    assert trace(1) != trace(2)


def test_order_in_which_the_others_are_told_does_not_matter() -> None:
    """Bit for bit, so that a run can be repeated. The vehicles are near each other."""
    places = [(0.0, 7.1), (9.3, 6.9), (-9.1, 7.3), (1.1, 16.3), (-0.7, -1.9)]
    close = {n: Motion(*place, 19.7 + 0.1 * n, 0.001 * n, 0.003 * n) for n, place in enumerate(places, start=1)}

    def references(numbers: list[int]) -> list[tuple[float, float]]:
        each = planner(1, 5, chosen=SMALL_SEARCH)
        each.assign_slots(close, 0.0)
        outputs = [each.step(k, k * T, close[1], 20.0, {n: close[n] for n in numbers}) for k in range(20)]
        return [(out.v_x, out.yaw_rate) for out in outputs]

    assert references([2, 3, 4, 5]) == references([5, 3, 4, 2])


def test_neighbours_are_those_within_reach() -> None:
    each = planner(1, chosen=SMALL_SEARCH)
    each.assign_slots(STARTS, 0.0)
    out = each.step(0, 0.0, straight_on(0.0, 0.0), 20.0, {2: straight_on(11.9, 0.0), 3: straight_on(12.1, 0.0)})
    assert out.neighbours == 1


def test_alone_a_vehicle_goes_to_the_lane() -> None:
    formed = Formation({1: straight_on(0.0, 0.0, 15.0)})
    formed.run(15.0)
    alone = formed.motion[1]
    np.testing.assert_allclose([alone.X, alone.Y, alone.speed], [15.0 * 20.0, 7.0, 20.0], atol=0.1)


def test_three_vehicles_form_the_platoon(formation: Formation) -> None:
    """The paper's manoeuvre: gaps and speed stand at 6 s and stay, and nobody comes near anybody."""
    for now in formation.path[600:]:
        gaps = [now[1].X - now[2].X, now[2].X - now[3].X]
        np.testing.assert_allclose(gaps, 10.0, atol=0.15)
        np.testing.assert_allclose([now[n].speed for n in now], 20.0, atol=0.1)
        np.testing.assert_allclose([now[n].Y for n in now], 7.0, atol=0.1)
        np.testing.assert_allclose([now[n].course for n in now], 0.0, atol=0.01)
        np.testing.assert_allclose([now[n].yaw_rate for n in now], 0.0, atol=0.02)
    assert formation.least_distance() > 4.0


def test_forming_keeps_inside_the_yaw_rate_boundary_and_uses_it(formation: Formation) -> None:
    use = [abs(out[n].yaw_rate) / (0.85 * 7.84 / out[n].v_x) for out in formation.outputs for n in out]
    assert 0.2 < max(use) <= 0.7 * (1 + 1e-9)


def test_mirrored_road_is_formed_on_as_well() -> None:
    starts = {n: straight_on(m.X, -m.Y, m.speed) for n, m in STARTS.items()}
    formed = Formation(starts, PlatoonGoal(lane_y=-7.0, speed=20.0, gap=10.0))
    formed.run(7.0)
    np.testing.assert_allclose([m.Y for m in formed.motion.values()], -7.0, atol=0.1)
    np.testing.assert_allclose(formed.motion[1].X - formed.motion[2].X, 10.0, atol=0.15)
    assert formed.least_distance() > 4.0


@pytest.mark.parametrize(("interval", "cycles"), [(0.01, 1), (0.05, 5), (0.3, 30), (1.0, 100)])
def test_planning_interval_in_cycles(interval: float, cycles: int) -> None:
    assert planning_cycles(interval, T) == cycles


@pytest.mark.parametrize("interval", [0.004, 0.015, 0.0, 0.051])
def test_planning_interval_that_is_no_multiple_is_refused(interval: float) -> None:
    with pytest.raises(ValueError, match=r"planning interval .* must be a multiple of the cycle, 0\.01 s"):
        planner(chosen=PlannerSettings(planning_interval_s=interval))


@pytest.mark.parametrize("wrong", [{"near_identity_length_m": 0.2}, {"near_identity_length_m": 1.0}])
def test_near_identity_length_must_suit_the_fastest_speed(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=r"near-identity length .* v T/2 = 0\.225 m"):
        planner(chosen=PlannerSettings(**wrong))


@given(wild, st.floats(0, 2))
def test_later_keeps_the_velocity(motion: Motion, time_s: float) -> None:
    later = motion.later(time_s)
    assert math.hypot(later.X - motion.X, later.Y - motion.Y) == pytest.approx(motion.speed * time_s, abs=1e-9)
    assert (later.speed, later.course, later.yaw_rate) == (motion.speed, motion.course, motion.yaw_rate)
    ahead = (later.X - motion.X) * math.cos(motion.course) + (later.Y - motion.Y) * math.sin(motion.course)
    assert ahead == pytest.approx(motion.speed * time_s, abs=1e-9)
