"""Slowing down in one's lane: along the road, gently, down to a crawl."""

import math

import pytest

from bench.control.brake_steering import BrakeSteering
from bench.control.slow_down import slow_down
from platoon_fmu.parameters import VehicleParameters

T = 0.01


@pytest.mark.parametrize(("v", "gamma", "course"), [(20.0, 0.0, 0.2), (22.0, 0.4, -0.3), (12.0, -0.2, 0.0)])
def test_the_vehicle_ends_along_the_road_at_a_crawl(v: float, gamma: float, course: float) -> None:
    for _ in range(1500):
        v_next, gamma_next = slow_down(v, gamma, course, 1.5, 5.0, T)
        assert v - 1.5 * T - 1e-12 <= v_next <= v
        assert abs(gamma_next - gamma) <= 1.5 * T + 1e-12
        v, gamma = v_next, gamma_next
        course += T * gamma
    assert v == pytest.approx(5.0)
    assert course == pytest.approx(0.0, abs=1e-3)
    assert gamma == pytest.approx(0.0, abs=1e-3)


def test_lateral_acceleration_stays_low_enough_for_ice() -> None:
    v, gamma = 30.0, 0.0
    for _ in range(200):
        v, gamma = slow_down(v, gamma, -1.5, 1.5, 5.0, T)
        assert abs(v * gamma) <= 2.0 + 1e-9


def test_a_course_is_an_angle() -> None:
    assert slow_down(20.0, 0.0, 2 * math.pi + 0.1, 1.5, 5.0, T) == pytest.approx(slow_down(20.0, 0.0, 0.1, 1.5, 5.0, T))


def test_one_that_is_slower_already_keeps_its_speed() -> None:
    assert slow_down(3.0, 0.0, 0.0, 1.5, 5.0, T)[0] == 3.0


def test_the_wheels_alone_brake_and_turn_within_their_limits() -> None:
    vehicle = VehicleParameters()
    brakes = BrakeSteering(vehicle, 3000.0, T)
    # 0.75 m/s too fast on a straight road: half of it a second, on all wheels alike.
    assert brakes.forces(20.0, 0.0, 19.25, 0.0) == pytest.approx([-0.25 * vehicle.M * 1.5] * 4)
    for error in (0.05, 0.5, -5.0):
        rear_left, rear_right = brakes.forces(20.0, 0.0, 19.25, error)[1:3]
        assert (rear_right - rear_left) * error > 0.0
        assert max(abs(rear_left), abs(rear_right)) <= 3000.0


def test_the_moment_of_stuck_wheels_is_taken_up() -> None:
    vehicle = VehicleParameters()
    brakes = BrakeSteering(vehicle, 3000.0, T)
    gamma = 0.0
    for _ in range(1000):
        forces = brakes.forces(20.0, gamma, 20.0, 0.0)
        moment = 0.5 * vehicle.l_t * (forces[2] + forces[3] - forces[0] - forces[1])
        gamma += T * (2000.0 + moment) / vehicle.I_z
    assert gamma == pytest.approx(0.0, abs=1e-3)
    brakes.reset()
    assert brakes.forces(20.0, 0.0, 20.0, 0.0) == pytest.approx([0.0] * 4)
