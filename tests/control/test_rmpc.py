"""The robust MPC against its matrix inequalities in cvxpy and in simulation."""

from dataclasses import replace

import cvxpy
import numpy as np
import pytest

from bench.control.outcome import GainSource, SolverStatus
from bench.control.program import Answer
from bench.control.programs import programs
from bench.control.riccati_program import RiccatiProgram
from bench.control.rmpc import RobustController
from bench.control.robust_program import RobustProgram
from bench.control.vehicle_model import LinearModel
from bench.examples.lmi_tracker import RobustMpc
from tests.control.operating_points import (
    ALLOCATION,
    EQUAL,
    INDEPENDENT,
    INPUT,
    POINTS,
    STATE,
    Models,
    OperatingPoint,
    accumulate,
    controller,
    operating_point,
    semidefinite_controller,
)


def vertex_oracle(models: Models, z: np.ndarray, room: np.ndarray, rho: float = 1.0) -> float:
    """The least tau of the vertex form with the arrow (63) left whole; scaled units, in cvxpy."""
    n, m = 3, room.size
    P, Y, tau = cvxpy.Variable((n, n), symmetric=True), cvxpy.Variable((m, n)), cvxpy.Variable()
    # In units in which tau is near one the solver is at its most accurate.
    R, Q, unit = rho * np.eye(m), np.eye(n), 300.0
    constraints = []
    for A, B in models:
        closed = A @ P + B @ Y
        arrow = cvxpy.bmat(
            [
                [P, Y.T @ R, closed.T, P @ Q],
                [R @ Y, unit * tau * R, np.zeros((m, n)), np.zeros((m, n))],
                [closed, np.zeros((n, m)), P, np.zeros((n, n))],
                [Q @ P, np.zeros((n, m)), np.zeros((n, n)), unit * tau * Q],
            ]
        )
        constraints.append(arrow >> 0)
    return solved(tau, [*constraints, *bounds(P, Y, z, room)]) * unit


def optimum(point: OperatingPoint, independent: bool = True, rho: float = 1.0, *, printed: bool = False) -> float:
    """The least tau of (51)-(54), as the example states them; scaled units."""
    stated = RobustMpc(rho, independent=independent, printed=printed)
    answer = stated.solve(point.scaled_linear(), point.chi / STATE, point.room / INPUT)
    assert answer.status is SolverStatus.SOLVED
    return answer.tau


def bounds(P: cvxpy.Variable, Y: cvxpy.Variable, z: np.ndarray, room: np.ndarray) -> list[cvxpy.Constraint]:
    """z in the ellipsoid, (52), and the input bounds, (54)."""
    one = np.ones((1, 1))
    constraints = [cvxpy.bmat([[one, z[None, :]], [z[:, None], P]]) >> 0]
    for j, limit in enumerate(room):
        row = Y[j : j + 1, :] / limit
        constraints.append(cvxpy.bmat([[one, row], [row.T, P]]) >> 0)
    return constraints


class Infeasible(Exception):
    """There is no solution."""


def solved(tau: cvxpy.Variable, constraints: list[cvxpy.Constraint]) -> float:
    problem = cvxpy.Problem(cvxpy.Minimize(tau), constraints)
    problem.solve(solver=cvxpy.CLARABEL)
    if problem.status == cvxpy.INFEASIBLE:
        raise Infeasible
    assert problem.status == cvxpy.OPTIMAL
    return float(tau.value)


@pytest.mark.parametrize("seed", POINTS)
@pytest.mark.parametrize("independent", [False, True], ids=["equal", "independent"])
def test_bound_lies_between_those_of_vertices_and_multipliers(seed: int, independent: bool) -> None:
    """No sound bound is below that of the vertices; a proof at the vertices is no worse than the form that was solved.

    The two are 12 % apart at most at these points (1 % at most of them), so the bound is known that well.
    """
    point = operating_point(seed)
    gain = controller(independent).solve(point.linear, point.chi, point.room)
    assert gain.usable
    z, room = point.chi / STATE, point.room / INPUT
    corners = INDEPENDENT if independent else EQUAL
    vertices = vertex_oracle(point.scaled(corners), z, room)
    multipliers = optimum(point, independent)
    assert vertices * (1 - 1e-3) <= gain.tau <= multipliers * (1 + 1e-3)
    assert multipliers <= 1.12 * vertices


