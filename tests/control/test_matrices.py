"""The small matrices agree with numpy."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from bench.control.matrices import invert, multiply, multiply_transposed

matrices = arrays(np.float64, (3, 3), elements=st.floats(-1e3, 1e3))


@given(matrices, matrices)
def test_products_are_those_of_numpy(a, b):
    out = np.empty((3, 3))
    multiply(out, a, b)
    np.testing.assert_allclose(out, a @ b, rtol=1e-12, atol=1e-9)
    multiply_transposed(out, a, b)
    np.testing.assert_allclose(out, a @ b.T, rtol=1e-12, atol=1e-9)


@given(matrices)
def test_the_inverse_is_that_of_numpy(a):
    a = a + 4e3 * np.eye(3)
    out = np.empty((3, 3))
    assert np.isclose(invert(out, a), np.linalg.det(a), rtol=1e-9)
    np.testing.assert_allclose(out @ a, np.eye(3), atol=1e-9)
