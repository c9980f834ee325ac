"""The steady-state target: no offset where the inputs allow it, the reference and nearly rest where they do not."""

import cvxpy
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.control.allocation import allocate
from bench.control.quadratic import minimise
from bench.control.target import Target, steady_state_target
from bench.control.vehicle_model import VehicleModel
from platoon_fmu.parameters import VehicleParameters

T = 0.01
MODEL = VehicleModel(VehicleParameters(), T)
ALLOCATION = allocate(VehicleParameters(), 0.5, 3000.0, 0.25)
LIMIT = ALLOCATION.limit
UNIT = np.array([1.0, 5.0, 0.2])


def linear(v: float, gamma: float, delta: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    xi = np.array([v, MODEL.steady_lateral_velocity(v, gamma), gamma])
    model = MODEL.linearise(xi, np.array([delta, 0.0, 0.0, 0.0, 0.0]))
    return model.A, model.B @ ALLOCATION.matrix


def solve(
    A: np.ndarray,
    B: np.ndarray,
    disturbance: np.ndarray,
    u_ref: np.ndarray,
    lower: np.ndarray = -LIMIT,
    upper: np.ndarray = LIMIT,
) -> Target:
    return steady_state_target(A, B, disturbance, u_ref, lower, upper, UNIT, LIMIT)


def stated(
    A: np.ndarray,
    B: np.ndarray,
    disturbance: np.ndarray,
    u_ref: np.ndarray,
    lower: np.ndarray = -LIMIT,
    upper: np.ndarray = LIMIT,
) -> tuple[np.ndarray, np.ndarray] | None:
    """(47)-(49) in cvxpy: rest exactly, speed and yaw rate at the reference, inputs small; None where infeasible."""
    xi, share = cvxpy.Variable(3), cvxpy.Variable(3)
    u = cvxpy.multiply(LIMIT, share)
    rest = xi - A @ xi - B @ (u - u_ref) - disturbance
    constraints = [cvxpy.multiply(1 / UNIT, rest) == 0, xi[0] == 0, xi[2] == 0]
    constraints += [share >= lower / LIMIT, share <= upper / LIMIT]
    cost = cvxpy.sum_squares(share) + 1e-3 * cvxpy.square(xi[1] / UNIT[1])
    problem = cvxpy.Problem(cvxpy.Minimize(cost), constraints)
    problem.solve(solver=cvxpy.CLARABEL)
    if problem.status != cvxpy.OPTIMAL:
        return None
    return xi.value, LIMIT * share.value - u_ref


speeds = st.floats(6, 40)
yaw_rates = st.floats(-0.2, 0.2)
disturbances = st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(-0.3, 0.3)).map(lambda d: T * np.array(d))


@given(speeds, yaw_rates, disturbances, st.tuples(st.floats(-0.05, 0.05), st.floats(-1000, 1000), st.floats(-50, 50)))
def test_disturbed_model_rests_at_the_target_without_offset(
    v: float, gamma: float, disturbance: np.ndarray, u_ref: tuple[float, float, float]
) -> None:
    A, B = linear(v, gamma)
    target = solve(A, B, disturbance, np.array(u_ref))
    assert target.solved
    np.testing.assert_allclose(target.xi, A @ target.xi + B @ target.u + disturbance, atol=1e-9)
    assert target.xi[0] == pytest.approx(0.0, abs=1e-9)
    assert target.xi[2] == pytest.approx(0.0, abs=1e-9)
    assert (np.abs(u_ref + target.u) <= LIMIT * (1 + 1e-9)).all()


@pytest.mark.parametrize("seed", range(20))
def test_feasible_targets_are_those_cvxpy_finds(seed: int) -> None:
    random = np.random.default_rng(seed)
    A, B = linear(random.uniform(6, 40), random.uniform(-0.2, 0.2), random.uniform(-0.05, 0.05))
    disturbance = T * random.uniform(-1, 1, 3) * [1.0, 1.0, 0.3]
    u_ref = random.uniform(-0.2, 0.2, 3) * LIMIT
    expected = stated(A, B, disturbance, u_ref)
    assert expected is not None
    target = solve(A, B, disturbance, u_ref)
    np.testing.assert_allclose(target.xi / UNIT, expected[0] / UNIT, atol=1e-5)
    np.testing.assert_allclose(target.u / LIMIT, expected[1] / LIMIT, atol=1e-5)


