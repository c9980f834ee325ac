"""The control model against hand-checked numbers, finite differences and the textbook's steady cornering."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import brentq, root

from bench.control.allocation import Allocation
from bench.control.vehicle_model import VehicleModel
from platoon_fmu.parameters import VehicleParameters

T = 0.01
XI = np.array([20.0, 0.1, 0.05])
U = np.array([0.02, 100.0, 50.0, 80.0, 120.0])

NOMINAL = VehicleModel(VehicleParameters(), T)

states = st.builds(
    lambda v, v_y, gamma: np.array([v, v_y, gamma]), st.floats(5, 45), st.floats(-2, 2), st.floats(-0.6, 0.6)
)
inputs = st.builds(
    lambda delta, forces: np.array([delta, *forces]),
    st.floats(-0.5, 0.5),
    st.tuples(*[st.floats(-3000, 3000)] * 4),
)


def stiffened(lambda_f: float, lambda_r: float) -> VehicleModel:
    """The nonlinear model of a car whose tyres differ from the nominal ones, independent of dA and dB."""
    p = VehicleParameters()
    return VehicleModel(replace(p, C_f=p.C_f * (1 + 0.4 * lambda_f), C_r=p.C_r * (1 + 0.4 * lambda_r)), T)


def differences(model: VehicleModel, xi: np.ndarray, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A and B by central differences of one step."""
    A = np.empty((3, 3))
    B = np.empty((3, 5))
    for column, h in enumerate((1e-4, 1e-4, 1e-5)):
        e = h * np.eye(3)[column]
        A[:, column] = (model.step(xi + e, u) - model.step(xi - e, u)) / (2 * h)
    for column, h in enumerate((1e-5, 1.0, 1.0, 1.0, 1.0)):
        e = h * np.eye(5)[column]
        B[:, column] = (model.step(xi, u + e) - model.step(xi, u - e)) / (2 * h)
    return A, B


def lateral(A: np.ndarray) -> np.ndarray:
    """The lateral motion (v_y, gamma) of a model linearised about straight running."""
    return A[1:, 1:]


def straight(v: float) -> tuple[np.ndarray, np.ndarray]:
    return np.array([v, 0.0, 0.0]), np.zeros(5)


def test_derivative_at_the_worked_point() -> None:
    expected = [0.11847069, -0.37161927, 0.46842635]
    np.testing.assert_allclose(NOMINAL.derivative(XI, U), expected, rtol=0, atol=5.1e-9)


def test_a_at_the_worked_point() -> None:
    expected = [
        [0.99991921, 0.00111172, 0.00185641],
        [-0.00020119, 0.93058619, -0.18069646],
        [0.00012457, 0.00796647, 0.93423808],
    ]
    np.testing.assert_allclose(NOMINAL.linearise(XI, U).A, expected, rtol=0, atol=5.1e-9)


def test_b_at_the_worked_point() -> None:
    B = NOMINAL.linearise(XI, U).B
    np.testing.assert_allclose(B[:, 0], [-0.0192693, 0.61300058, 0.35417485], rtol=0, atol=2e-8)
    np.testing.assert_allclose(B[2, 1:], [-1.77737e-6, -1.84431e-6, 1.84431e-6, 1.91126e-6], rtol=1e-4)
    np.testing.assert_allclose(B[0, 1:], T / 1723, rtol=1e-12)
    np.testing.assert_allclose(B[1, 1:], [0.02 * T / 1723, 0, 0, 0.02 * T / 1723], rtol=1e-12)


