"""The near-identity diffeomorphism along the exact motion of a unicycle."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from bench.control import near_identity
from bench.control.near_identity import turned
from bench.control.settings import check_length

angle = st.floats(-np.pi, np.pi)
speed = st.floats(1, 40)
yaw_rate = st.floats(-0.6, 0.6)
length = st.floats(0.1, 0.99)


def point(x: float, y: float, theta: float, ahead: float) -> tuple[float, float]:
    return near_identity.point(x, y, np.cos(theta), np.sin(theta), ahead)


def velocity(theta: float, v: float, gamma: float, ahead: float) -> tuple[float, float]:
    return near_identity.velocity(np.cos(theta), np.sin(theta), v, gamma, ahead)


def input_rates(theta: float, v: float, gamma: float, ahead: float, *eta: float) -> tuple[float, float]:
    return near_identity.input_rates(np.cos(theta), np.sin(theta), v, gamma, ahead, *eta)


class Unicycle:
    """A unicycle whose speed and yaw rate change at constant rates; its motion at any time, by quadrature."""

    def __init__(self, theta: float, v: float, gamma: float, rates: tuple[float, float] = (0.0, 0.0)) -> None:
        self._start = theta, v, gamma
        self._rates = rates

    def motion(self, t: float) -> tuple[float, float, float]:
        """Course, speed and yaw rate."""
        theta, v, gamma = self._start
        a, b = self._rates
        return theta + gamma * t + 0.5 * b * t * t, v + a * t, gamma + b * t

    def place(self, t: float, ahead: float) -> np.ndarray:
        """S at time t."""
        x, _ = quad(lambda s: self.motion(s)[1] * np.cos(self.motion(s)[0]), 0, t, epsabs=1e-13)
        y, _ = quad(lambda s: self.motion(s)[1] * np.sin(self.motion(s)[0]), 0, t, epsabs=1e-13)
        return np.array(point(x, y, self.motion(t)[0], ahead))

    def pace(self, t: float, ahead: float) -> np.ndarray:
        """W at time t."""
        return np.array(velocity(*self.motion(t), ahead))


@given(angle, speed, yaw_rate, length, st.tuples(st.floats(-5, 5), st.floats(-2, 2)))
def test_velocity_is_the_rate_of_the_point(
    theta: float, v: float, gamma: float, ahead: float, rates: tuple[float, float]
) -> None:
    car = Unicycle(theta, v, gamma, rates)
    h = 1e-4
    difference = (car.place(h, ahead) - car.place(-h, ahead)) / (2 * h)
    np.testing.assert_allclose(car.pace(0.0, ahead), difference, rtol=1e-6, atol=1e-6)


@given(angle, speed, yaw_rate, length, st.tuples(st.floats(-8, 8), st.floats(-8, 8)))
def test_input_rates_accelerate_the_point_as_asked(
    theta: float, v: float, gamma: float, ahead: float, eta: tuple[float, float]
) -> None:
    rates = input_rates(theta, v, gamma, ahead, *eta)
    car = Unicycle(theta, v, gamma, rates)
    h = 1e-5
    difference = (car.pace(h, ahead) - car.pace(-h, ahead)) / (2 * h)
    np.testing.assert_allclose(difference, eta, rtol=1e-5, atol=1e-5)


def test_second_difference_of_the_point_is_what_was_asked() -> None:
    eta = (1.5, -0.7)
    car = Unicycle(0.4, 20.0, 0.1, input_rates(0.4, 20.0, 0.1, 0.9, *eta))
    h = 1e-3
    second = (car.place(h, 0.9) - 2 * car.place(0.0, 0.9) + car.place(-h, 0.9)) / h**2
    np.testing.assert_allclose(second, eta, atol=1e-3)


@given(speed, length)
def test_yaw_pole_of_the_euler_step(v: float, ahead: float) -> None:
    """With nothing asked of the point, the yaw rate goes by the factor 1 - v T/l a step."""
    T, gamma = 0.01, 1e-4
    _, gamma_rate = input_rates(0.0, v, gamma, ahead, 0.0, 0.0)
    assert (gamma + T * gamma_rate) / gamma == pytest.approx(1 - v * T / ahead, rel=1e-9)


@pytest.mark.parametrize(("ahead", "settles"), [(0.101, True), (0.2, True), (0.099, False)])
def test_least_length_is_where_the_yaw_rate_stops_settling(ahead: float, settles: bool) -> None:
    v, T = 20.0, 0.01
    gamma = 1e-3
    for _ in range(1000):
        gamma += T * input_rates(0.0, v, gamma, ahead, 0.0, 0.0)[1]
        gamma = min(max(gamma, -1.0), 1.0)
    assert bool(abs(gamma) < 1e-6) is settles
    if settles:
        check_length(ahead, v, T)
    else:
        with pytest.raises(ValueError, match="near-identity length"):
            check_length(ahead, v, T)


@pytest.mark.parametrize("bad", [0.0, -0.5, 0.1, 1.0, 2.0, float("nan")])
def test_unsuitable_lengths_are_refused(bad: float) -> None:
    with pytest.raises(ValueError, match=r"must lie between v T/2 = 0\.1 m"):
        check_length(bad, 20.0, 0.01)


@pytest.mark.parametrize("good", [0.1001, 0.5, 0.999])
def test_suitable_lengths_are_accepted(good: float) -> None:
    check_length(good, 20.0, 0.01)


@given(angle, st.floats(-0.11, 0.11) | angle)
def test_a_turned_course_has_the_cosine_and_sine_of_the_sum(theta: float, by: float) -> None:
    c, s = turned(np.cos(theta), np.sin(theta), by)
    assert c == pytest.approx(np.cos(theta + by), abs=1e-15)
    assert s == pytest.approx(np.sin(theta + by), abs=1e-15)