@pytest.mark.parametrize("weight", [1e-3, 1e-1, 10.0])
@pytest.mark.parametrize("seed", range(3))
def test_bound_lies_between_those_at_other_weights(seed: int, weight: float) -> None:
    point = operating_point(seed)
    gain = controller(False, weight).solve(point.linear, point.chi, point.room)
    assert gain.usable
    z, room = point.chi / STATE, point.room / INPUT
    vertices = vertex_oracle(point.scaled(EQUAL), z, room, weight)
    multipliers = optimum(point, False, weight)
    assert vertices * (1 - 1e-3) <= gain.tau <= multipliers * (1 + 1e-2)


@pytest.mark.parametrize("seed", POINTS)
def test_bound_is_never_above_that_of_the_printed_form(seed: int) -> None:
    """(51)-(54) with one epsilon, for lambda_f = lambda_r as the paper has it."""
    point = operating_point(seed)
    gain = controller(False).solve(point.linear, point.chi, point.room)
    assert gain.usable
    assert gain.tau <= optimum(point, False, printed=True) * (1 + 1e-3)


def test_what_the_vertex_form_cannot_do_is_infeasible() -> None:
    """Here so little input is left that no gain exists for all stiffnesses."""
    point = replace(operating_point(4), room=0.02 * ALLOCATION.limit)
    with pytest.raises(Infeasible):
        vertex_oracle(point.scaled(INDEPENDENT), point.chi / STATE, point.room / INPUT)
    assert controller().solve(point.linear, point.chi, point.room).status is SolverStatus.INFEASIBLE


@pytest.mark.parametrize("seed", range(4))
def test_independent_axles_cost_more_than_equal_ones(seed: int) -> None:
    point = operating_point(seed)
    equal = controller(False).solve(point.linear, point.chi, point.room)
    independent = controller().solve(point.linear, point.chi, point.room)
    assert independent.tau >= equal.tau * (1 - 1e-3)


@pytest.mark.parametrize("seed", POINTS)
def test_no_course_of_the_stiffnesses_costs_more_than_the_bound(seed: int) -> None:
    """Anything between the corners, changing every step; each corner for good; and back and forth between them."""
    point = operating_point(seed)
    gain = controller().solve(point.linear, point.chi, point.room)
    assert gain.usable
    random = np.random.default_rng(seed)
    steps = 600
    courses = [random.uniform(-1, 1, (steps, 2)) for _ in range(5)]
    courses += [random.choice([-1.0, 1.0], (steps, 2)) for _ in range(5)]
    courses += [np.tile(corner, (steps, 1)) for corner in INDEPENDENT]
    for course in courses:
        cost, largest = accumulate(point, gain, course)
        assert cost <= gain.tau
        assert (largest <= 1.001 * point.room).all()


@pytest.mark.parametrize("seed", [0, 1, 2, 3, 5, 6])
def test_inputs_stay_inside_tight_bounds(seed: int) -> None:
    """With so little room that it binds, at the worst stiffnesses of each step."""
    point = operating_point(seed)
    free = controller().solve(point.linear, point.chi, 10 * ALLOCATION.limit)
    room = np.maximum(0.6 * np.abs(free.K @ point.chi), 0.02 * ALLOCATION.limit)
    gain = controller().solve(point.linear, point.chi, room)
    assert gain.usable
    assert gain.tau >= free.tau * (1 - 1e-3)
    chi = point.chi
    P_inverse = np.linalg.inv(gain.P)
    for _ in range(300):
        u = gain.K @ chi
        assert (np.abs(u) <= 1.001 * room).all()
        successors = [A @ chi + B @ u for A, B in point.models(INDEPENDENT)]
        chi = max(successors, key=lambda x: float((x / STATE) @ P_inverse @ (x / STATE)))