@given(states, inputs)
def test_jacobians_are_those_of_the_step(xi: np.ndarray, u: np.ndarray) -> None:
    linear = NOMINAL.linearise(xi, u)
    A, B = differences(NOMINAL, xi, u)
    np.testing.assert_allclose(linear.A, A, rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(linear.B[:, 0], B[:, 0], rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(linear.B[:, 1:], B[:, 1:], rtol=1e-6, atol=1e-12)


@given(states, inputs, st.floats(-1, 1), st.floats(-1, 1))
def test_uncertainty_is_that_of_the_cornering_stiffnesses(
    xi: np.ndarray, u: np.ndarray, lambda_f: float, lambda_r: float
) -> None:
    A, B = NOMINAL.linearise(xi, u).at(lambda_f, lambda_r)
    A_other, B_other = differences(stiffened(lambda_f, lambda_r), xi, u)
    np.testing.assert_allclose(A, A_other, rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(B[:, 0], B_other[:, 0], rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(B[:, 1:], B_other[:, 1:], rtol=1e-6, atol=1e-12)


@given(states, inputs)
def test_uncertainty_enters_by_the_axles_lateral_forces(xi: np.ndarray, u: np.ndarray) -> None:
    """(26), corrected: H by force, drag and moment of the axles' forces; nothing of it comes from the drive forces."""
    linear = NOMINAL.linearise(xi, u)
    delta = u[0]
    np.testing.assert_allclose(linear.H[:, 0], T * np.array([-delta / 1723, 1 / 1723, 1.4 / 4175]), rtol=1e-12)
    np.testing.assert_allclose(linear.H[:, 2], T * np.array([0, 1 / 1723, -1.6 / 4175]), rtol=1e-12)
    assert not linear.H[1:, 1].any()
    assert not linear.N2[:, 1:].any()
    assert not linear.N2[2].any()


def test_virtual_inputs_go_through_to_the_uncertainty(allocation: Allocation) -> None:
    linear = NOMINAL.linearise(XI, U)
    virtual = linear.with_inputs(allocation.matrix)
    for corner in ((0.0, 0.0), (1.0, -1.0), (-0.3, 0.8)):
        (A, B), (A_virtual, B_virtual) = linear.at(*corner), virtual.at(*corner)
        np.testing.assert_array_equal(A_virtual, A)
        np.testing.assert_allclose(B_virtual, B @ allocation.matrix, rtol=1e-12, atol=1e-18)


@pytest.mark.parametrize("v", np.linspace(5, 40, 36))
def test_nominal_car_is_stable(v: float) -> None:
    assert np.abs(np.linalg.eigvals(NOMINAL.linearise(*straight(v)).A)).max() < 1.0


def yaw_gain(model: VehicleModel, v: float) -> float:
    """Steady yaw rate for a radian of steering, of the linearised model."""
    linear = model.linearise(*straight(v))
    return float(np.linalg.solve(np.eye(2) - lateral(linear.A), linear.B[1:, 0])[1])


def test_yaw_rate_gain_at_20_mps() -> None:
    assert yaw_gain(NOMINAL, 20.0) == pytest.approx(4.898, abs=5e-4)


@pytest.mark.parametrize("v", [5.0, 15.0, 25.0, 40.0])
def test_understeer_gradient(v: float) -> None:
    assert (v / yaw_gain(NOMINAL, v) - 3.0) / v**2 == pytest.approx(2.7091e-3, abs=5e-8)


def test_characteristic_speed_has_the_largest_yaw_gain() -> None:
    speeds = np.arange(20.0, 45.0, 0.01)
    gains = [yaw_gain(NOMINAL, v) for v in speeds]
    assert speeds[np.argmax(gains)] == pytest.approx(33.28, abs=0.011)


def test_critical_speed_of_the_oversteering_corner() -> None:
    def margin(v: float) -> float:
        A, _ = NOMINAL.linearise(*straight(v)).at(1.0, -1.0)
        return float(np.linalg.det(np.eye(2) - lateral(A)))

    critical = brentq(margin, 20.0, 40.0)
    assert critical == pytest.approx(28.14, abs=5e-3)
    for v, stable in ((critical - 0.5, True), (critical + 0.5, False)):
        A, _ = NOMINAL.linearise(*straight(v)).at(1.0, -1.0)
        assert bool(np.abs(np.linalg.eigvals(lateral(A))).max() < 1.0) is stable


@settings(max_examples=50)
@given(st.floats(5, 45), st.floats(-0.3, 0.3))
def test_steady_lateral_velocity_is_a_steady_state_of_the_model(v: float, gamma: float) -> None:
    def moving(unknown: np.ndarray) -> np.ndarray:
        """What still changes, for a lateral velocity, a steering angle and a drive force (kN) of the rear wheels."""
        v_y, delta, force = unknown
        return NOMINAL.derivative(np.array([v, v_y, gamma]), np.array([delta, 0, 500 * force, 500 * force, 0]))

    solution = root(moving, np.zeros(3), options={"xtol": 1e-12}).x
    np.testing.assert_allclose(moving(solution), 0.0, atol=1e-9)
    assert NOMINAL.steady_lateral_velocity(v, gamma) == pytest.approx(solution[0], abs=1e-8)


def test_drive_forces_do_what_the_wheels_order_says(model: VehicleModel) -> None:
    """Front left, rear left, rear right, front right; positive yaw is to the left."""
    xi, u = straight(20.0)
    still = model.derivative(xi, u)
    for wheel, turns_left in ((1, False), (2, False), (3, True), (4, True)):
        push = u.copy()
        push[wheel] = 1000.0
        change = model.derivative(xi, push) - still
        assert change[0] == pytest.approx(1000.0 / 1723)
        assert change[1] == 0.0
        assert bool(change[2] > 0) is turns_left
    assert (model.derivative(xi, np.array([0.01, 0, 0, 0, 0])) - still)[1:].min() > 0
