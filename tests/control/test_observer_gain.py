"""The observer's gain: its decay rate at every speed, and the matrix inequality stated again in cvxpy."""

from collections.abc import Sequence

import cvxpy
import numpy as np
import pytest

from bench.control.observer import augmented
from bench.control.observer_gain import design_gain
from bench.control.vehicle_model import VehicleModel
from platoon_fmu.parameters import VehicleParameters

T = 0.01
VERTICES = (5.0, 10.0, 20.0, 40.0)
RATES = (0.6, 0.8, 0.9, 0.95)
MODEL = VehicleModel(VehicleParameters(), T)


def straight(v: float) -> np.ndarray:
    return MODEL.linearise(np.array([v, 0.0, 0.0]), np.zeros(5)).A


def cornering(v: float, gamma: float, delta: float) -> np.ndarray:
    xi = np.array([v, MODEL.steady_lateral_velocity(v, gamma), gamma])
    return MODEL.linearise(xi, np.array([delta, 0.0, 0.0, 0.0, 0.0])).A


def error_dynamics(A: np.ndarray, L: np.ndarray) -> np.ndarray:
    """A_obs + L C_obs with the disturbance in units of one step's change, as (38) prints it."""
    scale = np.array([1.0] * 3 + [T] * 3)
    closed = augmented(A, T)
    closed[:, :3] += L
    return closed * scale[:, None] / scale


def radius(A: np.ndarray, L: np.ndarray) -> float:
    return float(np.abs(np.linalg.eigvals(error_dynamics(A, L))).max())


def common_ellipsoid(models: Sequence[np.ndarray], L: np.ndarray, rate: float) -> np.ndarray | None:
    """P >= I with E'PE <= rate^2 P for E = A_obs + L C_obs of all models, from cvxpy; None if there is none."""
    P = cvxpy.Variable((6, 6), symmetric=True)
    constraints = [P >> np.eye(6)]
    for A in models:
        E = error_dynamics(A, L)
        constraints.append(rate**2 * P - E.T @ P @ E >> 0)
    problem = cvxpy.Problem(cvxpy.Minimize(cvxpy.trace(P)), constraints)
    problem.solve(solver=cvxpy.CLARABEL)
    return P.value if problem.status == cvxpy.OPTIMAL else None


@pytest.fixture(scope="module", params=RATES)
def designed(request: pytest.FixtureRequest) -> tuple[float, np.ndarray]:
    return request.param, design_gain([straight(v) for v in VERTICES], T, request.param)


def test_errors_decay_at_every_speed(designed: tuple[float, np.ndarray]) -> None:
    rate, L = designed
    assert max(radius(straight(v), L) for v in np.linspace(5.0, 45.0, 401)) <= rate


def test_errors_decay_when_cornering_at_the_boundary(designed: tuple[float, np.ndarray]) -> None:
    rate, L = designed
    worst = max(
        radius(cornering(v, side * 0.85 * 7.84 / v, side * 0.05), L)
        for v in np.linspace(8.0, 45.0, 75)
        for side in (-1, 1)
    )
    assert worst <= rate


def test_one_ellipsoid_proves_the_rate_at_all_vertices(designed: tuple[float, np.ndarray]) -> None:
    """(40) with a true rate, for the gain found: so it holds while the speed changes, too."""
    rate, L = designed
    P = common_ellipsoid([straight(v) for v in VERTICES], L, rate + 2e-4)
    assert P is not None
    root = np.linalg.cholesky(P).T
    for v in VERTICES:
        growth = np.linalg.norm(root @ error_dynamics(straight(v), L) @ np.linalg.inv(root), 2)
        assert growth <= rate + 1e-3


def test_no_ellipsoid_proves_a_rate_that_a_gain_does_not_have() -> None:
    """The statement above can fail: the gain for 0.95 does not reach 0.8."""
    L = design_gain([straight(v) for v in VERTICES], T, 0.95)
    assert common_ellipsoid([straight(v) for v in VERTICES], L, 0.8) is None


def test_smaller_rate_takes_a_larger_gain() -> None:
    sizes = [np.abs(design_gain([straight(v) for v in VERTICES], T, rate)).max() for rate in RATES]
    assert sizes == sorted(sizes, reverse=True)


@pytest.mark.parametrize("rate", [0.05, 0.1])
def test_rate_out_of_reach_is_refused(rate: float) -> None:
    """One gain for all speeds cannot be deadbeat at each of them."""
    with pytest.raises(ValueError, match=rf"no observer gain with decay rate {rate}.*raise observer_rate"):
        design_gain([straight(v) for v in VERTICES], T, rate)


def test_single_model_can_be_made_much_faster() -> None:
    """At one speed alone the same rate is in reach: it is the range of speeds that forbids it."""
    L = design_gain([straight(20.0)], T, 0.1)
    assert radius(straight(20.0), L) <= 0.1 + 1e-4
