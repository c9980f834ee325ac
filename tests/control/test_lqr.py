"""The fallback gain against the Riccati equation and against the cost it is to minimise."""

import numpy as np
import pytest

from bench.control.allocation import Allocation
from bench.control.lqr import lqr_gain
from bench.control.vehicle_model import VehicleModel

Q = np.diag([1.0, 0.04, 25.0])
R = np.diag([100.0, 2.5e-7, 1e-6])


def linear(model: VehicleModel, allocation: Allocation, v: float) -> tuple[np.ndarray, np.ndarray]:
    found = model.linearise(np.array([v, 0.0, 0.0]), np.zeros(5))
    return found.A, found.B @ allocation.matrix


def cost_matrix(A: np.ndarray, B: np.ndarray, K: np.ndarray) -> np.ndarray:
    """S of the cost x'Sx of u = Kx, by adding up the steps (doubling)."""
    S, step = Q + K.T @ R @ K, A + B @ K
    for _ in range(40):
        S, step = S + step.T @ S @ step, step @ step
    return S


@pytest.mark.parametrize("v", [5.0, 12.0, 20.0, 30.0, 40.0])
def test_cost_of_the_gain_solves_the_riccati_equation(model: VehicleModel, allocation: Allocation, v: float) -> None:
    A, B = linear(model, allocation, v)
    K = lqr_gain(A, B, Q, R)
    S = cost_matrix(A, B, K)
    residual = A.T @ S @ A - S + Q - A.T @ S @ B @ np.linalg.solve(R + B.T @ S @ B, B.T @ S @ A)
    np.testing.assert_allclose(residual / np.abs(S).max(), 0.0, atol=1e-9)
    np.testing.assert_allclose(K, -np.linalg.solve(R + B.T @ S @ B, B.T @ S @ A), rtol=1e-6, atol=1e-9)
    assert np.abs(np.linalg.eigvals(A + B @ K)).max() < 1.0


def test_other_gains_cost_more(model: VehicleModel, allocation: Allocation) -> None:
    A, B = linear(model, allocation, 20.0)
    K = lqr_gain(A, B, Q, R)
    best = cost_matrix(A, B, K)
    random = np.random.default_rng(0)
    for _ in range(20):
        other = K * (1 + 0.2 * random.normal(size=K.shape))
        assert np.abs(np.linalg.eigvals(A + B @ other)).max() < 1.0
        assert np.linalg.eigvalsh(cost_matrix(A, B, other) - best)[0] > -1e-9 * np.abs(best).max()


def test_scalar_system() -> None:
    """x+ = 2x + u with Q = R = 1: S^2 - 4S - 1 = 0, so S = 2 + sqrt 5 and K = -2S/(1 + S)."""
    S = 2 + np.sqrt(5)
    one = np.eye(1)
    np.testing.assert_allclose(lqr_gain(2 * one, one, one, one), [[-2 * S / (1 + S)]])


def test_what_cannot_be_stabilised_is_refused() -> None:
    with pytest.raises(ValueError, match="no stabilising gain"):
        lqr_gain(np.diag([1.5, 0.5]), np.array([[0.0], [1.0]]), np.eye(2), np.eye(1))
