"""The tracker in closed loop with the model it is made for, at all corners of the tyres, and its fallbacks."""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import TypeAdapter, ValidationError

from bench.control.allocation import allocate
from bench.control.outcome import GainSource, SolverStatus
from bench.control.settings import TrackerSettings
from bench.control.tracker import Tracker, TrackerOutput, own_programs
from bench.control.vehicle_model import VehicleModel
from platoon_fmu.parameters import VehicleParameters

T = 0.01
NOMINAL = VehicleParameters()
CORNERS = [(0.0, 0.0), (1.0, 1.0), (-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0)]
WIND = np.array([-0.6, 0.5, 0.15])
"""A disturbance as an acceleration: m/s^2, m/s^2, rad/s^2."""

LIMIT = np.array([0.5, 9000.0, 2310.0])
"""Largest virtual input with the default settings: rad, N, N m."""

Reference = Callable[[float], tuple[float, float]]


def steady(v: float, gamma: float = 0.0) -> Reference:
    return lambda _: (v, gamma)


def slalom(t: float) -> tuple[float, float]:
    return 20.0 + np.sin(2 * np.pi * t / 3), 0.15 * np.sin(2 * np.pi * t / 2)


def limits(chosen: TrackerSettings) -> tuple[np.ndarray, np.ndarray]:
    """Largest virtual input and its largest change in a step, from the settings' own meaning."""
    share, force = chosen.yaw_moment_share, chosen.wheel_force_max_n
    rate = chosen.wheel_force_rate_max_nps * T
    lever = 2 * NOMINAL.l_t
    return (
        np.array([chosen.steering_max_rad, 4 * force * (1 - share), lever * force * share]),
        np.array([chosen.steering_rate_max_radps * T, 4 * rate * (1 - share), lever * rate * share]),
    )


@dataclass
class Loop:
    """The tracker and a car whose tyres are not what it believes, with a disturbance."""

    chosen: TrackerSettings = field(default_factory=TrackerSettings)
    corner: tuple[float, float] = (0.0, 0.0)
    disturbance: np.ndarray = field(default_factory=lambda: np.zeros(3))
    xi: np.ndarray = field(default_factory=lambda: np.array([20.0, 0.0, 0.0]))
    semidefinite: bool = False
    """Whether only the semidefinite program is tried."""

    def __post_init__(self) -> None:
        stiff_f, stiff_r = (1 + NOMINAL.cornering_variation * part for part in self.corner)
        self.car = VehicleModel(replace(NOMINAL, C_f=NOMINAL.C_f * stiff_f, C_r=NOMINAL.C_r * stiff_r), T)
        tried = own_programs(self.chosen)
        self.tracker = Tracker(self.chosen, NOMINAL, T, tried[1:] if self.semidefinite else tried)
        self.allocation = allocate(
            NOMINAL, self.chosen.steering_max_rad, self.chosen.wheel_force_max_n, self.chosen.yaw_moment_share
        )
        self.outputs: list[TrackerOutput] = []
        self.errors: list[np.ndarray] = []

    def run(
        self,
        reference: Reference,
        seconds: float,
        actuate: Callable[[int, np.ndarray], np.ndarray] = lambda _, u: u,
        tell: bool = False,
    ) -> "Loop":
        """Follow a reference; `actuate` is what the actuators make of a command, which the tracker may be told."""
        applied = None
        start = len(self.outputs)
        for k in range(start, start + round(seconds / T)):
            now, then = reference(k * T), reference((k + 1) * T)
            self.errors.append(np.array([self.xi[0] - now[0], self.xi[2] - now[1]]))
            out = self.tracker.step(self.xi, now, then, applied)
            u = actuate(k, out.u)
            applied = u if tell else None
            self.xi = self.car.step(self.xi, self.allocation.matrix @ u) + T * self.disturbance
            self.outputs.append(out)
        return self

    @property
    def sources(self) -> Counter[GainSource]:
        return Counter(out.source for out in self.outputs)


