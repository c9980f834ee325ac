"""The stability boundaries: their numbers, and that no request whatever leaves them."""

import math
from dataclasses import replace

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from bench.control.boundaries import (
    Boundaries,
    admissible,
    boundaries,
    largest_acceleration,
    speed_reach,
    yaw_rate_max,
)
from bench.control.outcome import Limit
from platoon_fmu.parameters import VehicleParameters

T = 0.01
G = 9.8


def bounds(
    mu: float = 0.8, share: float = 0.7, a_max: float = 3.0, swing: float = 1.5, v_min: float = 5.0, v_max: float = 45.0
) -> Boundaries:
    return boundaries(VehicleParameters(), mu, share, a_max, swing, v_min, v_max)


limits = st.builds(
    bounds,
    st.floats(0.05, 1.2),
    st.floats(0.1, 1.0),
    st.floats(0.1, 20.0),
    st.floats(0.1, 20.0),
    st.floats(1.0, 10.0),
    st.floats(11.0, 60.0),
)
request = st.floats(-1e3, 1e3) | st.floats(-5, 5)


def test_yaw_rate_boundary_at_20_mps() -> None:
    assert yaw_rate_max(20.0, 0.8 * G) == pytest.approx(0.3332, abs=1e-12)


def test_numbers_of_the_nominal_car() -> None:
    numbers = bounds()
    assert numbers.mu_g == pytest.approx(7.84)
    assert numbers.lift_front == pytest.approx(9.8 * 1.6 / 0.54)
    assert numbers.lift_rear == pytest.approx(9.8 * 1.4 / 0.54)


@given(limits, st.floats(0, 1), st.floats(-1, 1), request, request)
@example(bounds(share=1.0, a_max=10.0), 0.5, 1.0, 1e3, 1e3)
@example(bounds(), 0.0, 0.0, -1e3, 0.0)
@example(bounds(), 1.0, -1.0, 1e3, -1e3)
def test_no_request_leaves_the_boundaries(
    numbers: Boundaries, place: float, gamma: float, v_rate: float, gamma_rate: float
) -> None:
    """The yaw-rate boundary, the friction circle, acceleration and speed bounds hold for what is sent."""
    v = numbers.speed_min + place * (numbers.speed_max - numbers.speed_min)
    v_next, gamma_next, _ = admissible(v, gamma, v_rate, gamma_rate, T, numbers)
    slack = 1 + 1e-9
    assert numbers.speed_min <= v_next <= numbers.speed_max
    assert abs(gamma_next) <= slack * numbers.share * yaw_rate_max(v_next, numbers.mu_g)
    a_x, a_y = (v_next - v) / T, gamma_next * v_next
    # The difference of two speeds, divided by T, is only as exact as the speeds are.
    rounding = 1e-10
    assert abs(a_x) <= numbers.acceleration_max * slack + rounding
    assert math.hypot(a_x, a_y) <= numbers.share * numbers.mu_g * slack + rounding
    assert -numbers.lift_rear - rounding <= a_x <= numbers.lift_front + rounding


@given(limits, st.floats(0, 1), st.floats(-0.2, 0.2), st.floats(-1, 1), st.floats(-1, 1))
def test_what_is_inside_already_is_left_alone(
    numbers: Boundaries, place: float, gamma: float, v_rate: float, gamma_rate: float
) -> None:
    v = numbers.speed_min + place * (numbers.speed_max - numbers.speed_min)
    gamma_rate = min(max(gamma_rate, -numbers.yaw_acceleration_max), numbers.yaw_acceleration_max)
    wanted_v, wanted_gamma = v + T * v_rate, gamma + T * gamma_rate
    v_next, gamma_next, limit = admissible(v, gamma, v_rate, gamma_rate, T, numbers)
    if limit == Limit.NONE:
        assert v_next == pytest.approx(wanted_v, abs=1e-12)
        assert gamma_next == pytest.approx(wanted_gamma, abs=1e-12)
    else:
        v_fast = max(v, wanted_v, numbers.speed_min)
        inside = (
            abs(v_rate) <= numbers.acceleration_max
            and math.hypot(v_rate, wanted_gamma * v_fast) <= numbers.share * numbers.mu_g * (1 - 1e-9)
            and abs(wanted_gamma) <= numbers.share * yaw_rate_max(v_fast, numbers.mu_g) * (1 - 1e-9)
            and numbers.speed_min <= wanted_v <= numbers.speed_max
        )
        assert not inside


