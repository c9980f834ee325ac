"""Who may accelerate and who may change lanes, and platoons that form without contact from starts that invite it."""

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from bench.analysis.clearance import clearance
from bench.control.outcome import Limit
from bench.control.planner import Motion, Planner, PlannerOutput, PlatoonGoal
from bench.control.right_of_way import Place, RightOfWay
from bench.control.separation import Separation
from bench.control.settings import GeneticSettings, PlannerSettings
from platoon_fmu.parameters import BODY, VehicleParameters

T = 0.01
LANE_Y, SPEED = 7.0, 20.0
GENTLE, HARD = 2.8, 5.0
SEPARATION = Separation(1.2, 0.04, HARD, 1.0, 1.0)


def rules(others: dict[int, Place], staying: set[int]) -> RightOfWay:
    made = RightOfWay(SEPARATION, LANE_Y, GENTLE, T)
    made.hear(others, staying)
    return made


def needed(v_follower: float, v_leader: float) -> float:
    """The least distance between centres with a positive excess."""
    return -SEPARATION.excess(0.0, v_follower, v_leader)


def test_alone_nothing_holds_a_vehicle() -> None:
    own = Place(0.0, 0.0, SPEED)
    assert rules({}, set()).most(own, changing=True) > 100.0
    assert rules({}, set()).may_change(own, 0.0, [])


@pytest.mark.parametrize(
    ("other_y", "staying", "changing", "holds"),
    [
        (0.0, True, False, True),
        (3.5, True, False, False),
        (3.5, True, True, True),
        (-3.5, True, True, False),
        (-3.5, False, False, True),
        (3.5, False, False, False),
        (7.0, False, True, True),
    ],
)
def test_only_who_is_ahead_in_the_own_corridor_holds_it(
    other_y: float, staying: bool, changing: bool, holds: bool
) -> None:
    own = Place(0.0, 0.0, SPEED)
    ahead = rules({2: Place(6.3, other_y, SPEED)}, {2} if staying else set())
    assert (ahead.most(own, changing=changing) < 0.0) == holds
    behind = rules({2: Place(-6.3, other_y, SPEED)}, {2} if staying else set())
    assert behind.most(own, changing=changing) > 100.0


def test_braking_is_comfortable_as_long_as_that_keeps_the_clearance() -> None:
    own = Place(0.0, 0.0, SPEED)
    assert rules({2: Place(7.7, 0.0, SPEED - 3.0)}, {2}).most(own, changing=False) == -GENTLE
    nearer = rules({2: Place(7.3, 0.0, SPEED - 3.0)}, {2}).most(own, changing=False)
    assert nearer == -SEPARATION.needed(7.3, SPEED, SPEED - 3.0, 0.0)
    assert -HARD < nearer < -GENTLE
    assert rules({2: Place(7.0, 0.0, SPEED - 6.0)}, {2}).most(own, changing=False) == -HARD
    # The nearer of two decides.
    both = rules({2: Place(30.0, 0.0, SPEED), 3: Place(7.0, 0.0, SPEED - 6.0)}, {2, 3})
    assert both.most(own, changing=False) == -HARD


def test_who_is_ahead_leaves_the_one_behind_what_it_needs() -> None:
    own = Place(0.0, 0.0, SPEED)
    assert rules({}, set()).least(own, changing=False) < -100.0
    assert rules({2: Place(20.0, 0.0, SPEED + 4.0)}, {2}).least(own, changing=False) < -100.0
    for distance, closing in ((40.0, 3.0), (10.0, 3.0), (8.0, 4.0), (6.0, 4.0)):
        needed = SEPARATION.needed(distance, SPEED + closing, SPEED, 0.0)
        behind = rules({2: Place(-distance, 0.0, SPEED + closing)}, {2})
        assert behind.least(own, changing=False) == pytest.approx(min(needed - GENTLE, GENTLE))
        # In another lane it does not matter.
        assert rules({2: Place(-distance, 3.5, SPEED + closing)}, {2}).least(own, changing=False) < -100.0


def test_a_vehicle_ahead_that_brakes_is_noticed_within_cycles() -> None:
    own = Place(0.0, 0.0, SPEED)
    made = RightOfWay(SEPARATION, LANE_Y, GENTLE, T)
    distance = needed(SPEED, SPEED - 0.5) + 0.2
    found = []
    for cycle in range(40):
        made.hear({2: Place(distance, 0.0, SPEED - 0.5 - 0.03 * cycle * 0.1)}, {2})
        found.append(made.most(own, changing=False))
    assert found[-1] < found[0]


