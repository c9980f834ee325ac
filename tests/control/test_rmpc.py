"""The robust MPC against its matrix inequalities in cvxpy and in simulation, and its certificate by mutation."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cvxpy
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import solve_discrete_lyapunov

from bench.control.allocation import allocate
from bench.control.rmpc import Gain, RobustController, certified_cost
from bench.control.robust_program import RobustProgram
from bench.control.semidefinite import SolverStatus
from bench.control.vehicle_model import LinearModel, VehicleModel
from platoon_fmu.parameters import VehicleParameters

T = 0.01
MODEL = VehicleModel(VehicleParameters(), T)
ALLOCATION = allocate(VehicleParameters(), 0.5, 3000.0, 0.25)
STATE = np.array([1.0, 5.0, 0.2])
INPUT = np.array([0.1, 2000.0, 1000.0])
EQUAL = [(1.0, 1.0), (-1.0, -1.0)]
"""The paper's lambda_f = lambda_r."""
INDEPENDENT = [*EQUAL, (1.0, -1.0), (-1.0, 1.0)]
POINTS = range(12)

Models = Sequence[tuple[np.ndarray, np.ndarray]]


def controller(
    independent: bool = True, weight: float = 1.0, tolerance: float = 1e-6, iterations: int = 40
) -> RobustController:
    return RobustController(
        STATE, INPUT, weight, independent=independent, tolerance=tolerance, max_iterations=iterations
    )


@dataclass(frozen=True)
class OperatingPoint:
    """Where a step of the tracker may find itself."""

    linear: LinearModel
    chi: np.ndarray
    room: np.ndarray

    def vertex(self, lambda_f: float, lambda_r: float) -> tuple[np.ndarray, np.ndarray]:
        return self.linear.at(lambda_f, lambda_r)

    def models(self, corners: Sequence[tuple[float, float]]) -> Models:
        return [self.vertex(*corner) for corner in corners]

    def scaled(self, corners: Sequence[tuple[float, float]]) -> Models:
        return [scaled(A, B) for A, B in self.models(corners)]

    def scaled_linear(self) -> LinearModel:
        """The model in the units of the programme.

        H and N share a factor at will, and the printed form gives more or less with it: with columns and rows of one
        length its numbers are moderate and it gives about its best.
        """
        model = self.linear
        A, B = scaled(model.A, model.B)
        H, N1, N2 = model.H / STATE[:, None], model.N1 * STATE, model.N2 * INPUT
        share = np.sqrt(np.linalg.norm(np.hstack([N1, N2]), axis=1) / np.linalg.norm(H, axis=0))
        return LinearModel(A, B, H * share, N1 / share[:, None], N2 / share[:, None])


