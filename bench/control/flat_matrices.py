# cython: boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Small matrices as plain numbers, row by row: C arrays where compiled, lists where interpreted.

Most are 3x3 as the control model is. A product takes half as long as on numpy's arrays, because a view of such an array
is itself 200 bytes long. Only compiled modules can call these functions. Results go to the first argument, which must
not be one of the others.
"""

import cython

if cython.compiled:
    from cython.cimports.libc.math import fabs, sqrt
else:
    from math import fabs, sqrt

_SWEEPS = cython.declare(cython.int, 30)
"""Limit on Jacobi's sweeps; matrices of this size need 4 to 8."""


def blank(count: int, size: int = 9) -> list[list[float]]:
    """Return so many matrices, or vectors of up to `size` numbers, for interpreted text, in place of C arrays."""
    return [[0.0] * size for _ in range(count)]


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def copy(out: cython.p_double, a: cython.p_double) -> cython.void:
    """Set `out = a`."""
    i: cython.Py_ssize_t
    for i in range(9):
        out[i] = a[i]


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def add(out: cython.p_double, a: cython.p_double, factor: cython.double) -> cython.void:
    """Add `factor a` to `out`."""
    i: cython.Py_ssize_t
    for i in range(9):
        out[i] += factor * a[i]


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def add_symmetric(out: cython.p_double, a: cython.p_double) -> cython.void:
    """Add the symmetric part of `a` to `out`."""
    out[0] += a[0]
    out[4] += a[4]
    out[8] += a[8]
    x: cython.double = 0.5 * (a[1] + a[3])
    y: cython.double = 0.5 * (a[2] + a[6])
    z: cython.double = 0.5 * (a[5] + a[7])
    out[1] += x
    out[3] += x
    out[2] += y
    out[6] += y
    out[5] += z
    out[7] += z


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def trace(a: cython.p_double) -> cython.double:
    """Return the sum of the diagonal."""
    return a[0] + a[4] + a[8]


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def complement(out: cython.p_double, a: cython.p_double) -> cython.void:
    """Set `out = I - a`."""
    i: cython.Py_ssize_t
    for i in range(9):
        out[i] = -a[i]
    for i in range(3):
        out[4 * i] += 1.0


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def multiply(out: cython.p_double, a: cython.p_double, b: cython.p_double) -> cython.void:
    """Set `out = a b`."""
    k: cython.Py_ssize_t
    x: cython.double
    y: cython.double
    z: cython.double
    for k in range(0, 9, 3):
        x, y, z = a[k], a[k + 1], a[k + 2]
        out[k] = x * b[0] + y * b[3] + z * b[6]
        out[k + 1] = x * b[1] + y * b[4] + z * b[7]
        out[k + 2] = x * b[2] + y * b[5] + z * b[8]


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def multiply_transposed(out: cython.p_double, a: cython.p_double, b: cython.p_double) -> cython.void:
    """Set `out = a b'`."""
    k: cython.Py_ssize_t
    x: cython.double
    y: cython.double
    z: cython.double
    for k in range(0, 9, 3):
        x, y, z = a[k], a[k + 1], a[k + 2]
        out[k] = x * b[0] + y * b[1] + z * b[2]
        out[k + 1] = x * b[3] + y * b[4] + z * b[5]
        out[k + 2] = x * b[6] + y * b[7] + z * b[8]


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def transposed_multiply(out: cython.p_double, a: cython.p_double, b: cython.p_double) -> cython.void:
    """Set `out = a' b`."""
    k: cython.Py_ssize_t
    x: cython.double
    y: cython.double
    z: cython.double
    for k in range(3):
        x, y, z = a[k], a[k + 3], a[k + 6]
        out[3 * k] = x * b[0] + y * b[3] + z * b[6]
        out[3 * k + 1] = x * b[1] + y * b[4] + z * b[7]
        out[3 * k + 2] = x * b[2] + y * b[5] + z * b[8]


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def congruence(out: cython.p_double, a: cython.p_double, b: cython.p_double, spare: cython.p_double) -> cython.void:
    """Set `out = a b a'`; `spare` (3, 3) is overwritten."""
    multiply(spare, a, b)
    multiply_transposed(out, spare, a)


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def form(x: cython.p_double, a: cython.p_double) -> cython.double:
    """Return `x'a x`."""
    total: cython.double = 0.0
    i: cython.Py_ssize_t
    for i in range(3):
        total += x[i] * (a[3 * i] * x[0] + a[3 * i + 1] * x[1] + a[3 * i + 2] * x[2])
    return total


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def invert(out: cython.p_double, a: cython.p_double) -> cython.double:
    """Set `out` to the inverse of `a`, and return its determinant; if that is 0, `out` is no inverse."""
    out[0] = a[4] * a[8] - a[5] * a[7]
    out[1] = a[2] * a[7] - a[1] * a[8]
    out[2] = a[1] * a[5] - a[2] * a[4]
    out[3] = a[5] * a[6] - a[3] * a[8]
    out[4] = a[0] * a[8] - a[2] * a[6]
    out[5] = a[2] * a[3] - a[0] * a[5]
    out[6] = a[3] * a[7] - a[4] * a[6]
    out[7] = a[1] * a[6] - a[0] * a[7]
    out[8] = a[0] * a[4] - a[1] * a[3]
    determinant: cython.double = a[0] * out[0] + a[1] * out[3] + a[2] * out[6]
    i: cython.Py_ssize_t
    if determinant != 0.0:
        for i in range(9):
            out[i] /= determinant
    return determinant


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def cholesky(out: cython.p_double, a: cython.p_double) -> cython.bint:
    """Set `out` to the lower triangular root of `a = out out'`; return whether `a` is positive definite."""
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    k: cython.Py_ssize_t
    rest: cython.double
    for j in range(3):
        for i in range(3):
            if i < j:
                out[3 * i + j] = 0.0
                continue
            rest = a[3 * i + j]
            for k in range(j):
                rest -= out[3 * i + k] * out[3 * j + k]
            if i > j:
                out[3 * i + j] = rest / out[4 * j]
            elif rest > 0.0:
                out[4 * j] = sqrt(rest)
            else:
                return False
    return True


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def eigen(values: cython.p_double, vectors: cython.p_double, a: cython.p_double, n: cython.Py_ssize_t) -> cython.void:
    """Eigenvalues (n,), not sorted, and eigenvectors (columns) of a symmetric `a` (n, n), which is overwritten.

    Jacobi's method: rotations that make one element off the diagonal zero at a time.
    """
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    for i in range(n):
        for j in range(n):
            vectors[n * i + j] = 1.0 if i == j else 0.0
    rotated: cython.bint
    sweep: cython.int
    for sweep in range(_SWEEPS):  # noqa: B007 - typed
        rotated = False
        for i in range(n):
            for j in range(i + 1, n):
                # A smaller one does not change the diagonal.
                if fabs(a[n * i + j]) > 1e-17 * (fabs(a[(n + 1) * i]) + fabs(a[(n + 1) * j])):
                    rotated = True
                    _rotate(vectors, a, i, j, n)
        if not rotated:
            break
    for i in range(n):
        values[i] = a[(n + 1) * i]


