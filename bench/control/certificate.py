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
    from cython.cimports.bench.control.matrices import (
        add,
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

    from bench.control.matrices import (
        add,
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
    if not (_finite(P) and _finite(K)):
        return math.nan
    # In coordinates in which the ellipsoid is the unit ball, every condition is a bound on a norm.
    root: cython.double[:, ::1] = np.empty((N, N))
    inverse: cython.double[:, ::1] = np.empty((N, N))
    if not _set_coordinates(root, inverse, P):
        return math.nan
    i: cython.Py_ssize_t
    m: cython.Py_ssize_t = K.shape[0]
    radius: cython.double = 0.0
    for i in range(N):
        radius += (inverse[i, 0] * z[0] + inverse[i, 1] * z[1] + inverse[i, 2] * z[2]) ** 2
    gain: cython.double[:, ::1] = np.empty((m, N))
    _set_product(gain, K, root)
    for i in range(m):
        # Written this way, a NaN room is rejected.
        if not sqrt(radius * (gain[i, 0] ** 2 + gain[i, 1] ** 2 + gain[i, 2] ** 2)) <= 1.001 * room[i]:
            return math.nan
    stage: cython.double[:, ::1] = np.empty((N, N))
    _set_stage_cost(stage, root, gain, rho)
    cost: cython.double = 0.0
    step: cython.double[:, ::1] = np.empty((N, N))
    of_gain: cython.double[:, ::1] = np.empty((N, N))
    for i in range(A.shape[0]):
        _set_product(step, A[i], root)
        _set_product(of_gain, B[i], gain)
        add(step, of_gain, 1.0)
        multiply(of_gain, inverse, step)
        cost = max(cost, _vertex_cost(of_gain, stage))
    return cost * radius if cost < math.inf else math.nan


@cython.cfunc
def _finite(matrix: cython.double[:, ::1]) -> cython.bint:
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    for i in range(matrix.shape[0]):
        for j in range(matrix.shape[1]):
            if not isfinite(matrix[i, j]):
                return False
    return True


@cython.cfunc
def _set_coordinates(
    root: cython.double[:, ::1], inverse: cython.double[:, ::1], P: cython.double[:, ::1]
) -> cython.bint:
    """Set `root` and its inverse, `P = root root'`; False if the ellipsoid is too flat."""
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    values: cython.double[::1] = np.empty(N)
    width: cython.double
    eigen(values, root, np.array(P))
    for j in range(N):
        if not values[j] > _SMALLEST_AXIS:
            return False
        width = sqrt(values[j])
        for i in range(N):
            inverse[j, i] = root[i, j] / width
            root[i, j] *= width
    return True


@cython.cfunc
def _set_product(out: cython.double[:, ::1], a: cython.double[:, ::1], b: cython.double[:, ::1]) -> cython.void:
    """Set `out = a b` for any number of inputs."""
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    k: cython.Py_ssize_t
    for i in range(a.shape[0]):
        for j in range(N):
            out[i, j] = 0.0
            for k in range(a.shape[1]):
                out[i, j] += a[i, k] * b[k, j]


@cython.cfunc
def _set_stage_cost(
    out: cython.double[:, ::1], root: cython.double[:, ::1], gain: cython.double[:, ::1], rho: cython.double
) -> cython.void:
    """Set `out = root'root + rho gain'gain`."""
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    k: cython.Py_ssize_t
    transposed_multiply(out, root, root)
    for i in range(N):
        for j in range(N):
            for k in range(gain.shape[0]):
                out[i, j] += rho * gain[k, i] * gain[k, j]


@cython.cfunc
def _vertex_cost(step: cython.double[:, ::1], stage: cython.double[:, ::1]) -> cython.double:
    """Return the smallest tau with `I - step'step >= stage / tau`; infinite if there is none."""
    values: cython.double[::1] = np.empty(N)
    shrink: cython.double[:, ::1] = np.empty((N, N))
    factor: cython.double[:, ::1] = np.empty((N, N))
    inverse: cython.double[:, ::1] = np.empty((N, N))
    transposed_multiply(factor, step, step)
    complement(shrink, factor)
    if not cholesky(factor, shrink):
        return math.inf
    invert(inverse, factor)
    congruence(shrink, inverse, stage, factor)
    if not _finite(shrink):
        return math.inf
    eigen(values, factor, shrink)
    return max(values[0], values[1], values[2])
