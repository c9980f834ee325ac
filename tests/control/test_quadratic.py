"""Small quadratic programmes against cvxpy and against their optimality conditions."""

import cvxpy
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.control.quadratic import minimise


def problem(seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A random strictly convex programme: H, g, bounds (some of them infinite), E, e; feasible or not."""
    random = np.random.default_rng(seed)
    n, m = int(random.integers(2, 8)), int(random.integers(1, 3))
    root = random.normal(size=(n, n))
    lower = -random.uniform(0.1, 2.0, n)
    upper = random.uniform(0.1, 2.0, n)
    lower[random.random(n) < 0.3] = -np.inf
    upper[random.random(n) < 0.3] = np.inf
    E = random.normal(size=(m, n))
    inside = np.clip(random.normal(size=n), lower, upper)
    return root @ root.T + 0.1 * np.eye(n), 3.0 * random.normal(size=n), lower, upper, E, E @ inside


def reference_solution(
    H: np.ndarray, g: np.ndarray, lower: np.ndarray, upper: np.ndarray, E: np.ndarray, e: np.ndarray
) -> np.ndarray | None:
    x = cvxpy.Variable(g.size)
    below, above = np.isfinite(lower), np.isfinite(upper)
    constraints = [x[below] >= lower[below], x[above] <= upper[above]]
    if e.size:
        constraints.append(E @ x == e)
    stated = cvxpy.Problem(cvxpy.Minimize(0.5 * cvxpy.quad_form(x, cvxpy.psd_wrap(H)) + g @ x), constraints)
    stated.solve(solver=cvxpy.CLARABEL)
    return x.value if stated.status == cvxpy.OPTIMAL else None


@pytest.mark.parametrize("seed", range(25))
def test_box_and_equalities_as_cvxpy_has_it(seed: int) -> None:
    H, g, lower, upper, E, e = problem(seed)
    found = minimise(H, g, lower, upper, (E, e))
    expected = reference_solution(H, g, lower, upper, E, e)
    assert expected is not None
    assert found.solved
    np.testing.assert_allclose(found.x, expected, atol=1e-5)


@pytest.mark.parametrize("seed", range(25))
def test_box_alone_as_cvxpy_has_it(seed: int) -> None:
    H, g, lower, upper, E, _ = problem(seed)
    found = minimise(H, g, lower, upper)
    expected = reference_solution(H, g, lower, upper, E[:0], np.zeros(0))
    assert expected is not None
    assert found.solved
    np.testing.assert_allclose(found.x, expected, atol=1e-5)


@given(st.integers(0, 10**6))
def test_box_solutions_meet_the_optimality_conditions(seed: int) -> None:
    """Inside the box the gradient is zero; at a bound it points out of the box."""
    H, g, lower, upper, _, _ = problem(seed)
    found = minimise(H, g, lower, upper)
    assert found.solved
    slope = H @ found.x + g
    assert (found.x >= lower - 1e-9).all()
    assert (found.x <= upper + 1e-9).all()
    assert (slope[found.x > lower + 1e-7] <= 1e-5).all()
    assert (slope[found.x < upper - 1e-7] >= -1e-5).all()


@given(st.integers(0, 10**6))
def test_box_solutions_are_those_of_the_general_solver(seed: int) -> None:
    """No equality, and none of zero rows, which only the general solver takes."""
    H, g, lower, upper, E, e = problem(seed)
    found = minimise(H, g, lower, upper)
    general = minimise(H, g, lower, upper, (E[:0], e[:0]))
    assert found.solved
    np.testing.assert_allclose(found.x, general.x, atol=1e-6)


def test_fixed_variables_stay_where_they_are() -> None:
    bound = np.array([0.5, -np.inf])
    found = minimise(np.array([[2.0, 1.0], [1.0, 2.0]]), np.array([-3.0, -3.0]), bound, np.array([0.5, np.inf]))
    np.testing.assert_allclose(found.x, [0.5, 1.25], atol=1e-12)


@pytest.mark.parametrize("seed", range(10))
def test_infeasible_is_said(seed: int) -> None:
    """Equalities that no point of a closed box meets."""
    H, g, _, _, E, _ = problem(seed)
    box = np.ones(g.size)
    e = 1.5 * np.abs(E).sum(axis=1)
    assert reference_solution(H, g, -box, box, E, e) is None
    assert not minimise(H, g, -box, box, (E, e)).solved


def test_contradicting_equalities_are_infeasible() -> None:
    E = np.array([[1.0, 0.0], [1.0, 0.0]])
    free = np.full(2, np.inf)
    assert not minimise(np.eye(2), np.zeros(2), -free, free, (E, np.array([0.0, 1.0]))).solved


def test_bounds_the_wrong_way_round_are_infeasible() -> None:
    assert not minimise(np.eye(2), np.zeros(2), np.array([1.0, -1.0]), np.array([0.0, 1.0])).solved


def test_not_a_number_is_not_solved() -> None:
    assert not minimise(np.eye(2), np.array([np.nan, 0.0]), -np.ones(2), np.ones(2)).solved


def test_arguments_are_not_changed() -> None:
    H, g, lower, upper, E, e = problem(3)
    arguments = [H, g, lower, upper, E, e]
    copies = [a.copy() for a in arguments]
    minimise(H, g, lower, upper, (E, e))
    for argument, copy in zip(arguments, copies, strict=True):
        np.testing.assert_array_equal(argument, copy)


def test_matrices_that_are_views_are_read_right() -> None:
    """Transposed and strided arrays hold the same numbers in another order."""
    H, g, lower, upper, E, e = problem(4)
    wide = np.repeat(E, 2, axis=1)[:, ::2]
    plain = minimise(H, g, lower, upper, (E, e))
    wide_H = np.repeat(H, 2, axis=1)[:, ::2]
    np.testing.assert_array_equal(minimise(wide_H, g, lower, upper, (E, e)).x, plain.x)
    np.testing.assert_array_equal(minimise(H.T, g, lower, upper, (wide, e)).x, plain.x)
    np.testing.assert_array_equal(minimise(H, g, lower, upper, (np.asfortranarray(E), e)).x, plain.x)