@pytest.mark.parametrize("seed", POINTS)
def test_bounds_that_do_not_bind_change_nothing(seed: int) -> None:
    """So the program need not have them as long as its answer keeps them."""
    point = operating_point(seed)
    z = point.chi / STATE / np.linalg.norm(point.chi / STATE)
    answers = [
        RobustProgram(3, 1.0, independent=True, bounded=bounded, tolerance=1e-6, max_iterations=60).solve(
            point.scaled_linear(), z, np.full(3, 100.0)
        )
        for bounded in (False, True)
    ]
    assert [answer.status for answer in answers] == [SolverStatus.SOLVED] * 2
    assert answers[0].tau == pytest.approx(answers[1].tau, rel=1e-4)


def certain(A: np.ndarray, B: np.ndarray) -> LinearModel:
    """A model without uncertainty."""
    return LinearModel(A, B, np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3)))


UNSTABLE = certain(1.05 * np.eye(3), 0.1 * np.eye(3))


def unit_controller() -> RobustController:
    tried = programs(3, 1.0, independent=True, tolerance=1e-6, max_iterations=60)
    return RobustController(np.ones(3), np.ones(3), 1.0, tried, independent=True)


@pytest.mark.parametrize("far", [3.0, 30.0, 1e4])
def test_unstable_model_out_of_reach_of_its_inputs_is_not_solved(far: float) -> None:
    """|u| <= 1 holds |x| <= 0.1/0.05 = 2 at most."""
    gain = unit_controller().solve(UNSTABLE, np.array([far, 0.0, 0.0]), np.ones(3))
    assert gain.status in (SolverStatus.INFEASIBLE, SolverStatus.CHECK_FAILED)
    assert not gain.usable


def test_unstable_model_in_reach_of_its_inputs_is_solved() -> None:
    gain = unit_controller().solve(UNSTABLE, np.array([1.5, 0.0, 0.0]), np.ones(3))
    assert gain.usable
    assert np.abs(np.linalg.eigvals(UNSTABLE.A + UNSTABLE.B @ gain.K)).max() < 1.0
    assert abs(gain.K[0, 0] * 1.5) <= 1.001


def test_model_that_no_input_moves_is_not_solved() -> None:
    gain = unit_controller().solve(certain(1.05 * np.eye(3), np.zeros((3, 3))), np.ones(3), np.ones(3))
    assert gain.status in (SolverStatus.INFEASIBLE, SolverStatus.CHECK_FAILED)


def test_too_few_iterations_are_said_and_not_used() -> None:
    point = operating_point(0)
    gain = semidefinite_controller(iterations=5).solve(point.linear, point.chi, point.room)
    assert gain.status is SolverStatus.MAX_ITERATIONS
    assert not gain.usable
    assert gain.iterations == 5


def test_inaccurate_answers_are_caught() -> None:
    """However loose the solver's tolerance, what is called usable has a proof that holds in simulation."""
    loose = semidefinite_controller(tolerance=1e-2)
    for seed in POINTS:
        point = operating_point(seed)
        gain = loose.solve(point.linear, point.chi, point.room)
        assert gain.status in (SolverStatus.SOLVED, SolverStatus.CHECK_FAILED)
        if gain.usable:
            for corner in INDEPENDENT:
                assert accumulate(point, gain, np.tile(corner, (300, 1)))[0] <= gain.tau


def test_not_a_number_is_not_solved() -> None:
    point = operating_point(0)
    gain = controller().solve(point.linear, np.array([np.nan, 0.0, 0.0]), point.room)
    assert not gain.usable


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("size", [0.0, 1e-300, 1e-12, 1e-6, 1e-3])
def test_tiny_deviations_solve(seed: int, size: float) -> None:
    point = operating_point(seed)
    gain = controller().solve(point.linear, size * point.chi, point.room)
    assert gain.usable
    assert np.isfinite(gain.K).all()
    for A, B in point.models(INDEPENDENT):
        assert np.abs(np.linalg.eigvals(A + B @ gain.K)).max() < 1.0
    for corner in INDEPENDENT:
        tiny = OperatingPoint(point.linear, size * point.chi, point.room)
        assert accumulate(tiny, gain, np.tile(corner, (300, 1)))[0] <= gain.tau