def scaled(A: np.ndarray, B: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A model in the units of the programme."""
    return A / STATE[:, None] * STATE, B / STATE[:, None] * INPUT


def operating_point(seed: int) -> OperatingPoint:
    random = np.random.default_rng(seed)
    v = random.uniform(8, 40)
    gamma = random.uniform(-0.6, 0.6) * 0.85 * 7.84 / v
    xi = np.array([v, MODEL.steady_lateral_velocity(v, gamma), gamma])
    U = ALLOCATION.matrix @ (random.uniform(-0.1, 0.1, 3) * ALLOCATION.limit)
    direction = random.normal(size=3)
    chi = random.uniform(0.05, 1.0) * direction / np.linalg.norm(direction) * STATE
    room = random.uniform(0.3, 1.0, 3) * ALLOCATION.limit
    return OperatingPoint(MODEL.linearise(xi, U).with_inputs(ALLOCATION.matrix), chi, room)


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
    return solved(tau, [*constraints, *bounds(P, P, Y, z, room)]) * unit


def printed_oracle(
    model: LinearModel, z: np.ndarray, room: np.ndarray, multiplier: cvxpy.Expression, rho: float = 1.0
) -> float:
    """The least tau of (51)-(54) as printed, with G, F, H, N1, N2; scaled units, in cvxpy.

    `multiplier` stands for eps I: a variable times the identity is the printed form, and any positive definite matrix
    that commutes with Lambda is as sound.
    """
    n, m = 3, room.size
    A, B, H, N1, N2 = model.A, model.B, model.H, model.N1, model.N2
    P, tau = cvxpy.Variable((n, n), symmetric=True), cvxpy.Variable()
    G, F = cvxpy.Variable((n, n)), cvxpy.Variable((m, n))
    R, Q, unit = rho * np.eye(m), np.eye(n), 300.0
    closed, spread = A @ G + B @ F, N1 @ G + N2 @ F

    def zero(rows: int, columns: int) -> np.ndarray:
        return np.zeros((rows, columns))

    inequality = cvxpy.bmat(
        [
            [-(G + G.T - P), F.T @ R, closed.T, G.T @ Q, spread.T],
            [R @ F, -unit * tau * R, zero(m, n), zero(m, n), zero(m, n)],
            [closed, zero(n, m), -P + H @ multiplier @ H.T, zero(n, n), zero(n, n)],
            [Q @ G, zero(n, m), zero(n, n), -unit * tau * Q, zero(n, n)],
            [spread, zero(n, m), zero(n, n), zero(n, n), -multiplier],
        ]
    )
    return solved(tau, [inequality << 0, *bounds(P, G + G.T - P, F, z, room)]) * unit


def commuting(independent: bool) -> cvxpy.Expression:
    """A symmetric matrix that commutes with diag(lambda_f, lambda_f, lambda_r)."""
    E = cvxpy.Variable((3, 3), symmetric=True)
    pattern = np.array([[1, 1, 0], [1, 1, 0], [0, 0, 1]]) if independent else np.ones((3, 3))
    return cvxpy.multiply(pattern, E)


def bounds(
    P: cvxpy.Variable, G: cvxpy.Expression, Y: cvxpy.Variable, z: np.ndarray, room: np.ndarray
) -> list[cvxpy.Constraint]:
    """z in the ellipsoid, (52), and the input bounds, (54)."""
    one = np.ones((1, 1))
    constraints = [cvxpy.bmat([[one, z[None, :]], [z[:, None], P]]) >> 0]
    for j, limit in enumerate(room):
        row = Y[j : j + 1, :] / limit
        constraints.append(cvxpy.bmat([[one, row], [row.T, G]]) >> 0)
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
    multipliers = printed_oracle(point.scaled_linear(), z, room, commuting(independent))
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
    multipliers = printed_oracle(point.scaled_linear(), z, room, commuting(False), weight)
    assert vertices * (1 - 1e-3) <= gain.tau <= multipliers * (1 + 1e-2)


@pytest.mark.parametrize("seed", POINTS)
def test_bound_is_never_above_that_of_the_printed_form(seed: int) -> None:
    """(51)-(54) with one epsilon, for lambda_f = lambda_r as the paper has it."""
    point = operating_point(seed)
    gain = controller(False).solve(point.linear, point.chi, point.room)
    assert gain.usable
    eps = cvxpy.Variable(nonneg=True) * np.eye(3)
    printed = printed_oracle(point.scaled_linear(), point.chi / STATE, point.room / INPUT, eps)
    assert gain.tau <= printed * (1 + 1e-3)


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


def accumulate(point: OperatingPoint, gain: Gain, lambdas: np.ndarray) -> tuple[float, np.ndarray]:
    """Cost (scaled units, R = I) and largest inputs along a sequence of stiffnesses."""
    chi = point.chi
    cost, largest = 0.0, np.zeros(3)
    for lambda_f, lambda_r in lambdas:
        A, B = point.vertex(lambda_f, lambda_r)
        u = gain.K @ chi
        cost += float(((chi / STATE) ** 2).sum() + ((u / INPUT) ** 2).sum())
        largest = np.maximum(largest, np.abs(u))
        chi = A @ chi + B @ u
    return cost, largest


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


def proof(point: OperatingPoint, gain: Gain) -> tuple[np.ndarray, np.ndarray, Models, np.ndarray, np.ndarray]:
    """What the certificate is asked: K and P, the models, the deviation and the room, all in scaled units."""
    return (
        gain.K * STATE / INPUT[:, None],
        gain.P,
        point.scaled(INDEPENDENT),
        point.chi / STATE,
        point.room / INPUT,
    )


@pytest.fixture(scope="module")
def certified() -> tuple[OperatingPoint, Gain]:
    point = operating_point(1)
    return point, controller().solve(point.linear, point.chi, point.room)


def test_certificate_accepts_the_solution(certified: tuple[OperatingPoint, Gain]) -> None:
    point, gain = certified
    K, P, models, z, room = proof(point, gain)
    assert certified_cost(K, P, 1.0, models, z, room) == pytest.approx(gain.tau, rel=1e-9)


def test_certificate_is_exact_for_one_model() -> None:
    """Of a single stable loop with P = S^-1 from its Lyapunov equation the bound is the very cost z'Sz."""
    A, B = operating_point(2).scaled([(0.0, 0.0)])[0]
    K = np.array([[-0.1, 0.02, -0.3], [-0.4, 0.0, 0.0], [0.0, 0.1, -0.2]])
    closed = A + B @ K
    assert np.abs(np.linalg.eigvals(closed)).max() < 1.0
    rho = 0.3
    S = solve_discrete_lyapunov(closed.T, np.eye(3) + rho * K.T @ K)
    z = np.array([0.5, -0.2, 0.7])
    cost = certified_cost(K, np.linalg.inv(S), rho, [(A, B)], z, np.full(3, 1e3))
    assert cost == pytest.approx(z @ S @ z, rel=1e-6)


def test_certificate_does_not_depend_on_the_ellipsoids_size(certified: tuple[OperatingPoint, Gain]) -> None:
    point, gain = certified
    K, P, models, z, room = proof(point, gain)
    for factor in (1e-3, 1e3):
        assert certified_cost(K, factor * P, 1.0, models, z, room) == pytest.approx(gain.tau, rel=1e-6)


def test_certificate_takes_the_worst_vertex(certified: tuple[OperatingPoint, Gain]) -> None:
    point, gain = certified
    K, P, models, z, room = proof(point, gain)
    each = [certified_cost(K, P, 1.0, [model], z, room) for model in models]
    assert None not in each
    assert max(c for c in each if c is not None) == pytest.approx(gain.tau, rel=1e-12)


@pytest.mark.parametrize("row", range(3))
def test_certificate_refuses_a_gain_that_breaks_an_input_bound(
    certified: tuple[OperatingPoint, Gain], row: int
) -> None:
    """In the ellipsoid through z, input j reaches sqrt(k P k') times z's radius: just above the room is refused."""
    K, P, models, z, room = proof(*certified)
    radius = np.sqrt(z @ np.linalg.solve(P, z))
    reached = radius * np.sqrt(K[row] @ P @ K[row])
    for factor, accepted in ((0.998, False), (0.9995, True), (1.0005, True)):
        tight = np.full(3, 1e6)
        tight[row] = factor * reached
        assert (certified_cost(K, P, 1.0, models, z, tight) is not None) is accepted
    assert (np.abs(K @ z) <= radius * np.sqrt(np.diag(K @ P @ K.T)) * (1 + 1e-9)).all()
    assert (radius * np.sqrt(np.diag(K @ P @ K.T)) <= 1.001 * room).all()


def test_certificate_refuses_gains_that_do_not_contract() -> None:
    """Above the critical speed of the oversteering corner no feedback, and the opposite one, prove nothing."""
    xi = np.array([38.0, 0.0, 0.0])
    chi = np.array([0.1, 0.3, 0.05])
    point = OperatingPoint(MODEL.linearise(xi, np.zeros(5)).with_inputs(ALLOCATION.matrix), chi, ALLOCATION.limit)
    gain = controller().solve(point.linear, point.chi, point.room)
    assert gain.usable
    K, P, models, z, _ = proof(point, gain)
    room = np.full(3, 1e6)
    assert certified_cost(K, P, 1.0, models, z, room) is not None
    for mutant in (np.zeros((3, 3)), -K, 30.0 * K, K[:, ::-1]):
        assert certified_cost(mutant, P, 1.0, models, z, room) is None


@pytest.mark.parametrize(
    "P",
    [
        np.zeros((3, 3)),
        -np.eye(3),
        np.diag([1.0, 1.0, -1e-3]),
        np.diag([1.0, 1.0, 1e-12]),
    ],
    ids=["zero", "negative", "indefinite", "flat"],
)
def test_certificate_refuses_what_is_no_ellipsoid(certified: tuple[OperatingPoint, Gain], P: np.ndarray) -> None:
    K, _, models, z, room = proof(*certified)
    assert certified_cost(K, P, 1.0, models, z, room) is None


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_certificate_refuses_what_is_not_a_number(certified: tuple[OperatingPoint, Gain], value: float) -> None:
    K, P, models, z, room = proof(*certified)
    broken = K.copy()
    broken[1, 2] = value
    assert certified_cost(broken, P, 1.0, models, z, room) is None


@pytest.mark.parametrize("entry", range(3))
def test_certificate_refuses_a_room_that_is_not_a_number(certified: tuple[OperatingPoint, Gain], entry: int) -> None:
    K, P, models, z, room = proof(*certified)
    unknown = room.copy()
    unknown[entry] = np.nan
    assert certified_cost(K, P, 1.0, models, z, unknown) is None


@settings(max_examples=60)
@given(st.integers(0, 5), st.lists(st.floats(-2, 2), min_size=9, max_size=9), st.floats(0, 1))
def test_whatever_the_certificate_accepts_is_true(seed: int, change: list[float], size: float) -> None:
    """Mutated gains are either refused, or the cost and inputs the certificate allows them are kept in simulation."""
    point = operating_point(seed)
    gain = controller().solve(point.linear, point.chi, point.room)
    K, P, models, z, room = proof(point, gain)
    mutant = K + size * np.array(change).reshape(3, 3) * np.abs(K)
    cost = certified_cost(mutant, P, 1.0, models, z, room)
    driven = Gain(mutant * INPUT[:, None] / STATE, P, 0.0, SolverStatus.SOLVED, 0)
    if cost is None:
        return
    for corner in INDEPENDENT:
        spent, largest = accumulate(point, driven, np.tile(corner, (300, 1)))
        assert spent <= cost * (1 + 1e-9)
        assert (largest <= 1.001 * point.room).all()


def test_mutants_are_refused_often_and_not_always() -> None:
    """The test above would say nothing if no mutant were ever accepted, or all were."""
    accepted = 0
    random = np.random.default_rng(0)
    point = operating_point(3)
    K, P, models, z, _ = proof(point, controller().solve(point.linear, point.chi, point.room))
    for _ in range(100):
        mutant = K + random.uniform(-1, 1, (3, 3)) * np.abs(K)
        accepted += certified_cost(mutant, P, 1.0, models, z, np.full(3, 1e6)) is not None
    assert 5 < accepted < 95


def certain(A: np.ndarray, B: np.ndarray) -> LinearModel:
    """A model without uncertainty."""
    return LinearModel(A, B, np.zeros((3, 3)), np.zeros((3, 3)), np.zeros((3, 3)))


UNSTABLE = certain(1.05 * np.eye(3), 0.1 * np.eye(3))


def unit_controller() -> RobustController:
    return RobustController(np.ones(3), np.ones(3), 1.0, independent=True, tolerance=1e-6, max_iterations=60)


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
    gain = controller(iterations=5).solve(point.linear, point.chi, point.room)
    assert gain.status is SolverStatus.MAX_ITERATIONS
    assert not gain.usable
    assert gain.iterations == 5


def test_inaccurate_answers_are_caught() -> None:
    """However loose the solver's tolerance, what is called usable has a proof that holds in simulation."""
    loose = controller(tolerance=1e-2)
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


def test_bound_grows_with_the_square_of_the_deviation_while_inputs_are_free() -> None:
    point = operating_point(4)
    room = 1e3 * ALLOCATION.limit
    one, other = (controller().solve(point.linear, k * point.chi, room) for k in (1.0, 0.5))
    assert one.tau == pytest.approx(4.0 * other.tau, rel=1e-2)


def test_solves_do_not_depend_on_what_was_solved_before() -> None:
    fresh, used = controller(), controller()
    for seed in (5, 6, 7):
        point = operating_point(seed)
        used.solve(point.linear, point.chi, point.room)
    point = operating_point(8)
    expected = fresh.solve(point.linear, point.chi, point.room)
    again = used.solve(point.linear, point.chi, point.room)
    np.testing.assert_array_equal(again.K, expected.K)
    assert again.tau == expected.tau


@pytest.mark.parametrize("share", [1.0, 1e9], ids=["usual", "boundless"])
def test_many_operating_points_all_solve(share: float) -> None:
    steady = controller()
    for seed in range(200):
        point = operating_point(seed)
        point = replace(point, room=share * point.room)
        assert steady.solve(point.linear, point.chi, point.room).usable, seed
