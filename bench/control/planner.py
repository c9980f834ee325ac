# cython: boundscheck=False, wraparound=False
"""The planning level: one vehicle's reference from its own state and the others' broadcasts.

Slots d apart behind the leader slot move at the platoon's speed along the platoon's lane (Fig. 4, "target projection").
Slots follow the longitudinal order of the vehicles at the start, so that no vehicle has to overtake. The leader slot
starts where the centre of the slots is the centre of the vehicles, which minimises the total displacement. Every
vehicle computes both from the same first broadcasts, with the same result.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from time import perf_counter
from typing import NamedTuple

import cython

from bench.control.boundaries import boundaries
from bench.control.genetic import search
from bench.control.navigation import MotionLimits
from bench.control.outcome import Limit
from bench.control.ramp import STEEPNESS
from bench.control.random_numbers import mixed
from bench.control.right_of_way import Place, RightOfWay
from bench.control.separation import Separation
from bench.control.settings import PlannerSettings, check_length, planning_cycles
from bench.control.slow_down import slow_down
from platoon_fmu.parameters import VehicleParameters

if cython.compiled:
    from cython.cimports.bench.control.boundaries import Boundaries, admissible, yaw_rate_max
    from cython.cimports.bench.control.flocking import Field, Gains, Neighbours, acceleration
    from cython.cimports.bench.control.genetic import Breeding, Rollout, Situation
    from cython.cimports.bench.control.navigation import NavigationTarget
    from cython.cimports.bench.control.near_identity import input_rates, point, velocity
    from cython.cimports.bench.control.ramp import Ramp
    from cython.cimports.libc.math import cos, sin
else:
    from math import cos, sin

    from bench.control.boundaries import Boundaries, admissible, yaw_rate_max
    from bench.control.flocking import Field, Gains, Neighbours, acceleration
    from bench.control.genetic import Breeding, Rollout, Situation
    from bench.control.navigation import NavigationTarget
    from bench.control.near_identity import input_rates, point, velocity
    from bench.control.ramp import Ramp

_LIMITS = tuple(Limit)

FOLLOWS_MPS = 1.0
"""Largest difference (m/s) between reference and own speed, so that the reference cannot run away from a vehicle that
does not follow; normal tracking errors are ten times smaller."""

RESUMED_CYCLES = 5
"""Number of missed cycles after which a planner restarts from the own motion."""

LEFT_M = (2.0, 1.0)
"""Distance along and across the road (m, m) from its navigation target at which a vehicle gets a new one."""

RESPONSE_S = 0.04
"""Time (s) from another vehicle's braking to the own: a cycle each of broadcast, planner, tracker and actuators."""

CLOSING_RATE = 1.0
"""kappa (1/s): the rate at which the distance to a vehicle ahead may approach the least one."""

CALM = 0.65
"""kappa times the time in which the comfortable braking builds up, at most."""

ASIDE_M = 1.0
"""Clearance (m) between the corridors of vehicles that are abreast in neighbouring lanes."""

TARGET_SHARE = 0.88
"""Fraction of the comfort limits for the navigation target; the flocking law and the tracker need the remainder."""

REFERENCE_SHARE = 0.95
"""Fraction of the accelerations of comfort for the reference; the tracker needs the remainder."""

JERK_SHARE = 0.9
"""Fraction of the jerks for both: a car that coasts has an acceleration before its first reference."""

TARGET_BOUNDARY_SHARE = 0.8
"""Fraction of the yaw rate's boundary for the navigation target."""

REFERENCE_BOUNDARY_SHARE = 0.95
"""Fraction of the yaw rate's boundary for the reference, which corrects what the vehicle's side slip leaves."""

BRISK_JERK_MPS3 = 20.0
"""Jerk (m/s^3) without comfort limits."""

JOINING_S = 3.0
"""Time (s) in which the others come to count in the flocking law after a lane change has begun."""

REJOINED_M = 2.0
"""Distance (m) to its slot at which a vehicle has rejoined."""


