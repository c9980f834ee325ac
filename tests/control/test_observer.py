"""The disturbance observer: the printed recursion, and estimates that arrive at a constant disturbance."""

from collections.abc import Iterator

import numpy as np
import pytest

from bench.control.observer import DisturbanceObserver, augmented
from bench.control.observer_gain import design_gain
from bench.control.vehicle_model import VehicleModel
from platoon_fmu.parameters import VehicleParameters

T = 0.01
RATE = 0.9
MODEL = VehicleModel(VehicleParameters(), T)


def linear(v: float, gamma: float = 0.0, delta: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    xi = np.array([v, MODEL.steady_lateral_velocity(v, gamma), gamma])
    model = MODEL.linearise(xi, np.array([delta, 0.0, 0.0, 0.0, 0.0]))
    return model.A, model.B


@pytest.fixture(scope="module")
def gain() -> np.ndarray:
    return design_gain([linear(v)[0] for v in (5.0, 10.0, 20.0, 40.0)], T, RATE)


class Course:
    """Steps of a wandering reference: the model there, this and the next reference state, an input, a drift."""

    def __init__(self, steps: int, seed: int) -> None:
        self._random = np.random.default_rng(seed)
        self._steps = steps

    def __iter__(self) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
        random = self._random
        v, gamma = 20.0, 0.0
        xi_next = np.array([v, 0.0, gamma])
        for _ in range(self._steps):
            xi = xi_next
            v, gamma = v + random.uniform(-0.03, 0.03), gamma + random.uniform(-0.01, 0.01)
            xi_next = np.array([v, MODEL.steady_lateral_velocity(v, gamma), gamma])
            residual = random.normal(size=3) * 1e-3
            A, B = linear(xi[0], xi[2], random.uniform(-0.05, 0.05))
            u_dev = random.normal(size=5) * [0.02, 200.0, 200.0, 200.0, 200.0]
            yield A, B, xi, xi_next + residual, u_dev


def test_augmented_model_carries_a_constant_disturbance() -> None:
    A, _ = linear(20.0)
    expected = np.eye(6)
    expected[:3, :3] = A
    expected[:3, 3:] = T * np.eye(3)
    np.testing.assert_array_equal(augmented(A, T), expected)


def test_recursion_is_the_matrix_form(gain: np.ndarray) -> None:
    """(39): Pi^+ = A_obs Pi^ + B_obs ubar + L (C_obs Pi^ - xibar), deviations taken from where the reference drifts."""
    random = np.random.default_rng(0)
    observer = DisturbanceObserver(gain, T)
    C = np.hstack([np.eye(3), np.zeros((3, 3))])
    state: np.ndarray | None = None
    disturbance = np.zeros(3)
    for A, B, xi_ref, drift, u_dev in Course(200, seed=1):
        xi = xi_ref + random.normal(size=3) * [0.3, 0.2, 0.05]
        state = xi if state is None else state
        Pi = np.concatenate([state - xi_ref, disturbance])
        Pi = augmented(A, T) @ Pi + np.vstack([B, np.zeros((3, 5))]) @ u_dev + gain @ (C @ Pi - (xi - xi_ref))
        state, disturbance = drift + Pi[:3], Pi[3:]
        np.testing.assert_allclose(observer.correct(xi), disturbance, rtol=1e-9, atol=1e-9)
        observer.predict(A, B, xi_ref, u_dev, drift)


def estimates(gain: np.ndarray, true: np.ndarray, steps: int) -> np.ndarray:
    """The disturbance estimates while the linear model wanders with the reference under a constant disturbance."""
    observer = DisturbanceObserver(gain, T)
    xi: np.ndarray | None = None
    found = []
    for A, B, xi_ref, drift, u_dev in Course(steps, seed=2):
        xi = xi_ref + np.array([0.5, -0.2, 0.05]) if xi is None else xi
        found.append(observer.correct(xi))
        observer.predict(A, B, xi_ref, u_dev, drift)
        xi = drift + A @ (xi - xi_ref) + B @ u_dev + T * true
    return np.array(found)


def test_estimate_arrives_at_a_constant_disturbance(gain: np.ndarray) -> None:
    true = np.array([-0.8, 0.5, 0.2])
    error = np.abs(estimates(gain, true, 300) - true).max(axis=1)
    assert error[0] == 0.8
    assert error[300 - 1] < 1e-9
    # At the designed rate from 10 % of the start on, whatever the transient was.
    late = int(np.argmax(error < 0.08))
    assert late < 60
    assert error[late + 100] < 100 * 0.08 * RATE**100


def test_without_disturbance_nothing_is_estimated(gain: np.ndarray) -> None:
    np.testing.assert_allclose(estimates(gain, np.zeros(3), 100), 0.0, atol=1e-9)


def test_estimate_follows_a_step_of_the_disturbance(gain: np.ndarray) -> None:
    """Driven by the input that was applied, the observer sees only what the model does not explain."""
    observer = DisturbanceObserver(gain, T)
    A, B = linear(20.0)
    xi_ref = np.array([20.0, 0.0, 0.0])
    xi = xi_ref.copy()
    seen = []
    for k in range(400):
        true = np.array([0.0, 0.0 if k < 200 else 1.0, 0.0])
        u_dev = np.array([0.03 * np.sin(0.1 * k), 100.0, 0.0, 0.0, -100.0])
        seen.append(observer.correct(xi))
        observer.predict(A, B, xi_ref, u_dev, xi_ref)
        xi = xi_ref + A @ (xi - xi_ref) + B @ u_dev + T * true
    np.testing.assert_allclose(seen[:200], 0.0, atol=1e-9)
    np.testing.assert_allclose(seen[-1], [0.0, 1.0, 0.0], atol=1e-6)


def test_first_measurement_starts_without_disturbance(gain: np.ndarray) -> None:
    observer = DisturbanceObserver(gain, T)
    np.testing.assert_array_equal(observer.correct(np.array([20.0, 0.3, 0.1])), 0.0)


def test_predicting_before_measuring_is_refused(gain: np.ndarray) -> None:
    A, B = linear(20.0)
    with pytest.raises(ValueError, match="first measurement"):
        DisturbanceObserver(gain, T).predict(A, B, np.zeros(3), np.zeros(5), np.zeros(3))