@cython.cfunc
@cython.nogil
@cython.exceptval(check=False)
def _rotate(
    vectors: cython.p_double, a: cython.p_double, i: cython.Py_ssize_t, j: cython.Py_ssize_t, n: cython.Py_ssize_t
) -> cython.void:
    """Turn axes i and j so that `a[i, j]` becomes 0."""
    k: cython.Py_ssize_t
    x: cython.double
    y: cython.double
    theta: cython.double = 0.5 * (a[(n + 1) * j] - a[(n + 1) * i]) / a[n * i + j]
    t: cython.double = 1.0 / (fabs(theta) + sqrt(theta * theta + 1.0))
    if theta < 0.0:
        t = -t
    c: cython.double = 1.0 / sqrt(t * t + 1.0)
    s: cython.double = t * c
    for k in range(n):
        x = a[n * k + i]
        y = a[n * k + j]
        a[n * k + i] = c * x - s * y
        a[n * k + j] = s * x + c * y
    for k in range(n):
        x = a[n * i + k]
        y = a[n * j + k]
        a[n * i + k] = c * x - s * y
        a[n * j + k] = s * x + c * y
        x = vectors[n * k + i]
        y = vectors[n * k + j]
        vectors[n * k + i] = c * x - s * y
        vectors[n * k + j] = s * x + c * y
    a[n * i + j] = a[n * j + i] = 0.0