@dataclass(frozen=True)
class PlatoonGoal:
    """The platoon to form.

    Attributes:
        lane_y: lateral position of the platoon's lane, m.
        speed: m/s.
        gap: distance d between the centres of mass of successive vehicles, m.
    """

    lane_y: float
    speed: float
    gap: float


class Motion(NamedTuple):
    """A vehicle's planar motion as known to its neighbours.

    Attributes:
        X: position of the centre of mass along the road, m.
        Y: position to the left, m.
        speed: of the centre of mass, m/s.
        course: direction of motion in the road frame, rad.
        yaw_rate: rad/s.
    """

    X: float
    Y: float
    speed: float
    course: float
    yaw_rate: float

    def later(self, time_s: float) -> "Motion":
        """Return the motion `time_s` seconds later at constant velocity."""
        way = self.speed * time_s
        return Motion(
            self.X + way * cos(self.course),
            self.Y + way * sin(self.course),
            self.speed,
            self.course,
            self.yaw_rate,
        )


class PlannerOutput(NamedTuple):
    """One step of the planner.

    Attributes:
        v_x: reference speed of the next cycle, m/s.
        yaw_rate: reference yaw rate of the next cycle, rad/s.
        limit: the active boundary.
        margin: 1 - |gamma| / gamma_max of the reference.
        slot: from 1 at the head; 0 before slots are assigned.
        target: slot position now, m, m.
        neighbours: number of vehicles within reach.
        gains: (6,) Lambda in use.
        cost: of the last search.
        leader_x: current position of the foremost slot, m; 0 before slots are assigned.
        optimise_s: wall-clock time of this step's search, s; 0 without a search.
    """

    v_x: float
    yaw_rate: float
    limit: Limit
    margin: float
    slot: int
    target: tuple[float, float]
    neighbours: int
    gains: tuple[float, ...]
    cost: float
    leader_x: float
    optimise_s: float


def slot_order(starts: Sequence[tuple[float, float]]) -> list[int]:
    """Return each vehicle's slot, from 0 at the head, by longitudinal order; of two abreast, the left one is first."""
    order = sorted(range(len(starts)), key=lambda i: (-starts[i][0], -starts[i][1], i))
    slots = [0] * len(starts)
    for slot, vehicle in enumerate(order):
        slots[vehicle] = slot
    return slots


def coasting(vehicle: VehicleParameters, v_x: float) -> float:
    """Return the deceleration (m/s^2) of a vehicle that rolls freely, as before its first reference."""
    return vehicle.mu_d * vehicle.g + vehicle.C_a * v_x * v_x / vehicle.M


def course_lag(vehicle: VehicleParameters, speed: float) -> float:
    """Return the time (s) by which a vehicle's course lags behind its yaw, with the softest tyres expected.

    The course angle is yaw plus side slip. In steady cornering the side-slip angle is -lag times the yaw rate, with
    lag = M l_f v / (2 C_r (l_f + l_r)) - l_r / v: the rear tyres' slip angle less that of turning about the rear axle.
    """
    rear_stiffness = 2.0 * vehicle.C_r * (1.0 - vehicle.cornering_variation)
    wheelbase = vehicle.l_f + vehicle.l_r
    return max(vehicle.M * vehicle.l_f * speed / (rear_stiffness * wheelbase) - vehicle.l_r / speed, 0.0)