def test_rounding_errors_have_no_direction() -> None:
    """What is left of a deviation at the target differs in its last digits, and must not differ in its gain."""
    point = operating_point(2)
    room = 10 * point.room
    gains = [
        controller().solve(point.linear, STATE * error, room)
        for error in (np.zeros(3), 1e-14 * np.ones(3), np.array([0.0, -3e-13, 2e-13]))
    ]
    assert gains[0].usable
    for gain in gains[1:]:
        np.testing.assert_array_equal(gain.K, gains[0].K)
        np.testing.assert_array_equal(gain.P, gains[0].P)
    seen = controller().solve(point.linear, STATE * 1e-10 * np.array([0.0, 0.0, 1.0]), room)
    assert (seen.K != gains[0].K).any()


def test_bound_grows_with_the_square_of_the_deviation_while_inputs_are_free() -> None:
    point = operating_point(4)
    room = 1e3 * ALLOCATION.limit
    one, other = (controller().solve(point.linear, k * point.chi, room) for k in (1.0, 0.5))
    assert one.tau == pytest.approx(4.0 * other.tau, rel=1e-2)


def test_bounds_do_not_depend_on_what_was_solved_before() -> None:
    fresh, used = controller(), controller()
    for seed in (5, 6, 7):
        point = operating_point(seed)
        used.solve(point.linear, point.chi, point.room)
    point = operating_point(8)
    expected = fresh.solve(point.linear, point.chi, point.room)
    again = used.solve(point.linear, point.chi, point.room)
    assert again.tau == pytest.approx(expected.tau, rel=1e-3)


@pytest.mark.parametrize("share", [1.0, 1e9], ids=["usual", "boundless"])
def test_many_operating_points_all_solve(share: float) -> None:
    steady = controller()
    for seed in range(200):
        point = operating_point(seed)
        point = replace(point, room=share * point.room)
        assert steady.solve(point.linear, point.chi, point.room).usable, seed


@pytest.mark.parametrize(("independent", "weight"), [(True, 1.0), (True, 10.0), (False, 0.1), (False, 1.0)])
def test_riccati_equation_has_the_programs_optimum(independent: bool, weight: float) -> None:
    """Without input bounds, from a cold start and from another operating point's multiplier.

    Where the optimum is at the edge of what the Riccati equation can prove, the search says that it has not ended.
    """
    warm = RiccatiProgram(3, weight, independent=independent)
    exact = RobustProgram(3, weight, independent=independent, bounded=False, tolerance=1e-8, max_iterations=100)
    for seed in POINTS:
        point = operating_point(seed)
        z = point.chi / STATE / np.linalg.norm(point.chi / STATE)
        expected = exact.solve(point.scaled_linear(), z, np.full(3, 100.0))
        assert expected.status is SolverStatus.SOLVED
        for program in (RiccatiProgram(3, weight, independent=independent), warm):
            found = program.solve(point.scaled_linear(), z, np.full(3, 100.0))
            if independent:
                assert found.status is SolverStatus.SOLVED
            if found.status is SolverStatus.SOLVED:
                assert found.tau == pytest.approx(expected.tau, rel=1e-3)


def test_bound_that_binds_takes_the_semidefinite_program_and_one_that_does_not_takes_none() -> None:
    point = operating_point(1)
    free = controller().solve(point.linear, point.chi, 10 * ALLOCATION.limit)
    assert (free.source, free.status) == (GainSource.RICCATI, SolverStatus.SOLVED)
    tight = controller().solve(point.linear, point.chi, 0.6 * np.abs(free.K @ point.chi))
    assert (tight.source, tight.status) == (GainSource.SDP, SolverStatus.SOLVED)


def test_programs_result_of_another_shape_is_refused() -> None:
    class Wrong:
        source = GainSource.SDP

        def solve(self, _model: LinearModel, _z: np.ndarray, _room: np.ndarray) -> Answer:
            return Answer(np.eye(2), np.zeros((3, 3)), 1.0, SolverStatus.SOLVED, 1)

    point = operating_point(0)
    with pytest.raises(ValueError, match=r"P \(2, 2\) and Y \(3, 3\) instead of \(3, 3\) and \(3, 3\)"):
        RobustController(STATE, INPUT, 1.0, [Wrong()], independent=True).solve(point.linear, point.chi, point.room)
