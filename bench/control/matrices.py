# cython: boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Matrices of 3 rows and 3 columns, as the control model has: written out, because numpy costs a microsecond a call.

Results go to `out` (3, 3), which must not be one of the arguments. Compiled modules call these functions directly.
"""

import cython


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