@given(speeds, yaw_rates, disturbances, st.tuples(*[st.floats(-0.3, 0.3)] * 3), st.tuples(*[st.floats(-1, 1)] * 3))
def test_targets_at_rest_are_those_of_the_whole_programme(
    v: float, gamma: float, disturbance: np.ndarray, u_ref: tuple[float, ...], place: tuple[float, ...]
) -> None:
    """Six variables, their equalities and bounds, active or not, as the general solver has them."""
    A, B = linear(v, gamma)
    ref = np.array(u_ref) * LIMIT
    middle = ref + 0.03 * np.array(place) * LIMIT
    lower, upper = middle - 0.05 * LIMIT, middle + 0.05 * LIMIT
    rest = np.hstack([(np.eye(3) - A) * UNIT, -B * LIMIT]) / UNIT[:, None]
    least = np.array([0.0, -np.inf, 0.0, *(lower / LIMIT)])
    most = np.array([0.0, np.inf, 0.0, *(upper / LIMIT)])
    cost = np.diag([1e-3, 1e-3, 1e-3, 1.0, 1.0, 1.0])
    whole = minimise(cost, np.zeros(6), least, most, (rest, (disturbance - B @ ref) / UNIT))
    if whole.solved:
        target = solve(A, B, disturbance, ref, lower, upper)
        # The general solver takes a bound as met within 1e-6; v_y is that much less certain than the inputs.
        np.testing.assert_allclose(target.xi / UNIT, whole.x[:3], atol=1e-4)
        np.testing.assert_allclose((ref + target.u) / LIMIT, whole.x[3:], atol=5e-6)


def test_without_disturbance_the_reference_is_the_target() -> None:
    A, B = linear(20.0, 0.0)
    target = solve(A, B, np.zeros(3), np.zeros(3))
    np.testing.assert_allclose(target.xi, 0.0, atol=1e-12)
    np.testing.assert_allclose(target.u, 0.0, atol=1e-9)


@given(speeds, yaw_rates, disturbances, st.tuples(*[st.floats(-0.9, 0.9)] * 3))
def test_bound_by_rates_the_target_stays_at_the_reference(
    v: float, gamma: float, disturbance: np.ndarray, place: tuple[float, float, float]
) -> None:
    """Bounds about the last input, too tight to reject anything: the inputs stay inside, speed and yaw rate stay."""
    A, B = linear(v, gamma)
    last = np.array(place) * LIMIT
    lower, upper = last - 1e-3 * LIMIT, last + 1e-3 * LIMIT
    target = solve(A, B, disturbance, np.zeros(3), lower, upper)
    assert target.solved
    assert target.xi[0] == pytest.approx(0.0, abs=1e-9)
    assert target.xi[2] == pytest.approx(0.0, abs=1e-9)
    assert (target.u >= lower - 1e-9 * LIMIT).all()
    assert (target.u <= upper + 1e-9 * LIMIT).all()


@pytest.mark.parametrize(("disturbance", "bound"), [(-20.0 * T, 1), (20.0 * T, -1)])
def test_force_that_cannot_hold_the_speed_comes_as_near_as_it_can(disturbance: float, bound: int) -> None:
    """20 m/s^2 down or up a slope: no exact target, the whole force against it, the yaw untouched."""
    A, B = linear(20.0, 0.0)
    d = np.array([disturbance, 0.0, 0.0])
    assert stated(A, B, d, np.zeros(3)) is None
    target = solve(A, B, d, np.zeros(3))
    assert target.u[1] == pytest.approx(bound * LIMIT[1])
    np.testing.assert_allclose(target.xi[[0, 2]], 0.0, atol=1e-9)
    np.testing.assert_allclose(target.u[[0, 2]] / LIMIT[[0, 2]], 0.0, atol=1e-6)


@pytest.mark.parametrize("seed", range(10))
def test_infeasible_targets_leave_least_drift(seed: int) -> None:
    """Where rest is out of reach, what is left of it is the least that the bounds allow, as cvxpy has it."""
    random = np.random.default_rng(100 + seed)
    A, B = linear(random.uniform(6, 40), random.uniform(-0.2, 0.2))
    disturbance = T * random.uniform(-1, 1, 3) * [1.0, 1.0, 0.3]
    lower = random.uniform(-0.9, 0.9, 3) * LIMIT
    upper = lower + 1e-2 * LIMIT
    assert stated(A, B, disturbance, np.zeros(3), lower, upper) is None
    target = solve(A, B, disturbance, np.zeros(3), lower, upper)

    v_y, share = cvxpy.Variable(), cvxpy.Variable(3)
    xi = cvxpy.hstack([0.0, v_y, 0.0])
    rest = cvxpy.multiply(1 / UNIT, xi - A @ xi - B @ cvxpy.multiply(LIMIT, share) - disturbance)
    problem = cvxpy.Problem(cvxpy.Minimize(cvxpy.sum_squares(rest)), [share >= lower / LIMIT, share <= upper / LIMIT])
    problem.solve(solver=cvxpy.CLARABEL)
    drift = (target.xi - A @ target.xi - B @ target.u - disturbance) / UNIT
    assert np.linalg.norm(drift) == pytest.approx(np.sqrt(problem.value), rel=1e-2, abs=2e-3)


def test_unsolvable_bounds_fall_back_to_the_reference_inside_them() -> None:
    A, B = linear(20.0, 0.0)
    broken = np.full(3, np.nan)
    target = solve(A, B, broken, np.array([0.9, 0.0, 0.0]))
    assert not target.solved
    np.testing.assert_array_equal(target.xi, 0.0)
    np.testing.assert_allclose(0.9 + target.u[0], LIMIT[0])
