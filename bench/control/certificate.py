# cython: boundscheck=True, wraparound=False, cdivision=True
"""The certificate of the robust controller, after (68): the cost bound that a gain and its ellipsoid prove.

Every solver result is certified before use; the certificate does not depend on how the result was found.
"""

import math
from collections.abc import Sequence

import cython
import numpy as np
from numpy.typing import NDArray

if cython.compiled:
    from cython.cimports.bench.control.flat_matrices import (
        cholesky,
        complement,
        congruence,
        eigen,
        invert,
        multiply,
        transposed_multiply,
    )
    from cython.cimports.libc.math import isfinite, sqrt
else:
    from math import isfinite, sqrt

    from bench.control.flat_matrices import (
        blank,
        cholesky,
        complement,
        congruence,
        eigen,
        invert,
        multiply,
        transposed_multiply,
    )

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

N = cython.declare(cython.Py_ssize_t, 3)
_SMALLEST_AXIS = cython.declare(cython.double, 1e-9)


def certified_cost(
    K: Matrix, P: Matrix, rho: float, models: Sequence[tuple[Matrix, Matrix]], z: Vector, room: Vector
) -> float | None:
    """Return the worst-case cost from z that (K, P) proves, or None if they prove nothing.

    (68) is checked at every vertex and hence holds between them: the cost-to-go `W = tau P^-1` decreases by at least
    the stage cost in each step. So the state stays in the ellipsoid through z, and no state in it needs more than the
    room of any input (within 0.1 %, which the caller clips).

    Args:
        K: (m, 3) gain.
        P: (3, 3) ellipsoid.
        rho: input weight, R = rho I, Q = I.
        models: A (3, 3), B (3, m) at each vertex.
        z: (3,) deviation.
        room: (m,) input room.
    """
    A, B = (np.stack(matrices) for matrices in zip(*models, strict=True))
    K, P, z, room = (np.ascontiguousarray(each, dtype=np.float64) for each in (K, P, z, room))
    proven = float(proven_cost(K, P, rho, A, B, z, room))
    return proven if math.isfinite(proven) else None


@cython.ccall
def proven_cost(
    K: cython.double[:, ::1],
    P: cython.double[:, ::1],
    rho: cython.double,
    A: cython.double[:, :, ::1],
    B: cython.double[:, :, ::1],
    z: cython.double[::1],
    room: cython.double[::1],
) -> cython.double:
    """See `certified_cost`; models as A (n, 3, 3) and B (n, 3, m), and NaN if nothing is proven."""
    i: cython.Py_ssize_t
    radius: cython.double = 0.0
    reach: cython.double
    cost: cython.double = 0.0
    root: cython.double[9]
    inverse: cython.double[9]
    stage: cython.double[9]
    step: cython.double[9]
    if not cython.compiled:  # pragma: no branch
        root, inverse, stage, step = blank(4)
    if not (_finite(P) and _finite(K)):
        return math.nan
    # In coordinates in which the ellipsoid is the unit ball, every condition is a bound on a norm.
    if not _set_coordinates(root, inverse, P):
        return math.nan
    for i in range(N):
        reach = inverse[3 * i] * z[0] + inverse[3 * i + 1] * z[1] + inverse[3 * i + 2] * z[2]
        radius += reach * reach
    # The stage cost is root'(I + rho K'K)root.
    transposed_multiply(stage, root, root)
    for i in range(K.shape[0]):
        reach = _add_input_cost(stage, root, K[i], rho)
        # Written this way, a NaN room is rejected.
        if not sqrt(radius * reach) <= 1.001 * room[i]:
            return math.nan
    for i in range(A.shape[0]):
        _set_loop(step, A[i], B[i], K)
        cost = max(cost, _vertex_cost(step, root, inverse, stage))
    return cost * radius if isfinite(cost) else math.nan


@cython.cfunc
@cython.exceptval(check=False)
def _finite(matrix: cython.double[:, ::1]) -> cython.bint:
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    for i in range(matrix.shape[0]):
        for j in range(matrix.shape[1]):
            if not isfinite(matrix[i, j]):
                return False
    return True


@cython.cfunc
@cython.exceptval(check=False)
def _set_coordinates(root: cython.p_double, inverse: cython.p_double, P: cython.double[:, ::1]) -> cython.bint:
    """Set `root` and its inverse, `P = root root'`; False if the ellipsoid is too flat."""
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    width: cython.double
    values: cython.double[3]
    if not cython.compiled:  # pragma: no branch
        (values,) = blank(1)
    for i in range(N):
        for j in range(N):
            inverse[3 * i + j] = P[i, j]
    eigen(values, root, inverse, N)
    for j in range(N):
        if not values[j] > _SMALLEST_AXIS:
            return False
        width = sqrt(values[j])
        for i in range(N):
            inverse[3 * j + i] = root[3 * i + j] / width
            root[3 * i + j] *= width
    return True


@cython.cfunc
@cython.exceptval(check=False)
def _add_input_cost(
    stage: cython.p_double, root: cython.p_double, gain: cython.double[::1], rho: cython.double
) -> cython.double:
    """Add the cost of one input in these coordinates, and return the square of its largest value in the unit ball."""
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    reach: cython.double = 0.0
    row: cython.double[3]
    if not cython.compiled:  # pragma: no branch
        (row,) = blank(1)
    for i in range(N):
        row[i] = gain[0] * root[i] + gain[1] * root[3 + i] + gain[2] * root[6 + i]
        reach += row[i] * row[i]
    for i in range(N):
        for j in range(N):
            stage[3 * i + j] += rho * row[i] * row[j]
    return reach


@cython.cfunc
@cython.exceptval(check=False)
def _set_loop(
    out: cython.p_double, A: cython.double[:, ::1], B: cython.double[:, ::1], K: cython.double[:, ::1]
) -> cython.void:
    """Set `out = A + B K`."""
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    k: cython.Py_ssize_t
    for i in range(N):
        for j in range(N):
            out[3 * i + j] = A[i, j]
            for k in range(K.shape[0]):
                out[3 * i + j] += B[i, k] * K[k, j]


@cython.cfunc
@cython.exceptval(check=False)
def _vertex_cost(
    loop: cython.p_double, root: cython.p_double, inverse: cython.p_double, stage: cython.p_double
) -> cython.double:
    """Return the smallest tau with `I - step'step >= stage / tau`, step = inverse loop root; infinite if none."""
    i: cython.Py_ssize_t
    values: cython.double[3]
    step: cython.double[9]
    shrink: cython.double[9]
    factor: cython.double[9]
    if not cython.compiled:  # pragma: no branch
        values, step, shrink, factor = blank(4)
    multiply(shrink, inverse, loop)
    multiply(step, shrink, root)
    transposed_multiply(factor, step, step)
    complement(shrink, factor)
    if not cholesky(factor, shrink):
        return math.inf
    invert(step, factor)
    congruence(shrink, step, stage, factor)
    for i in range(9):
        if not isfinite(shrink[i]):
            return math.inf
    eigen(values, factor, shrink, N)
    return max(values[0], values[1], values[2])
