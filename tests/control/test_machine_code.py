"""The control's machine code gives the same bits as its plain text, which is interpreted."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from bench.control.settings import TrackerSettings
from platoon_fmu.parameters import VehicleParameters
from tests.control.operating_points import ALLOCATION, INPUT, MODEL, STATE, OperatingPoint, operating_point
from tests.plain import bits, compiled, plain

WAYS = (compiled, plain)
finite = st.floats(-1e3, 1e3)
vectors = arrays(np.float64, 3, elements=st.floats(-1.0, 1.0))


def both(name: str) -> list:
    return [way(f"bench.control.{name}") for way in WAYS]


def answers(made: list, point: OperatingPoint) -> list:
    """What a solver of each form finds at this point."""
    z = point.chi / STATE / np.linalg.norm(point.chi / STATE)
    return [bits(each.solve(point.scaled_linear(), z, point.room / INPUT)) for each in made]


@settings(max_examples=15)
@given(st.lists(st.integers(0, 200), min_size=1, max_size=3), st.booleans(), st.sampled_from([0.1, 1.0, 10.0]))
def test_riccati_program(seeds, independent, weight):
    """Also from the multiplier and the curvature of the step before."""
    made = [each.RiccatiProgram(3, weight, independent=independent) for each in both("riccati_program")]
    for seed in seeds:
        point = operating_point(seed)
        one, other = answers(made, point)
        assert one == other
        assert made[0].evaluations == made[1].evaluations > 0


@settings(max_examples=15)
@given(st.integers(0, 200), vectors, st.sampled_from([1.0, 1e-3, 1e-13, 0.0]), st.floats(0.1, 100.0))
def test_robust_controller_and_certificate(seed, direction, size, share):
    point = operating_point(seed)
    gains = []
    for rmpc, program in zip(both("rmpc"), both("riccati_program"), strict=True):
        tried = [program.RiccatiProgram(3, 1.0, independent=True)]
        controller = rmpc.RobustController(STATE, INPUT, 1.0, tried, independent=True)
        gains.append(controller.solve(point.linear, size * direction * STATE, share * point.room))
    assert bits(gains[0]) == bits(gains[1])


@settings(max_examples=60)
@given(
    arrays(np.float64, (2, 3), elements=finite),
    arrays(np.float64, (3, 3), elements=st.floats(-2.0, 2.0)),
    arrays(np.float64, (2, 3, 3), elements=st.floats(-0.5, 0.5)),
    arrays(np.float64, (2, 3, 2), elements=st.floats(-0.1, 0.1)),
    vectors,
    st.floats(1e-3, 1e6),
)
def test_certificate_of_two_inputs(K, root, A, B, z, room):
    models = list(zip(A, B, strict=True))
    for factor in (1e-3, 1.0):
        asked = (factor * K, root @ root.T + 1e-3 * np.eye(3), 0.5, models, z, np.full(2, room))
        one, other = (each.certified_cost(*asked) for each in both("certificate"))
        assert bits(one) == bits(other)


def test_certificates_are_given_and_refused():
    """The test above would say nothing if none were ever given, or none refused."""
    models = [(0.5 * np.eye(3), 0.1 * np.eye(3))]
    for gain, accepted in ((np.eye(3), True), (10.0 * np.eye(3), False)):
        for each in both("certificate"):
            cost = each.certified_cost(gain, np.eye(3), 1.0, models, np.ones(3), np.full(3, 1e3))
            assert (cost is not None) is accepted


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e200, 0.0])
def test_numbers_beyond_all_reason(value):
    point = operating_point(1)
    point.linear.A[0, 1] = value
    gains = []
    for rmpc, program in zip(both("rmpc"), both("riccati_program"), strict=True):
        tried = [program.RiccatiProgram(3, 1.0, independent=True)]
        controller = rmpc.RobustController(STATE, INPUT, 1.0, tried, independent=True)
        with np.errstate(all="ignore"):
            gains.append(controller.solve(point.linear, point.chi, 10.0 * point.room))
    assert bits(gains[0]) == bits(gains[1])
    assert gains[0].usable is (value == 0.0)


@settings(max_examples=60)
@given(
    st.integers(1, 5).flatmap(
        lambda n: st.tuples(
            *(arrays(np.float64, shape, elements=finite) for shape in ((n, n), n, n)),
            arrays(np.float64, n, elements=st.floats(0.0, 10.0)),
        )
    )
)
def test_quadratic_programs_in_a_box(drawn):
    root, gradient, lower, width = drawn
    asked = (root @ root.T + np.eye(len(root)), gradient, lower, lower + width)
    one, other = (each.minimise(*asked) for each in both("quadratic"))
    assert bits(one) == bits(other)


speeds = st.floats(3.0, 45.0)
states = st.tuples(speeds, st.floats(-2.0, 2.0), st.floats(-1.0, 1.0)).map(np.array)
real_inputs = st.tuples(st.floats(-0.5, 0.5), *[st.floats(-3e3, 3e3)] * 4).map(np.array)
virtual_inputs = st.tuples(st.floats(-0.5, 0.5), st.floats(-8e3, 8e3), st.floats(-3e3, 3e3)).map(np.array)


@given(states, real_inputs)
def test_vehicle_model(xi, U):
    found = []
    for each in both("vehicle_model"):
        model = each.VehicleModel(VehicleParameters(), 0.01)
        linear = model.linearise(xi, U)
        allocated = linear.with_inputs(ALLOCATION.matrix)
        found.append(bits((model.derivative(xi, U), model.step(xi, U), linear, allocated)))
    assert found[0] == found[1]


@given(states, states, virtual_inputs)
def test_reference_input(xi, xi_next, start):
    weights = np.array([1.0, 1e-3, 10.0]), np.array([1e-7, 1e-7, 1e-5])
    found = []
    for each, vehicle in zip(both("reference"), both("vehicle_model"), strict=True):
        model = vehicle.VehicleModel(VehicleParameters(), 0.01)
        found.append(bits(each.reference_input(model, ALLOCATION, xi, xi_next, start, *weights)))
    assert found[0] == found[1]


@given(states, real_inputs, vectors, virtual_inputs, virtual_inputs, st.floats(0.01, 1.0))
def test_target(xi, U, disturbance, u_ref, middle, share):
    """With the bounds far away, near, and so near that no target is at rest."""
    linear = MODEL.linearise(xi, U).with_inputs(ALLOCATION.matrix)
    lower, upper = middle - share * ALLOCATION.limit, middle + share * ALLOCATION.limit
    asked = (linear.A, linear.B, 0.01 * disturbance, u_ref, lower, upper, STATE, INPUT)
    one, other = (each.steady_state_target(*asked) for each in both("target"))
    assert bits(one) == bits(other)


@given(st.lists(st.tuples(states, virtual_inputs, vectors), min_size=1, max_size=5), st.randoms(use_true_random=False))
def test_observer(steps, dice):
    gain = np.array([[dice.uniform(-1.0, 0.0) for _ in range(3)] for _ in range(6)])
    made = [each.DisturbanceObserver(gain, 0.01) for each in both("observer")]
    for xi, u, drift in steps:
        linear = MODEL.linearise(xi, np.zeros(5)).with_inputs(ALLOCATION.matrix)
        one, other = (each.correct(xi) for each in made)
        assert bits(one) == bits(other)
        for each in made:
            each.predict(linear.A, linear.B, xi, u, xi + drift)


@given(speeds, st.floats(-1.0, 1.0), st.floats(-4.0, 4.0), st.floats(0.0, 6.0), st.floats(0.0, 10.0))
def test_slow_down(v, gamma, course, braking, crawl):
    one, other = (each.slow_down(v, gamma, course, braking, crawl, 0.01) for each in both("slow_down"))
    assert bits(one) == bits(other)


@settings(max_examples=8)
@given(st.lists(st.tuples(vectors, st.floats(10.0, 20.0), st.floats(-0.2, 0.2)), min_size=1, max_size=4))
def test_tracker(steps):
    """Whole steps, but for the wall clock's."""
    made = [each.Tracker(TrackerSettings(), VehicleParameters(), 0.01) for each in both("tracker")]
    for error, v, gamma in steps:
        xi = np.array([v, 0.0, gamma]) + 0.1 * error
        found = [bits(each.step(xi, (v, gamma), (v + 0.01, gamma))._replace(solve_s=0.0)) for each in made]
        assert found[0] == found[1]
