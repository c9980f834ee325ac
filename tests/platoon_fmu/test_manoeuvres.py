"""The whole vehicle driven as an FMU, in what the validated physics (test_physics.py) does not drive."""

from __future__ import annotations

import numpy as np
import pytest

from platoon_fmu.parameters import VehicleParameters

P = VehicleParameters()
L, WEIGHT = P.L, P.M * P.g
K_US = P.M / L * (P.l_r / (2 * P.C_f) - P.l_f / (2 * P.C_r))
STATES = ["X", "Y", "psi", "phi", "v_x", "v_y", "gamma", "p", "omega_fl", "omega_rl", "omega_rr", "omega_fr"]


@pytest.mark.parametrize("lambda_f", [-1.0, 0.0, 1.0])
@pytest.mark.parametrize("lambda_r", [0.0, 1.0])
def test_understeer_gradient(make_car, lambda_f, lambda_r):
    f, r = P.C_f * (1 + 0.4 * lambda_f), P.C_r * (1 + 0.4 * lambda_r)
    expected = P.M / L * (P.l_r / (2 * f) - P.l_f / (2 * r))
    found = []
    for speed in (20.0, 30.0):
        car = make_car().start(v_x_start=speed)
        car.cruise(20.0, speed, steering_angle=0.001, lambda_f=lambda_f, lambda_r=lambda_r)
        found.append((0.001 - L * car["gamma"] / speed) / (speed * car["gamma"]))
    # The rest is the load that drag and rolling resistance move between the axles, and the tyres' fall-off.
    assert found == pytest.approx([expected] * 2, abs=0.02 * K_US)


def test_rolls_out_to_rest_without_chatter(make_car):
    car = make_car().start(v_x_start=2.0, v_y_start=0.2, gamma_start=0.1)
    speeds = car.run(60.0, names=["v_x"])[:, 0]
    assert speeds[-1] == pytest.approx(0.0, abs=1e-6)
    assert speeds.min() > -1e-6
    assert (np.diff(speeds) < 1e-9).all()
    assert abs(car["v_y"]) + abs(car["gamma"]) < 1e-6


def test_pulls_away_and_backs_up(make_car):
    for sign in (1, -1):
        car = make_car().start()
        car.torque(sign * 200.0)
        speeds = car.run(5.0, names=["v_x"])[:, 0] * sign
        # All forces are known: 4 T/R_w less rolling resistance (and a little drag), on mass and wheels.
        expected = (4 * 200 / P.R_w - P.mu_d * WEIGHT) / (P.M + 4 * P.I_w / P.R_w**2) * 5
        assert speeds[-1] == pytest.approx(expected, rel=0.03)
        assert (np.diff(speeds) > 0).all()
        assert car["Y"] == pytest.approx(0.0, abs=1e-12)


def test_torque_is_radius_times_force_in_steady_rolling(make_car):
    car = make_car().start(v_x_start=20.0)
    car.torque(100.0, 20.0, 20.0, 100.0)
    car.cruise(20.0, 20.0)
    assert P.R_w * car.wheels("F_x") == pytest.approx([100.0, 20.0, 20.0, 100.0], rel=1e-4)


def test_wheels_start_rolling(make_car):
    car = make_car().start(v_x_start=15.0)
    assert car.wheels("omega") == pytest.approx([50.0] * 4)
    turning = make_car().start(v_x_start=15.0, gamma_start=0.5)
    assert turning.wheels("kappa") == pytest.approx([0.0] * 4, abs=1e-12)


@pytest.mark.parametrize("torque", [4000.0, -4000.0])
@pytest.mark.parametrize("mu", [0.01, 0.1, 0.8])
def test_wild_torques_stay_finite_and_on_the_friction_circle(make_car, torque, mu):
    car = make_car().start(v_x_start=15.0)
    car.set(mu=mu)
    for steering in (0.0, 0.3, -0.3):
        car.set(steering_angle=steering)
        car.torque(torque, torque, -0.3 * torque, torque)
        for _ in range(300):
            car.step()
            used = np.hypot(car.wheels("F_x"), car.wheels("F_y"))
            assert (used <= mu * car.wheels("F_z") * (1 + 1e-9) + 1e-9).all()
    assert np.isfinite(car.get(*STATES)).all()


def test_loads_carry_the_car_and_move_the_right_way(make_car):
    car = make_car().start(v_x_start=20.0)
    car.cruise(10.0, 20.0, steering_angle=0.05)
    fl, rl, rr, fr = car.wheels("F_z")
    assert fl + rl + rr + fr == pytest.approx(WEIGHT)
    assert (fr > fl, rr > rl) == (True, True)
    assert car["phi"] > 0
    # Moments about the ground: the tyres' force at the height of the centre of mass, which leans out.
    moved = ((fr + rr) - (fl + rl)) * P.l_t / 2
    expected = P.M * car["a_y"] * P.h + P.m_s * P.g * P.h_s * car["phi"]
    assert moved == pytest.approx(expected, rel=0.01)

    braking = make_car().start(v_x_start=30.0)
    braking.torque(-300.0)
    braking.run(1.0)
    front = braking.wheels("F_z")[[0, 3]].sum()
    assert front == pytest.approx(2 * P.F_zf - P.h / L * P.M * braking["a_x"], rel=0.01)


def test_sidewind_leans_the_car_off_and_pushes_it(make_car):
    car = make_car().start(v_x_start=20.0)
    car.set(force_y=600.0)
    car.run(0.5)
    assert car["Y"] > 0
    assert car["phi"] < 0


@pytest.mark.parametrize("speed", [0.5, 5.0, 50.0])
def test_step_steer_settles_at_any_speed(make_car, speed):
    car = make_car().start(v_x_start=speed)
    car.cruise(10.0, speed, steering_angle=0.002)
    assert car["gamma"] == pytest.approx(0.002 * speed / (L + K_US * speed**2), rel=0.04)


def test_position_is_the_integral_of_the_velocity(make_car):
    car = make_car().start(v_x_start=20.0, psi_start=0.3)
    car.set(steering_angle=0.03)
    rows = car.run(4.0, names=["v_x", "v_y", "psi", "X", "Y"])
    v_x, v_y, psi, X, Y = rows.T
    dX, dY = v_x * np.cos(psi) - v_y * np.sin(psi), v_x * np.sin(psi) + v_y * np.cos(psi)
    assert X[-1] - X[0] == pytest.approx(np.trapezoid(dX, dx=0.01), rel=1e-5)
    assert Y[-1] - Y[0] == pytest.approx(np.trapezoid(dY, dx=0.01), rel=1e-5)
