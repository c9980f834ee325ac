"""The small matrices agree with numpy."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from bench.control.matrices import invert, solve_linear
from tests.plain import bits, plain

matrices = arrays(np.float64, (3, 3), elements=st.floats(-1e3, 1e3))
flat = plain("bench.control.flat_matrices")


def called(function, *arguments: np.ndarray) -> np.ndarray:
    """What a function on plain numbers sets, as a matrix."""
    out = [0.0] * 9
    function(out, *(each.ravel().tolist() for each in arguments))
    return np.reshape(out, (3, 3))


@given(matrices, matrices)
def test_products_are_those_of_numpy(a, b):
    np.testing.assert_allclose(called(flat.multiply, a, b), a @ b, rtol=1e-12, atol=1e-9)
    np.testing.assert_allclose(called(flat.multiply_transposed, a, b), a @ b.T, rtol=1e-12, atol=1e-9)
    np.testing.assert_allclose(called(flat.transposed_multiply, a, b), a.T @ b, rtol=1e-12, atol=1e-9)
    np.testing.assert_allclose(called(flat.congruence, a, b, a), a @ b @ a.T, rtol=1e-12, atol=1e-6)
    np.testing.assert_allclose(called(flat.complement, a), np.eye(3) - a, rtol=1e-12)
    assert np.isclose(flat.form(a[0].tolist(), b.ravel().tolist()), a[0] @ b @ a[0], rtol=1e-12, atol=1e-6)
    assert np.isclose(flat.trace(a.ravel().tolist()), np.trace(a), rtol=1e-12, atol=1e-12)


@given(matrices, matrices)
def test_sums_are_those_of_numpy(a, b):
    total = a.ravel().tolist()
    flat.add(total, b.ravel().tolist(), -0.5)
    np.testing.assert_allclose(np.reshape(total, (3, 3)), a - 0.5 * b, rtol=1e-12, atol=1e-12)
    flat.copy(total, a.ravel().tolist())
    flat.add_symmetric(total, b.ravel().tolist())
    np.testing.assert_allclose(np.reshape(total, (3, 3)), a + 0.5 * (b + b.T), rtol=1e-12, atol=1e-12)


@given(matrices)
def test_the_inverse_is_that_of_numpy(a):
    a = a + 4e3 * np.eye(3)
    out = np.empty((3, 3))
    assert np.isclose(invert(out, a), np.linalg.det(a), rtol=1e-9)
    np.testing.assert_allclose(out @ a, np.eye(3), atol=1e-9)


def test_a_singular_matrix_has_the_determinant_0():
    assert invert(np.empty((3, 3)), np.ones((3, 3))) == 0.0
    assert not solve_linear(np.ones((2, 2)), np.ones(2), 2)


@given(matrices)
def test_the_root_is_that_of_numpy(a):
    square = a @ a.T + np.eye(3)
    np.testing.assert_allclose(called(flat.cholesky, square), np.linalg.cholesky(square), rtol=1e-6, atol=1e-6)


@given(matrices)
def test_only_a_positive_definite_matrix_has_a_root(a):
    symmetric = a + a.T
    least = np.linalg.eigvalsh(symmetric)[0]
    assume(abs(least) > 1e-6)
    assert flat.cholesky([0.0] * 9, symmetric.ravel().tolist()) == (least > 0.0)


@pytest.mark.parametrize("n", [3, 4, 6])
@given(st.data())
def test_eigenvalues_are_those_of_numpy(n, data):
    a = data.draw(arrays(np.float64, (n, n), elements=st.floats(-1e3, 1e3)))
    symmetric = a + a.T
    values, vectors = [0.0] * n, [0.0] * (n * n)
    flat.eigen(values, vectors, symmetric.ravel().tolist(), n)
    np.testing.assert_allclose(sorted(values), np.linalg.eigvalsh(symmetric), atol=1e-9)
    axes = np.reshape(vectors, (n, n))
    np.testing.assert_allclose(axes * values @ axes.T, symmetric, atol=1e-8)


@given(matrices, matrices)
def test_machine_code_and_plain_text_give_the_same_bits(a, b):
    other = plain("bench.control.matrices")
    for name in ("invert", "solve_linear"):
        results = []
        for function in (globals()[name], getattr(other, name)):
            out, one, row = np.zeros((3, 3)), a.copy(), b[0].copy()
            arguments = {"invert": (out, a), "solve_linear": (one, row, 3)}[name]
            results.append(bits((float(function(*arguments) or 0.0), out, one, row)))
        assert results[0] == results[1]