class Planner:
    """Plans one vehicle's speed and yaw-rate reference.

    Attributes:
        settings: of the planner.
        slots: the slot, from 1 at the head, of each vehicle by number; empty before they are known.

    Args:
        settings: of the planner.
        goal: the platoon to form.
        vehicle: nominal parameters, for the boundaries.
        number: this vehicle's number, from 1.
        count: number of vehicles.
        seed: seed of the search; together with number and interval it determines all random numbers.
        step_s: cycle time T, s.

    Raises:
        ValueError: the near-identity length does not fit the highest speed, or the interval is not a multiple of T.
    """

    def __init__(
        self,
        settings: PlannerSettings,
        goal: PlatoonGoal,
        vehicle: VehicleParameters,
        number: int,
        count: int,
        seed: int,
        step_s: float,
    ) -> None:
        check_length(settings.near_identity_length_m, settings.speed_max_mps, step_s)
        self.settings = settings
        self._goal = goal
        self._number = number
        self._count = count
        self._seed = seed
        self._step_s = step_s
        self._interval = planning_cycles(settings.planning_interval_s, step_s)
        self._length = settings.near_identity_length_m
        self._limits = self._boundaries(vehicle, settings.acceleration_max_mps2)
        self._emergency_limits = self._boundaries(
            vehicle, max(settings.emergency_braking_mps2, settings.acceleration_max_mps2)
        )
        self._field = Field(settings.sigma_eps, goal.gap, settings.reach_factor * goal.gap, settings.bump_flat)
        genetic = settings.genetic
        self._breeding = Breeding(genetic)
        self._rollout = Rollout(
            self._field,
            self._limits,
            self._length,
            genetic.weights(),
            genetic.horizon_steps,
            genetic.horizon_step_s,
        )
        self._best: tuple[float, ...] = self._breeding.middle()
        self._gains = self._best
        self._law = Gains(self._gains)
        self._cost = 0.0
        self._others = Neighbours(0)
        self._reference: tuple[float, float] | None = None
        self._slot: int | None = None
        self._leader_start = 0.0
        self._leader_time = 0.0
        self._rejoining = False
        self._cycle: int | None = None
        self.slots: dict[int, int] = {}
        target, self._comfort = (
            self._motion_limits(TARGET_SHARE, TARGET_BOUNDARY_SHARE),
            self._motion_limits(REFERENCE_SHARE, REFERENCE_BOUNDARY_SHARE),
        )
        self._navigation: NavigationTarget = NavigationTarget(
            target, step_s, course_lag(vehicle, goal.speed) + RESPONSE_S
        )
        self._navigates = False
        self._vehicle = vehicle
        self._acceleration: Ramp = Ramp(self._comfort.longitudinal_jerk, step_s)
        build_up_s = self._comfort.longitudinal / self._comfort.longitudinal_jerk
        hardest = min(self._emergency_limits.acceleration_max, self._emergency_limits.share * self._limits.mu_g)
        self._right_of_way = RightOfWay(
            Separation(settings.clearance_m, RESPONSE_S, hardest, min(CLOSING_RATE, CALM / build_up_s), ASIDE_M),
            goal.lane_y,
            self._comfort.longitudinal,
            step_s,
        )

    def _motion_limits(self, share: float, boundary_share: float) -> MotionLimits:
        """Return the limits of motions: a fraction of those for comfort, and of the stability boundaries."""
        comfort, boundaries = self.settings.comfort, self._limits
        lateral = boundary_share * boundaries.share * boundaries.lateral_max
        longitudinal = boundaries.acceleration_max
        if not comfort.enabled:
            return MotionLimits(lateral, BRISK_JERK_MPS3, longitudinal, BRISK_JERK_MPS3)
        return MotionLimits(
            min(lateral, share * comfort.lateral_acceleration_mps2),
            comfort.lateral_jerk_mps3,
            min(longitudinal, share * comfort.longitudinal_acceleration_mps2),
            JERK_SHARE * comfort.longitudinal_jerk_mps3,
        )

    def _boundaries(self, vehicle: VehicleParameters, acceleration_max: float) -> Boundaries:
        settings = self.settings
        return boundaries(
            vehicle,
            settings.adhesion,
            settings.boundary_share,
            acceleration_max,
            settings.yaw_acceleration_max_radps2,
            settings.speed_min_mps,
            settings.speed_max_mps,
        )

    def assign_slots(self, starts: Mapping[int, Motion], time_s: float) -> None:
        """Assign slots and the start of the leader slot from the positions of all vehicles (by number) at `time_s`."""
        numbers = sorted(starts)
        slots = slot_order([(starts[n].X, starts[n].Y) for n in numbers])
        self._slot = slots[numbers.index(self._number)]
        middle = sum(starts[n].X for n in numbers) / len(numbers)
        self._leader_start = middle + 0.5 * (len(numbers) - 1) * self._goal.gap
        self._leader_time = time_s
        self.slots = {number: slot + 1 for number, slot in zip(numbers, slots, strict=True)}

    def join(self, slot: int, leader_x: float, time_s: float, slots: Mapping[int, int] | None = None) -> None:
        """Take a slot (from 1) in an existing platoon whose foremost slot is at `leader_x` (m) at `time_s`.

        The others' slots (from 1), by number, are taken.
        """
        self._slot = slot - 1
        self.slots = {**(slots or {}), self._number: slot}
        self._leader_start, self._leader_time = leader_x, time_s
        self._rejoining = True

    @property
    def assigned(self) -> bool:
        """Whether slots have been assigned."""
        return self._slot is not None

    def fall_back_braking(self, slot: int) -> float:
        """Return the braking (m/s^2) with which a vehicle in a slot (from 1) opens the gap: harder towards the tail.

        So consecutive vehicles that all fall back separate, and all brake harder than a vehicle that slows down in its
        lane.
        """
        gentle = self.settings.slow_down_mps2
        hard = max(gentle, self.settings.acceleration_max_mps2)
        return gentle + (hard - gentle) * (slot - 1) / max(self._count, 1)

    def slow_down(self, cycle: int, time_s: float, own: Motion, v_x: float) -> PlannerOutput:
        """Run one cycle of leaving the platoon: slow down in the lane."""
        v, gamma = self._resumed(cycle, v_x, own.yaw_rate)
        self._rejoining = self._slot is not None
        self._navigates = False
        self._navigation.changing = False
        v, gamma = slow_down(
            v, gamma, own.course, self.settings.slow_down_mps2, self.settings.speed_min_mps, self._step_s
        )
        self._reference = (v, gamma)
        return self._output(v, gamma, Limit.NONE, (own.X, own.Y), 0, self._leader_x(time_s), 0.0)

    def step(
        self,
        cycle: int,
        time_s: float,
        own: Motion,
        v_x: float,
        peers: Mapping[int, Motion],
        braking: float | None = None,
        make_way_x: float | None = None,
        staying: Collection[int] = (),
        unheard: Collection[int] = (),
    ) -> PlannerOutput:
        """Run one cycle: optimise at the start of an interval, then advance the reference by (15).

        Args:
            cycle: number of the cycle.
            time_s: s.
            own: own motion now.
            v_x: own longitudinal velocity now, from which the first reference starts, m/s.
            peers: the others' motion now, by number.
            braking: braking (m/s^2) to fall back from an untrusted vehicle ahead; None to keep the slot.
            make_way_x: minimum X (m) to keep clear of a vehicle approaching from behind; None for no minimum.
            staying: numbers of the others that stay in their own lanes for now.
            unheard: numbers of the others whose motion is assumed, see `RightOfWay.hear`.
        """
        v: cython.double
        gamma: cython.double
        v, gamma = self._resumed(cycle, v_x, own.yaw_rate)
        if self._slot is None:
            return self._output(v, gamma, Limit.NONE, (own.X, own.Y), 0, 0.0, 0.0)

        leader_x = self._leader_x(time_s)
        target = self._target(leader_x, own, make_way_x, falling_back=braking is not None)
        X: cython.double = own.X
        Y: cython.double = own.Y
        c: cython.double = cos(own.course)
        s: cython.double = sin(own.course)
        length: cython.double = self._length
        q_x: cython.double
        q_y: cython.double
        p_x: cython.double
        p_y: cython.double
        q_x, q_y = point(X, Y, c, s, length)
        p_x, p_y = velocity(c, s, v, gamma, length)

        place = Place(X, Y, own.speed * c)
        self._right_of_way.hear(
            {n: Place(m.X, m.Y, m.speed * cos(m.course)) for n, m in peers.items()}, staying, unheard
        )
        navigation: NavigationTarget = self._navigation
        self._navigate(q_x, q_y, p_x, p_y, place)
        most: cython.double = self._right_of_way.most(place, changing=navigation.changing)
        if braking is None:
            least: cython.double = self._right_of_way.least(place, changing=navigation.changing)
            navigation.advance(target[0] + length, self._goal.speed, least, most)
        else:
            most = min(most, -braking)
            navigation.fall_back(q_x, p_x, most)

        neighbours: Neighbours = self._neighbours(peers)
        neighbours.weight = min(navigation.changing_s / JOINING_S, 1.0)
        optimise_s = 0.0
        if cycle % self._interval == 0 and braking is None:
            begin = perf_counter()
            horizon = [navigation.ahead(k * self._rollout.step_s) for k in range(self._rollout.steps)]
            situation = Situation(X, Y, c, s, v, gamma, chain.from_iterable(horizon), neighbours)
            self._optimise(cycle // self._interval, situation)
            optimise_s = perf_counter() - begin

        u_x: cython.double
        u_y: cython.double
        v_rate: cython.double
        gamma_rate: cython.double
        field: Field = self._field
        u_x, u_y = acceleration(
            q_x,
            q_y,
            p_x,
            p_y,
            neighbours,
            navigation.x,
            navigation.y,
            navigation.v_x,
            navigation.v_y,
            self._law,
            field,
        )
        v_rate, gamma_rate = input_rates(c, s, v, gamma, length, u_x + navigation.a_x, u_y + navigation.a_y)
        bound: cython.int
        v, gamma, bound = self._limited(v, gamma, v_rate, gamma_rate, most)
        self._reference = (v, gamma)
        near = neighbours.within(q_x, q_y, field.reach)
        return self._output(v, gamma, _LIMITS[bound], target, near, leader_x, optimise_s)

    def _navigate(self, q_x: float, q_y: float, p_x: float, p_y: float, own: Place) -> None:
        """Give the vehicle a navigation target where it has none or has left it, and begin the lane change."""
        navigation: NavigationTarget = self._navigation
        left = abs(navigation.x - q_x) > LEFT_M[0] or abs(navigation.y - q_y) > LEFT_M[1]
        if left or not self._navigates:
            changing = navigation.changing
            navigation.start(q_x, q_y, p_x, p_y, self._acceleration.value)
            self._navigates = True
            if changing:
                navigation.change_to(self._goal.lane_y)
        if navigation.changing:
            return
        ahead = [number for number, slot in self.slots.items() if slot < self.slots[self._number]]
        if self._right_of_way.may_change(own, navigation.a_x, ahead):
            navigation.change_to(self._goal.lane_y)

    def _limited(
        self, v: float, gamma: float, v_rate: float, gamma_rate: float, most: float
    ) -> tuple[float, float, int]:
        """Return the next reference (m/s, rad/s) within all limits, and the number of the decisive `Limit`.

        Args:
            v: this cycle's reference speed, m/s.
            gamma: this cycle's reference yaw rate, rad/s.
            v_rate: requested dv/dt, m/s^2.
            gamma_rate: requested dgamma/dt, rad/s^2.
            most: largest acceleration that keeps clear of others, m/s^2.
        """
        comfort = self._comfort
        limits: Boundaries = self._limits
        hard = most < -comfort.longitudinal
        held = most < v_rate
        if hard or self._acceleration.value < -comfort.longitudinal:
            limits = self._emergency_limits
        if hard:
            v_rate = most
            self._acceleration.put(v_rate)
        else:
            v_rate = min(max(min(v_rate, most), -comfort.longitudinal), comfort.longitudinal)
            v_rate = self._acceleration.towards(v_rate)
        swing = STEEPNESS * comfort.lateral_jerk / v
        largest = comfort.lateral / v
        gamma_rate = min(max(gamma_rate, -swing), swing)
        gamma_rate = min(max(gamma_rate, (-largest - gamma) / self._step_s), (largest - gamma) / self._step_s)
        v, gamma, bound = admissible(v, gamma, v_rate, gamma_rate, self._step_s, limits)
        if hard:
            bound = Limit.HARD_BRAKING
        elif held and (bound == Limit.NONE or bound == Limit.ACCELERATION):
            bound = Limit.CLEARANCE
        return v, gamma, bound

    @property
    def changing(self) -> bool:
        """Whether the vehicle is on its way to the platoon's lane, or there; before, it stays in its own lane."""
        return bool(self._navigation.changing)

    def _resumed(self, cycle: int, v_x: float, yaw_rate: float) -> tuple[float, float]:
        """Return the reference to continue from: the last one if it was followed, otherwise the own motion."""
        expected, self._cycle = self._cycle, cycle + 1
        lowest, highest = self._limits.speed_min, self._limits.speed_max
        if self._reference is None:
            self._reference = (min(max(v_x, lowest), highest), 0.0)
            self._acceleration.reset(-coasting(self._vehicle, v_x))
        elif expected is not None and cycle - expected >= RESUMED_CYCLES:
            self._reference = (min(max(v_x, lowest), highest), yaw_rate)
        v, gamma = self._reference
        v = min(max(v, v_x - FOLLOWS_MPS), v_x + FOLLOWS_MPS)
        return min(max(v, lowest), highest), gamma

    def _leader_x(self, time_s: float) -> float:
        return self._leader_start + self._goal.speed * (time_s - self._leader_time)

    def _target(
        self, leader_x: float, own: Motion, make_way_x: float | None, *, falling_back: bool
    ) -> tuple[float, float]:
        """Return the target: the slot; only laterally while falling back, and approached slowly afterwards."""
        slot_x = leader_x - (self._slot or 0) * self._goal.gap
        if make_way_x is not None and make_way_x > slot_x:
            slot_x = make_way_x
            self._rejoining = True
        error = slot_x - own.X
        if falling_back:
            self._rejoining = True
            return own.X, self._goal.lane_y
        if abs(error) < REJOINED_M:
            self._rejoining = False
        if self._rejoining:
            most = self.settings.rejoin_error_m
            slot_x = own.X + min(max(error, -most), most)
        return slot_x, self._goal.lane_y

    def _neighbours(self, peers: Mapping[int, Motion]) -> Neighbours:
        """Return the others' points S and velocities W, in order of their numbers."""
        if self._others.count != len(peers):
            self._others = Neighbours(len(peers))
        others: Neighbours = self._others
        length: cython.double = self._length
        q_x: cython.double
        q_y: cython.double
        p_x: cython.double
        p_y: cython.double
        for place, number in enumerate(sorted(peers)):
            X, Y, speed, course, yaw_rate = peers[number]
            c: cython.double = cos(course)
            s: cython.double = sin(course)
            q_x, q_y = point(X, Y, c, s, length)
            p_x, p_y = velocity(c, s, speed, yaw_rate, length)
            others.put(place, q_x, q_y, p_x, p_y)
        return others

    def _optimise(self, interval: int, situation: Situation) -> None:
        """Search for better gains, and move the gains in use towards them."""
        seed = mixed(self._seed, self._number, interval)
        self._best, self._cost = search(self._best, seed, self._breeding, situation, self._rollout)
        share = self.settings.gain_share
        self._gains = tuple([used + share * (best - used) for used, best in zip(self._gains, self._best, strict=True)])
        self._law = Gains(self._gains)

    def _output(
        self,
        v: float,
        gamma: float,
        limit: Limit,
        target: tuple[float, float],
        neighbours: int,
        leader_x: float,
        optimise_s: float,
    ) -> PlannerOutput:
        margin = 1.0 - abs(gamma) / yaw_rate_max(v, self._limits.mu_g)
        slot = 0 if self._slot is None else self._slot + 1
        return PlannerOutput(
            v, gamma, limit, margin, slot, target, neighbours, self._gains, self._cost, leader_x, optimise_s
        )