def assert_tracked(loop: Loop, speed: float, yaw_rate: float) -> None:
    """The last errors are no larger than these (m/s, rad/s)."""
    last = np.abs(loop.errors[-1])
    assert last[0] <= speed
    assert last[1] <= yaw_rate


@pytest.mark.parametrize("corner", CORNERS)
def test_no_offset_under_a_constant_disturbance(corner: tuple[float, float]) -> None:
    """Whatever the tyres: wind that never ends leaves no error of speed or yaw rate, in a curve as well."""
    loop = Loop(corner=corner, disturbance=WIND).run(steady(20.0, 0.15), 4.0)
    assert_tracked(loop, 2e-3, 2e-4)
    assert loop.sources == {GainSource.RICCATI: 400}


def test_without_the_estimate_the_offset_stays() -> None:
    """What the disturbance estimate in the target is good for: the same run without it."""
    with_it = Loop(disturbance=WIND).run(steady(20.0, 0.1), 4.0)
    without = Loop(TrackerSettings(offset_free=False), disturbance=WIND).run(steady(20.0, 0.1), 4.0)
    assert (np.abs(without.errors[-1]) > 20 * np.abs(with_it.errors[-1])).all()
    assert abs(without.errors[-1][0]) > 0.05


@pytest.mark.parametrize("corner", CORNERS)
def test_slalom_is_followed_at_all_corners(corner: tuple[float, float]) -> None:
    loop = Loop(corner=corner).run(slalom, 2.0)
    worst = np.abs(loop.errors[100:]).max(axis=0)
    assert worst[0] < 0.15
    assert worst[1] < 0.015
    assert loop.sources == {GainSource.RICCATI: 200}
    assert all(out.tau > 0 for out in loop.outputs)


def test_oversteering_car_above_its_critical_speed_is_held() -> None:
    """At 35 m/s with lambda (+1, -1) the open loop runs away."""
    loop = Loop(corner=(1.0, -1.0), xi=np.array([35.0, 0.3, 0.05])).run(steady(35.0), 3.0)
    assert_tracked(loop, 5e-3, 1e-3)
    open_loop = loop.car.linearise(np.array([35.0, 0.0, 0.0]), np.zeros(5)).A
    assert np.abs(np.linalg.eigvals(open_loop)).max() > 1.0


def test_paper_version_with_one_lambda_tracks_too() -> None:
    loop = Loop(TrackerSettings(independent_axles=False), corner=(1.0, 1.0), disturbance=WIND)
    loop.run(steady(20.0, 0.1), 4.0)
    assert_tracked(loop, 5e-3, 5e-4)


def test_estimate_is_the_disturbance() -> None:
    """On the nominal car, straight ahead, nothing but the disturbance is there to be estimated."""
    loop = Loop(disturbance=WIND).run(steady(20.0), 4.0)
    np.testing.assert_allclose(loop.outputs[-1].disturbance, WIND, atol=0.02)
    first = loop.outputs[0].disturbance
    np.testing.assert_array_equal(first, 0.0)


def test_perfect_model_without_disturbance_needs_no_feedback() -> None:
    loop = Loop().run(steady(20.0), 1.0)
    for out in loop.outputs:
        np.testing.assert_allclose(out.u / LIMIT, out.reference_u / LIMIT, atol=1e-5)
        np.testing.assert_allclose(out.target, 0.0, atol=1e-6)


def test_commands_are_the_allocation_of_the_virtual_input() -> None:
    loop = Loop(corner=(1.0, -1.0), disturbance=WIND).run(slalom, 1.0)
    for out in loop.outputs:
        U = loop.allocation.matrix @ out.u
        assert out.steering == U[0]
        np.testing.assert_array_equal(out.wheel_forces, U[1:])


def test_same_run_gives_the_same_numbers() -> None:
    one, other = (Loop(corner=(1.0, -1.0), disturbance=WIND).run(slalom, 1.0) for _ in range(2))
    np.testing.assert_array_equal([o.u for o in one.outputs], [o.u for o in other.outputs])
    assert [o.tau for o in one.outputs] == [o.tau for o in other.outputs]