def test_a_lane_change_waits_for_who_is_abreast_or_too_near() -> None:
    own = Place(0.0, 0.0, SPEED)
    enough = needed(SPEED, SPEED)
    for x, may in (
        (0.0, False),
        (enough - 0.1, False),
        (enough + 0.1, True),
        (0.1 - enough, False),
        (-enough - 0.1, True),
    ):
        assert rules({2: Place(x, 3.5, SPEED)}, {2}).may_change(own, 0.0, []) == may


def test_who_closes_in_too_fast_is_let_by() -> None:
    own = Place(0.0, 0.0, SPEED)
    distance = needed(SPEED + 4.0, SPEED) + 0.1
    # The excess is positive, but the other one would have to brake hard.
    assert not rules({2: Place(-distance, 7.0, SPEED + 4.0)}, set()).may_change(own, 0.0, [])
    assert rules({2: Place(-distance - 15.0, 7.0, SPEED + 4.0)}, set()).may_change(own, 0.0, [])


def test_those_with_a_slot_further_ahead_may_begin_at_any_time_and_the_others_wait() -> None:
    own = Place(0.0, 3.5, SPEED)
    beside = rules({2: Place(1.0, 10.5, SPEED)}, {2})
    assert not beside.may_change(own, 0.0, [2])
    assert beside.may_change(own, 0.0, [])
    # If it has begun already, its slot does not matter.
    assert not rules({2: Place(1.0, 10.5, SPEED)}, set()).may_change(own, 0.0, [])


places = st.builds(Place, st.floats(-60.0, 60.0), st.sampled_from([-3.5, 0.0, 3.5, 7.0, 10.5]), st.floats(12.0, 28.0))


@given(places, places)
def test_two_never_begin_at_once_without_room_for_both(one: Place, other: Place) -> None:
    """By the first slots: of each pair one has its slot further ahead."""
    begins = rules({2: other}, {2}).may_change(one, 0.0, [])
    other_begins = rules({1: one}, {1}).may_change(other, 0.0, [1])
    assume(begins and other_begins)
    behind, before = sorted((one, other), key=lambda place: place.X)
    assert SEPARATION.excess(before.X - behind.X, behind.v_x, before.v_x) >= 0.0


class Traffic:
    """Vehicles that follow their planners' references exactly, as unicycles, and hear each other a cycle later."""

    def __init__(self, starts: list[tuple[float, float, float]], goal: PlatoonGoal) -> None:
        self.goal = goal
        self.motion = {n: Motion(X, Y, v, 0.0, 0.0) for n, (X, Y, v) in enumerate(starts, start=1)}
        chosen = PlannerSettings(genetic=GeneticSettings(population=4, generations=1, horizon_steps=5))
        self.planners = {n: Planner(chosen, goal, VehicleParameters(), n, len(starts), 1, T) for n in self.motion}
        for each in self.planners.values():
            each.assign_slots(self.motion, 0.0)
        self.heard, self.staying = self.motion, set(self.motion)
        self.path = [self.motion]
        self.outputs: list[dict[int, PlannerOutput]] = []

    def run(self, seconds: float) -> None:
        for cycle in range(round(seconds / T)):
            now, heard, staying = self.motion, self.heard, self.staying
            self.heard = {n: motion.later(T) for n, motion in now.items()}
            self.staying = {n for n, each in self.planners.items() if not each.changing}
            out = {
                n: each.step(
                    *(cycle, cycle * T, now[n], now[n].speed, {m: heard[m] for m in now if m != n}), staying=staying
                )
                for n, each in self.planners.items()
            }
            self.motion = {
                n: Motion(
                    now[n].X + T * o.v_x * math.cos(now[n].course),
                    now[n].Y + T * o.v_x * math.sin(now[n].course),
                    o.v_x,
                    now[n].course + T * o.yaw_rate,
                    o.yaw_rate,
                )
                for n, o in out.items()
            }
            self.path.append(self.motion)
            self.outputs.append(out)

    def least_clearance(self) -> float:
        columns = {n: np.array([(now[n].X, now[n].Y, now[n].course) for now in self.path[::5]]).T for n in self.motion}
        return min(
            float(clearance(b[0] - a[0], b[1] - a[1], a[2], b[2]).min())
            for n, a in columns.items()
            for m, b in columns.items()
            if n < m
        )

    def formed(self) -> bool:
        X = sorted(motion.X for motion in self.motion.values())
        gaps = np.diff(X)
        return (
            all(abs(motion.Y - self.goal.lane_y) < 0.2 for motion in self.motion.values())
            and all(abs(motion.speed - self.goal.speed) < 0.2 for motion in self.motion.values())
            and bool((np.abs(gaps - self.goal.gap) < 0.5).all())
        )


