# cython: boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Small matrices, most of them 3x3 as the control model is: written out, because numpy costs a microsecond a call.

Results go to the first argument, which must not be one of the others. Compiled modules call these functions directly.
"""

import cython

if cython.compiled:
    from cython.cimports.libc.math import fabs, sqrt
else:
    from math import fabs, sqrt

_SWEEPS = cython.declare(cython.int, 30)
"""Limit on Jacobi's sweeps; matrices of this size need 4 to 8."""


@cython.ccall
@cython.nogil
@cython.exceptval(check=False)
def copy(out: cython.double[:, ::1], a: cython.double[:, ::1]) -> cython.void:
    """Set `out = a`."""
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    for i in range(3):
        for j in range(3):
            out[i, j] = a[i, j]


@cython.ccall
@cython.nogil
@cython.exceptval(check=False)
def add(out: cython.double[:, ::1], a: cython.double[:, ::1], factor: cython.double) -> cython.void:
    """Add `factor a` to `out`."""
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    for i in range(3):
        for j in range(3):
            out[i, j] += factor * a[i, j]


@cython.ccall
@cython.nogil
@cython.exceptval(check=False)
def add_symmetric(out: cython.double[:, ::1], a: cython.double[:, ::1]) -> cython.void:
    """Add the symmetric part of `a` to `out`."""
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    for i in range(3):
        for j in range(3):
            out[i, j] += 0.5 * (a[i, j] + a[j, i])


@cython.ccall
@cython.nogil
@cython.exceptval(check=False)
def scale(out: cython.double[:, ::1], a: cython.double[:, ::1], factor: cython.double) -> cython.void:
    """Set `out = factor a`."""
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    for i in range(3):
        for j in range(3):
            out[i, j] = factor * a[i, j]


@cython.ccall
@cython.nogil
@cython.exceptval(check=False)
def trace(a: cython.double[:, ::1]) -> cython.double:
    """Return the sum of the diagonal."""
    return a[0, 0] + a[1, 1] + a[2, 2]


@cython.ccall
@cython.nogil
@cython.exceptval(check=False)
def complement(out: cython.double[:, ::1], a: cython.double[:, ::1]) -> cython.void:
    """Set `out = I - a`."""
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    for i in range(3):
        for j in range(3):
            out[i, j] = (1.0 if i == j else 0.0) - a[i, j]


@cython.ccall
@cython.nogil
@cython.exceptval(check=False)
def multiply(out: cython.double[:, ::1], a: cython.double[:, ::1], b: cython.double[:, ::1]) -> cython.void:
    """Set `out = a b`."""
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    for i in range(3):
        for j in range(3):
            out[i, j] = a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j]


@cython.ccall
@cython.nogil
@cython.exceptval(check=False)
def multiply_transposed(out: cython.double[:, ::1], a: cython.double[:, ::1], b: cython.double[:, ::1]) -> cython.void:
    """Set `out = a b'`."""
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    for i in range(3):
        for j in range(3):
            out[i, j] = a[i, 0] * b[j, 0] + a[i, 1] * b[j, 1] + a[i, 2] * b[j, 2]


@cython.ccall
@cython.nogil
@cython.exceptval(check=False)
def transposed_multiply(out: cython.double[:, ::1], a: cython.double[:, ::1], b: cython.double[:, ::1]) -> cython.void:
    """Set `out = a' b`."""
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    for i in range(3):
        for j in range(3):
            out[i, j] = a[0, i] * b[0, j] + a[1, i] * b[1, j] + a[2, i] * b[2, j]


@cython.ccall
@cython.nogil
@cython.exceptval(check=False)
def congruence(
    out: cython.double[:, ::1], a: cython.double[:, ::1], b: cython.double[:, ::1], spare: cython.double[:, ::1]
) -> cython.void:
    """Set `out = a b a'`; `spare` (3, 3) is overwritten."""
    multiply(spare, a, b)
    multiply_transposed(out, spare, a)


@cython.ccall
@cython.nogil
@cython.exceptval(check=False)
def form(x: cython.double[::1], a: cython.double[:, ::1]) -> cython.double:
    """Return `x'a x`."""
    total: cython.double = 0.0
    i: cython.Py_ssize_t
    for i in range(3):
        total += x[i] * (a[i, 0] * x[0] + a[i, 1] * x[1] + a[i, 2] * x[2])
    return total