wild_state = st.builds(lambda *x: np.array(x), st.floats(0, 50), st.floats(-8, 8), st.floats(-2, 2))
wild_reference = st.tuples(st.floats(0, 50), st.floats(-1, 1))
tight = TrackerSettings(
    steering_max_rad=0.2, steering_rate_max_radps=1.0, wheel_force_max_n=1500.0, yaw_moment_share=0.4
)


@settings(max_examples=25)
@given(
    st.sampled_from([TrackerSettings(), tight]),
    st.lists(st.tuples(wild_state, wild_reference), min_size=4, max_size=10),
)
def test_rates_and_bounds_hold_whatever_is_measured_and_asked(
    chosen: TrackerSettings, steps: list[tuple[np.ndarray, tuple[float, float]]]
) -> None:
    tracker = Tracker(chosen, NOMINAL, T)
    limit, rate = limits(chosen)
    last = np.zeros(3)
    for (xi, now), (_, then) in pairwise(steps):
        out = tracker.step(xi, now, then)
        assert np.isfinite(out.u).all()
        assert (np.abs(out.u) <= limit * (1 + 1e-9)).all()
        assert (np.abs(out.u - last) <= rate * (1 + 1e-9)).all()
        assert abs(out.steering) <= chosen.steering_max_rad * (1 + 1e-9)
        assert np.abs(out.wheel_forces).max() <= chosen.wheel_force_max_n * (1 + 1e-9)
        last = out.u


def test_rate_is_counted_from_what_was_applied() -> None:
    """Actuators that stood still at 0.3 rad: the next command is within a step of that, not of the last command."""
    tracker = Tracker(TrackerSettings(), NOMINAL, T)
    xi = np.array([20.0, 0.0, 0.0])
    tracker.step(xi, (20.0, 0.0), (20.0, 0.0))
    stuck = np.array([0.3, 0.0, 0.0])
    out = tracker.step(xi, (20.0, 0.0), (20.0, 0.0), stuck)
    assert out.u[0] == pytest.approx(0.3 - 0.03)


def test_observer_is_driven_by_what_was_really_applied() -> None:
    """Actuators that lose half of every command: told, the tracker sees no disturbance in it; untold, it does."""

    def weak(_: int, u: np.ndarray) -> np.ndarray:
        return 0.5 * u

    told = Loop(xi=np.array([19.0, 0.0, 0.0])).run(steady(20.0), 1.0, weak, tell=True)
    untold = Loop(xi=np.array([19.0, 0.0, 0.0])).run(steady(20.0), 1.0, weak, tell=False)
    seen_told, seen_untold = (max(abs(out.disturbance[0]) for out in loop.outputs) for loop in (told, untold))
    # The model is linearised at the reference: of a speed error of 1 m/s the drag is off by a very little.
    assert seen_told < 1e-2
    assert seen_untold > 0.1


def test_held_actuators_do_not_wind_the_estimate_up() -> None:
    """Half a second of held commands in a slalom, reported as such: the estimate stays small, tracking resumes."""
    held: list[np.ndarray] = []

    def hold(k: int, u: np.ndarray) -> np.ndarray:
        if not 100 <= k < 150:
            held[:] = [u]
        return held[0]

    loop = Loop().run(slalom, 2.5, hold, tell=True)
    told = max(np.abs(out.disturbance).max() for out in loop.outputs)
    silent = max(np.abs(out.disturbance).max() for out in Loop().run(slalom, 2.5, hold, tell=False).outputs)
    assert told < 0.5 * silent
    assert_tracked(loop, 0.3, 0.02)


def test_first_fallback_is_the_linear_quadratic_gain() -> None:
    """A solver that may take 5 iterations never arrives: said at each step, and the car is still tracked."""
    chosen = TrackerSettings(solver_max_iterations=5)
    loop = Loop(chosen, disturbance=WIND, xi=np.array([19.0, 0.2, 0.05]), semidefinite=True)
    loop.run(steady(20.0, 0.1), 4.0)
    assert loop.sources == {GainSource.LQR: 400}
    assert {out.status for out in loop.outputs} == {SolverStatus.MAX_ITERATIONS}
    assert {out.iterations for out in loop.outputs} == {5}
    assert {out.tau for out in loop.outputs} == {0.0}
    assert_tracked(loop, 3e-2, 1e-3)


