# cython: boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Small matrices as views of numpy's arrays, most of them 3x3 as the control model is; see `flat_matrices`.

Written out, because numpy costs a microsecond a call. Results go to the first argument, which must not be one of the
others. Compiled modules call these functions directly.
"""

import cython

if cython.compiled:
    from cython.cimports.bench.control import flat_matrices
    from cython.cimports.libc.math import fabs
else:
    from math import fabs

    from bench.control import flat_matrices


@cython.ccall
@cython.nogil
@cython.exceptval(check=False)
def invert(out: cython.double[:, ::1], a: cython.double[:, ::1]) -> cython.double:
    """Set `out` to the inverse of `a`, and return its determinant; if that is 0, `out` is no inverse."""
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    flat: cython.double[9]
    inverse: cython.double[9]
    if not cython.compiled:
        flat, inverse = flat_matrices.blank(2)
    for i in range(3):
        for j in range(3):
            flat[3 * i + j] = a[i, j]
    determinant: cython.double = flat_matrices.invert(inverse, flat)
    for i in range(3):
        for j in range(3):
            out[i, j] = inverse[3 * i + j]
    return determinant


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