@given(limits, st.floats(0, 1), st.floats(-1, 1), request, request)
def test_left_and_right_are_treated_alike(
    numbers: Boundaries, place: float, gamma: float, v_rate: float, gamma_rate: float
) -> None:
    v = numbers.speed_min + place * (numbers.speed_max - numbers.speed_min)
    one = admissible(v, gamma, v_rate, gamma_rate, T, numbers)
    other = admissible(v, -gamma, v_rate, -gamma_rate, T, numbers)
    assert other == (one[0], -one[1], one[2])


@pytest.mark.parametrize(
    ("state", "request_", "limit"),
    [
        ((20.0, 0.0), (1.0, 0.1), Limit.NONE),
        ((20.0, 0.23), (0.0, 1.5), Limit.YAW_RATE),
        ((20.0, 0.0), (4.0, 0.0), Limit.ACCELERATION),
        ((20.0, 0.0), (-4.0, 0.0), Limit.ACCELERATION),
        ((20.0, 0.232), (3.0, 0.0), Limit.FRICTION_CIRCLE),
        # Where both bind, the yaw rate is told: it is the reason.
        ((20.0, 0.23), (3.0, 1.5), Limit.YAW_RATE),
        ((45.0, 0.0), (1.0, 0.0), Limit.SPEED),
        ((5.0, 0.0), (-1.0, 0.0), Limit.SPEED),
    ],
)
def test_which_boundary_bound_is_told(state: tuple[float, float], request_: tuple[float, float], limit: Limit) -> None:
    assert admissible(*state, *request_, T, bounds())[2] == limit


@pytest.mark.parametrize("v_rate", [9.0, -9.0])
def test_adhesion_below_the_asked_acceleration_is_told(v_rate: float) -> None:
    """Straight ahead on 0.7 x 0.8 x 9.8 = 5.488 m/s^2 of adhesion, with 10 m/s^2 allowed to be asked for."""
    v_next, _, limit = admissible(20.0, 0.0, v_rate, 0.0, T, bounds(a_max=10.0))
    assert v_next == pytest.approx(20.0 + math.copysign(T * 5.488, v_rate))
    assert limit == Limit.ACCELERATION


def test_yaw_acceleration_is_limited() -> None:
    _, gamma, _ = admissible(20.0, 0.0, 0.0, 100.0, T, bounds(swing=1.5))
    assert gamma == pytest.approx(0.015)


@given(st.floats(0.05, 0.8), st.floats(5, 45), st.floats(-0.5, 0.5), request, request)
def test_lift_off_never_binds_on_a_real_road(
    mu: float, v: float, gamma: float, v_rate: float, gamma_rate: float
) -> None:
    """The same car whose wheels cannot lift at all gets the same references."""
    numbers = bounds(mu=mu, share=1.0, a_max=100.0)
    glued = Boundaries(numbers.mu_g, math.inf, math.inf, 1.0, 100.0, 1.5, 5.0, 45.0)
    assert admissible(v, gamma, v_rate, gamma_rate, T, numbers) == admissible(v, gamma, v_rate, gamma_rate, T, glued)


def test_lift_off_binds_for_a_very_high_car() -> None:
    tall = boundaries(replace(VehicleParameters(), h=4.0), 0.8, 1.0, 100.0, 1.5, 5.0, 45.0)
    faster, _, _ = admissible(20.0, 0.0, 50.0, 0.0, T, tall)
    slower, _, _ = admissible(20.0, 0.0, -50.0, 0.0, T, tall)
    assert faster - 20.0 == pytest.approx(T * G * 1.6 / 4.0)
    assert 20.0 - slower == pytest.approx(T * G * 1.4 / 4.0)


def test_speed_reach_has_the_front_lift_for_accelerating_and_the_rear_for_braking() -> None:
    numbers = bounds()
    assert speed_reach(20.0, True, T, numbers) == pytest.approx(20.0 + T * G * 1.6 / 0.54)
    assert speed_reach(20.0, False, T, numbers) == pytest.approx(20.0 - T * G * 1.4 / 0.54)


@given(st.floats(-0.5, 0.5), st.floats(5, 45))
def test_largest_acceleration_lies_on_the_friction_circle_or_is_the_asked_for(gamma: float, v: float) -> None:
    numbers = bounds(share=0.7, a_max=3.0)
    a_x = largest_acceleration(gamma, v, numbers)
    grip = 0.7 * 7.84
    if abs(gamma * v) >= grip:
        assert a_x == 0.0
    else:
        assert a_x == pytest.approx(min(3.0, math.sqrt(grip**2 - (gamma * v) ** 2)))