def solver_that_often_fails() -> TrackerSettings:
    """Settings with which about half of the programmes of the slalom take more iterations than allowed."""
    needed = sorted(out.iterations for out in Loop(semidefinite=True).run(slalom, 1.0).outputs)
    # In wind they take more than without.
    return TrackerSettings(solver_max_iterations=needed[2 * len(needed) // 3])


def test_second_fallback_is_the_gain_of_the_last_good_step() -> None:
    loop = Loop(solver_that_often_fails(), disturbance=WIND, semidefinite=True).run(slalom, 2.0)
    assert loop.sources[GainSource.SDP] > 20
    assert loop.sources[GainSource.PREVIOUS_GAIN] > 20
    for out in loop.outputs:
        solved = out.status is SolverStatus.SOLVED
        assert (out.source is GainSource.SDP) is solved
        assert (out.tau > 0.0) is solved
    # Once there was a good gain the nominal one is never needed again.
    sources = [out.source for out in loop.outputs]
    first_good = sources.index(GainSource.SDP)
    assert GainSource.LQR not in sources[first_good:]
    assert set(sources[:first_good]) <= {GainSource.LQR}
    assert np.abs(loop.errors[100:]).max(axis=0) == pytest.approx([0.0, 0.0], abs=0.2)


def test_deviation_beyond_all_inputs_is_answered_with_the_previous_gain_and_said() -> None:
    """A spin at 40 m/s that no gain can prove to catch: the last proven one is used, inside the bounds."""
    loop = Loop(tight, corner=(1.0, -1.0), xi=np.array([40.0, 0.0, 0.0])).run(steady(40.0), 0.1)
    assert loop.sources == {GainSource.RICCATI: 10}
    loop.xi = np.array([40.0, -12.0, 3.0])
    loop.run(steady(40.0), 0.05)
    last = loop.outputs[-5:]
    assert {out.source for out in last} == {GainSource.PREVIOUS_GAIN}
    assert {out.status for out in last} <= {SolverStatus.INFEASIBLE, SolverStatus.CHECK_FAILED}
    limit, _ = limits(tight)
    assert all((np.abs(out.u) <= limit * (1 + 1e-9)).all() for out in last)


@pytest.mark.parametrize("v", [0.0, 1.0, 3.0])
def test_standstill_is_survived(v: float) -> None:
    """Below the slowest speed the model is evaluated at that speed; nothing divides by zero."""
    tracker = Tracker(TrackerSettings(), NOMINAL, T)
    for _ in range(20):
        out = tracker.step(np.array([v, 0.0, 0.0]), (v, 0.0), (5.0, 0.0))
        assert np.isfinite(out.u).all()
        assert out.reference[0] == 3.0


def test_reference_state_has_the_models_lateral_velocity() -> None:
    out = Tracker(TrackerSettings(), NOMINAL, T).step(np.array([20.0, 0.0, 0.0]), (20.0, 0.1), (20.0, 0.1))
    model = VehicleModel(NOMINAL, T)
    np.testing.assert_allclose(out.reference, [20.0, model.steady_lateral_velocity(20.0, 0.1), 0.1])


@pytest.mark.parametrize(
    "wrong",
    [
        {"observer_rate": 0.4},
        {"observer_rate": 1.0},
        {"steering_max_rad": 0.0},
        {"steering_max_rad": 1.1},
        {"wheel_force_max_n": -1.0},
        {"yaw_moment_share": 1.0},
        {"input_weight": 1e-4},
        {"solver_max_iterations": 4},
        {"solver_max_iterations": 64},
    ],
)
def test_settings_out_of_range_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValidationError, match=next(iter(wrong))):
        TypeAdapter(TrackerSettings).validate_python(wrong)


def test_observer_rate_out_of_reach_is_refused() -> None:
    with pytest.raises(ValueError, match="raise observer_rate"):
        Tracker(TrackerSettings(observer_rate=0.1), NOMINAL, T)