@cython.ccall
@cython.nogil
@cython.exceptval(check=False)
def invert(out: cython.double[:, ::1], a: cython.double[:, ::1]) -> cython.double:
    """Set `out` to the inverse of `a`, and return its determinant; if that is 0, `out` is not finite."""
    out[0, 0] = a[1, 1] * a[2, 2] - a[1, 2] * a[2, 1]
    out[0, 1] = a[0, 2] * a[2, 1] - a[0, 1] * a[2, 2]
    out[0, 2] = a[0, 1] * a[1, 2] - a[0, 2] * a[1, 1]
    out[1, 0] = a[1, 2] * a[2, 0] - a[1, 0] * a[2, 2]
    out[1, 1] = a[0, 0] * a[2, 2] - a[0, 2] * a[2, 0]
    out[1, 2] = a[0, 2] * a[1, 0] - a[0, 0] * a[1, 2]
    out[2, 0] = a[1, 0] * a[2, 1] - a[1, 1] * a[2, 0]
    out[2, 1] = a[0, 1] * a[2, 0] - a[0, 0] * a[2, 1]
    out[2, 2] = a[0, 0] * a[1, 1] - a[0, 1] * a[1, 0]
    determinant: cython.double = a[0, 0] * out[0, 0] + a[0, 1] * out[1, 0] + a[0, 2] * out[2, 0]
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    for i in range(3):
        for j in range(3):
            out[i, j] /= determinant
    return determinant


@cython.ccall
@cython.nogil
@cython.exceptval(check=False)
def cholesky(out: cython.double[:, ::1], a: cython.double[:, ::1]) -> cython.bint:
    """Set `out` to the lower triangular root of `a = out out'` (n, n); return whether `a` is positive definite."""
    n: cython.Py_ssize_t = a.shape[0]
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    k: cython.Py_ssize_t
    rest: cython.double
    for j in range(n):
        for i in range(n):
            if i < j:
                out[i, j] = 0.0
                continue
            rest = a[i, j]
            for k in range(j):
                rest -= out[i, k] * out[j, k]
            if i > j:
                out[i, j] = rest / out[j, j]
            elif rest > 0.0:
                out[j, j] = sqrt(rest)
            else:
                return False
    return True


@cython.ccall
@cython.nogil
@cython.exceptval(check=False)
def eigen(values: cython.double[::1], vectors: cython.double[:, ::1], a: cython.double[:, ::1]) -> cython.void:
    """Eigenvalues (n,), not sorted, and eigenvectors (columns) of a symmetric `a` (n, n), which is overwritten.

    Jacobi's method: rotations that make one element off the diagonal zero at a time.
    """
    n: cython.Py_ssize_t = a.shape[0]
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    for i in range(n):
        for j in range(n):
            vectors[i, j] = 1.0 if i == j else 0.0
    rotated: cython.bint
    sweep: cython.int
    for sweep in range(_SWEEPS):  # noqa: B007 - typed
        rotated = False
        for i in range(n):
            for j in range(i + 1, n):
                # A smaller one does not change the diagonal.
                if fabs(a[i, j]) > 1e-17 * (fabs(a[i, i]) + fabs(a[j, j])):
                    rotated = True
                    _rotate(vectors, a, i, j)
        if not rotated:
            break
    for i in range(n):
        values[i] = a[i, i]


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def _rotate(
    vectors: cython.double[:, ::1], a: cython.double[:, ::1], i: cython.Py_ssize_t, j: cython.Py_ssize_t
) -> cython.void:
    """Turn axes i and j so that `a[i, j]` becomes 0."""
    n: cython.Py_ssize_t = a.shape[0]
    k: cython.Py_ssize_t
    x: cython.double
    y: cython.double
    theta: cython.double = 0.5 * (a[j, j] - a[i, i]) / a[i, j]
    t: cython.double = 1.0 / (fabs(theta) + sqrt(theta * theta + 1.0))
    if theta < 0.0:
        t = -t
    c: cython.double = 1.0 / sqrt(t * t + 1.0)
    s: cython.double = t * c
    for k in range(n):
        x = a[k, i]
        y = a[k, j]
        a[k, i] = c * x - s * y
        a[k, j] = s * x + c * y
    for k in range(n):
        x = a[i, k]
        y = a[j, k]
        a[i, k] = c * x - s * y
        a[j, k] = s * x + c * y
        x = vectors[k, i]
        y = vectors[k, j]
        vectors[k, i] = c * x - s * y
        vectors[k, j] = s * x + c * y
    a[i, j] = a[j, i] = 0.0


@cython.ccall
@cython.nogil
@cython.exceptval(check=False)
def solve_linear(a: cython.double[:, ::1], b: cython.double[::1], n: cython.Py_ssize_t) -> cython.bint:
    """Solve `a x = b` for the first n rows and columns; x replaces `b`, `a` is overwritten.

    Gaussian elimination with partial pivoting. Returns False if `a` is singular.
    """
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    k: cython.Py_ssize_t
    best: cython.Py_ssize_t
    factor: cython.double
    total: cython.double
    for k in range(n):
        best = k
        for i in range(k + 1, n):
            if fabs(a[i, k]) > fabs(a[best, k]):
                best = i
        if not fabs(a[best, k]) > 0.0:
            return False
        for j in range(n):
            a[k, j], a[best, j] = a[best, j], a[k, j]
        b[k], b[best] = b[best], b[k]
        for i in range(k + 1, n):
            factor = a[i, k] / a[k, k]
            for j in range(k, n):
                a[i, j] -= factor * a[k, j]
            b[i] -= factor * b[k]
    for k in range(n):
        i = n - 1 - k
        total = b[i]
        for j in range(i + 1, n):
            total -= a[i, j] * b[j]
        b[i] = total / a[i, i]
    return True
