"""The control's machine code gives the same bits as its plain text, which is interpreted."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from tests.control.operating_points import INPUT, STATE, OperatingPoint, operating_point
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
