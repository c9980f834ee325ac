"""The FMU's derivatives (Model Exchange) against the linear-tyre model of the paper, written out here in numpy."""

from __future__ import annotations

import numpy as np
import pytest

from platoon_fmu.importer import Kind

M, I_z, l_f, l_r, C_f, C_r, C_a = 1723.0, 4175.0, 1.4, 1.6, 52_700.0, 66_900.0, 0.3256
F_ROLL = 0.018 * M * 9.8


def paper(v_x, v_y, gamma, delta, lambda_f=0.0, lambda_r=0.0):
    """(16)-(20) with the rear tyre sign corrected, no drive forces: [dv_x, dv_y, dgamma]."""
    F_yf = 2 * C_f * (1 + 0.4 * lambda_f) * (delta - (v_y + l_f * gamma) / v_x)
    F_yr = 2 * C_r * (1 + 0.4 * lambda_r) * (l_r * gamma - v_y) / v_x
    return np.array(
        [
            v_y * gamma + (-F_yf * delta - C_a * v_x**2 - F_ROLL) / M,
            -v_x * gamma + (F_yf + F_yr) / M,
            (l_f * F_yf - l_r * F_yr) / I_z,
        ]
    )


@pytest.fixture
def derivative(make_car):
    """A function of (v_x, v_y, gamma, inputs) that gives the FMU's [dv_x, dv_y, dgamma]."""
    car = make_car(Kind.MODEL_EXCHANGE).start()

    def of(v_x, v_y=0.0, gamma=0.0, **inputs):
        x = dict.fromkeys(car.state_names, 0.0)
        x |= {"v_x": v_x, "v_y": v_y, "gamma": gamma}
        for name, side in (("fl", 1), ("rl", 1), ("rr", -1), ("fr", -1)):
            x[f"omega_{name}"] = (v_x - gamma * side * 0.77) / 0.3
        car.set(inputs)
        car.set_states(list(x.values()))
        dx = dict(zip(car.state_names, car.derivatives(), strict=True))
        return np.array([dx["v_x"], dx["v_y"], dx["gamma"]])

    return of


def lateral_jacobian(derivative, v_x, **inputs):
    """d[dv_y, dgamma]/d[v_y, gamma, delta] by central differences."""
    h = 1e-6
    steps = ({"v_y": h}, {"gamma": h}, {"steering_angle": h})
    columns = []
    for step in steps:
        base = {"steering_angle": 0.0, **inputs}
        plus = derivative(v_x, **{**base, **step})
        minus = derivative(v_x, **{**base, **{k: -v for k, v in step.items()}})
        columns.append((plus - minus)[1:] / (2 * h))
    return np.array(columns).T


@pytest.mark.parametrize("v_x", [10.0, 20.0, 50.0])
@pytest.mark.parametrize("lambda_f", [-1.0, 0.0, 1.0])
@pytest.mark.parametrize("lambda_r", [-1.0, 0.0, 1.0])
def test_initial_slopes_are_the_papers(derivative, v_x, lambda_f, lambda_r):
    f, r = 2 * C_f * (1 + 0.4 * lambda_f), 2 * C_r * (1 + 0.4 * lambda_r)
    expected = [
        [-(f + r) / (M * v_x), -v_x + (r * l_r - f * l_f) / (M * v_x), f / M],
        [(r * l_r - f * l_f) / (I_z * v_x), -(f * l_f**2 + r * l_r**2) / (I_z * v_x), l_f * f / I_z],
    ]
    found = lateral_jacobian(derivative, v_x, lambda_f=lambda_f, lambda_r=lambda_r)
    assert found == pytest.approx(np.array(expected), rel=1e-4, abs=1e-6)


@pytest.mark.parametrize(("v_y", "gamma", "delta"), [(0.02, 0.01, 0.004), (-0.03, 0.02, 0.002), (0.01, -0.01, 0.0)])
def test_small_motion_at_20_mps_is_the_papers_model(derivative, v_y, gamma, delta):
    found = derivative(20.0, v_y, gamma, steering_angle=delta)
    # Without v x gamma, which would hide or blow up what the tyres do.
    turning = np.array([v_y * gamma, -20.0 * gamma, 0.0])
    assert found - turning == pytest.approx(paper(20.0, v_y, gamma, delta) - turning, rel=0.035, abs=1e-4)


def test_check_point_of_the_control_model_within_the_tyres_fall_off(derivative):
    found = derivative(20.0, 0.1, 0.05, steering_angle=0.02)
    assert found == pytest.approx(paper(20.0, 0.1, 0.05, 0.02), rel=0.12)


def test_external_forces_and_moment_act_at_the_centre_of_mass(derivative):
    none = derivative(20.0)
    pushed = derivative(20.0, force_x=1723.0, force_y=3446.0, moment_z=4175.0)
    assert pushed - none == pytest.approx([1.0, 2.0, 1.0])