SMALL = [(0.0, 0.0, 12.0), (-5.0, 3.5, 15.0)]


@pytest.mark.parametrize(
    "starts",
    [SMALL, [*SMALL, (-13.0, 0.0, 17.0)], [*SMALL, (-13.0, 0.0, 17.0), (-18.0, 3.5, 17.0), (-30.0, 0.0, 14.0)]],
)
def test_those_who_met_while_everybody_moved_at_once_keep_clear(starts: list[tuple[float, float, float]]) -> None:
    traffic = Traffic(starts, PlatoonGoal(lane_y=-3.5, speed=15.0, gap=14.5))
    traffic.run(15.0)
    assert traffic.least_clearance() >= 1.0
    assert traffic.formed()


@pytest.mark.parametrize("lane", [-1, 0, 1, 2])
@pytest.mark.parametrize("count", [2, 3])
def test_vehicles_abreast_at_equal_speeds_do_not_wait_for_each_other_for_ever(count: int, lane: int) -> None:
    traffic = Traffic([(0.0, 3.5 * n, SPEED) for n in range(count)], PlatoonGoal(3.5 * lane, SPEED, 10.0))
    traffic.run(12.0)
    assert traffic.least_clearance() >= 1.0
    assert traffic.formed()


def test_sixteen_abreast_form_a_platoon() -> None:
    traffic = Traffic([(0.0, 3.5 * n, SPEED) for n in range(16)], PlatoonGoal(3.5 * 8, SPEED, 10.0))
    traffic.run(22.0)
    assert traffic.least_clearance() >= 1.0
    assert traffic.formed()


@settings(max_examples=25, deadline=None)
@given(
    st.lists(
        st.tuples(st.floats(9.0, 18.0), st.sampled_from([0.0, 3.5]), st.floats(-3.0, 3.0)), min_size=2, max_size=5
    ),
    st.sampled_from([-7.0, -3.5, 0.0, 3.5, 7.0]),
    st.floats(12.0, 28.0),
    st.floats(8.0, 15.0),
)
def test_any_platoon_forms_without_contact(
    vehicles: list[tuple[float, float, float]], lane_y: float, speed: float, gap: float
) -> None:
    X, starts = 0.0, []
    for distance, Y, faster in vehicles:
        starts.append((X, Y, speed + faster))
        X -= distance
    traffic = Traffic(starts, PlatoonGoal(lane_y, speed, gap))
    least = traffic.least_clearance()
    traffic.run(15.0)
    assert traffic.least_clearance() >= min(1.0, least) - 1e-6
    assert traffic.formed()


def test_it_is_said_when_the_distance_decides() -> None:
    """Two in one lane, the second five metres per second faster and a fifth of a second behind the first's bumper."""
    traffic = Traffic(
        [(0.0, LANE_Y, SPEED), (-(BODY.length + 5.0), LANE_Y, SPEED + 5.0)], PlatoonGoal(LANE_Y, SPEED, 10.0)
    )
    traffic.run(5.0)
    limits = [out[2].limit for out in traffic.outputs]
    assert Limit.HARD_BRAKING in limits
    assert Limit.CLEARANCE in limits
    assert traffic.least_clearance() >= 1.0
    assert {out[1].limit for out in traffic.outputs}.isdisjoint({Limit.CLEARANCE, Limit.HARD_BRAKING})
    quiet = Traffic([(0.0, LANE_Y, SPEED), (-30.0, LANE_Y, SPEED)], PlatoonGoal(LANE_Y, SPEED, 30.0))
    quiet.run(3.0)
    assert {out[n].limit for out in quiet.outputs for n in out} == {Limit.NONE}


@pytest.mark.parametrize(
    ("slot_ahead", "x", "may"), [(True, 40.0, True), (True, -40.0, False), (False, -40.0, True), (False, 40.0, False)]
)
def test_nobody_changes_lanes_beside_who_may_be_anywhere(slot_ahead: bool, x: float, may: bool) -> None:
    """Of who is not heard only a bound is known: the rearmost place if its slot is further ahead, else the foremost."""
    own = Place(0.0, 3.5, SPEED)
    made = RightOfWay(SEPARATION, LANE_Y, GENTLE, T)
    made.hear({2: Place(x, LANE_Y, SPEED)}, set(), {2})
    assert made.may_change(own, 0.0, [2] if slot_ahead else []) == may
    made.hear({2: Place(x, LANE_Y, SPEED)}, set())
    assert made.may_change(own, 0.0, [2] if slot_ahead else [])
