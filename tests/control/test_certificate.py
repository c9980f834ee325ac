"""The certificate: it accepts what is true, and by mutation nothing else."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import solve_discrete_lyapunov

from bench.control.certificate import certified_cost
from bench.control.outcome import SolverStatus
from bench.control.rmpc import Gain
from tests.control.operating_points import (
    ALLOCATION,
    INDEPENDENT,
    INPUT,
    MODEL,
    STATE,
    Models,
    OperatingPoint,
    accumulate,
    controller,
    operating_point,
)


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


def test_it_accepts_the_solution(certified: tuple[OperatingPoint, Gain]) -> None:
    point, gain = certified
    K, P, models, z, room = proof(point, gain)
    assert certified_cost(K, P, 1.0, models, z, room) == pytest.approx(gain.tau, rel=1e-9)


def test_it_is_exact_for_one_model() -> None:
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


@pytest.mark.parametrize("inputs", [1, 2, 4])
def test_any_number_of_inputs(inputs: int) -> None:
    """One that the gain does not use changes nothing, and each one that it uses counts."""
    random = np.random.default_rng(inputs)
    A, B = 0.8 * np.eye(3), 0.1 * random.normal(size=(3, inputs))
    K = 0.3 * random.normal(size=(inputs, 3))
    S = solve_discrete_lyapunov((A + B @ K).T, np.eye(3) + 0.3 * K.T @ K)
    z, room = np.array([0.5, -0.2, 0.7]), np.full(inputs + 1, 1e3)
    cost = certified_cost(K, np.linalg.inv(S), 0.3, [(A, B)], z, room[:inputs])
    assert cost == pytest.approx(z @ S @ z, rel=1e-6)
    unused = np.vstack([K, np.zeros((1, 3))]), np.hstack([B, np.ones((3, 1))])
    assert certified_cost(unused[0], np.linalg.inv(S), 0.3, [(A, unused[1])], z, room) == pytest.approx(cost, rel=1e-12)


def test_it_does_not_depend_on_the_ellipsoids_size(certified: tuple[OperatingPoint, Gain]) -> None:
    point, gain = certified
    K, P, models, z, room = proof(point, gain)
    for factor in (1e-3, 1e3):
        assert certified_cost(K, factor * P, 1.0, models, z, room) == pytest.approx(gain.tau, rel=1e-6)


def test_it_takes_the_worst_vertex(certified: tuple[OperatingPoint, Gain]) -> None:
    point, gain = certified
    K, P, models, z, room = proof(point, gain)
    each = [certified_cost(K, P, 1.0, [model], z, room) for model in models]
    assert None not in each
    assert max(c for c in each if c is not None) == pytest.approx(gain.tau, rel=1e-12)


@pytest.mark.parametrize("row", range(3))
def test_it_refuses_a_gain_that_breaks_an_input_bound(certified: tuple[OperatingPoint, Gain], row: int) -> None:
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


def test_it_refuses_gains_that_do_not_contract() -> None:
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
def test_it_refuses_what_is_no_ellipsoid(certified: tuple[OperatingPoint, Gain], P: np.ndarray) -> None:
    K, _, models, z, room = proof(*certified)
    assert certified_cost(K, P, 1.0, models, z, room) is None


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_it_refuses_what_is_not_a_number(certified: tuple[OperatingPoint, Gain], value: float) -> None:
    K, P, models, z, room = proof(*certified)
    broken = K.copy()
    broken[1, 2] = value
    assert certified_cost(broken, P, 1.0, models, z, room) is None


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_it_refuses_an_ellipsoid_that_is_not_a_number(certified: tuple[OperatingPoint, Gain], value: float) -> None:
    K, P, models, z, room = proof(*certified)
    broken = P.copy()
    broken[1, 2] = broken[2, 1] = value
    assert certified_cost(K, broken, 1.0, models, z, room) is None


@pytest.mark.parametrize(
    ("axis", "pole", "accepted"),
    [(1.0, 0.5, True), (1.1e-9, 0.5, True), (1e-9, 0.5, False), (1e-12, 0.5, False), (1.0, 1.0, False)],
)
def test_the_limits_of_an_axis_a_pole_and_the_room(axis: float, pole: float, accepted: bool) -> None:
    """Without a gain the origin needs no room, and costs 0 if the ellipsoid has volume and the loop contracts."""
    model = (pole * np.eye(3), np.zeros((3, 3)))
    none = np.zeros((3, 3))
    cost = certified_cost(none, np.diag([1.0, 1.0, axis]), 1.0, [model], np.zeros(3), np.zeros(3))
    assert cost == (0.0 if accepted else None)


@pytest.mark.parametrize("entry", range(3))
def test_it_refuses_a_room_that_is_not_a_number(certified: tuple[OperatingPoint, Gain], entry: int) -> None:
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


def test_it_refuses_costs_beyond_all_numbers() -> None:
    """A gain that no input acts on, at the origin: only its cost tells it."""
    models = [(0.5 * np.eye(3), np.zeros((3, 3)))]
    huge = np.full((3, 3), 1e150)
    assert certified_cost(huge, np.eye(3), 1e10, models, np.zeros(3), np.zeros(3)) is None
