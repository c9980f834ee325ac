# cython: boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Small dense quadratic programs: boxes by a primal-dual active-set method, all others by the solver daqp."""

from dataclasses import dataclass

import cython
import numpy as np
from numpy.typing import NDArray

if cython.compiled:
    from cython.cimports.bench.control.matrices import solve_linear
    from cython.cimports.libc.math import isfinite
else:
    from math import isfinite

    from bench.control.matrices import solve_linear

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

_OPTIMAL = 1
_EQUALITY = 5
_PASSES = cython.declare(cython.int, 20)
"""Limit on the passes of `minimise_in_box`; most programs need one to three."""


@dataclass(frozen=True)
class QuadraticSolution:
    """The minimiser, and whether the solver found the optimum.

    Attributes:
        x: (n,) the minimiser; meaningless if `solved` is false.
        solved: whether the solver found the optimum.
    """

    x: Vector
    solved: bool


def minimise(
    hessian: Matrix,
    gradient: Vector,
    lower: Vector,
    upper: Vector,
    equality: tuple[Matrix, Vector] | None = None,
) -> QuadraticSolution:
    """Solve `min x'Hx/2 + g'x` with `lower <= x <= upper` and, if given, `E x = e`.

    Args:
        hessian: (n, n) positive definite.
        gradient: (n,).
        lower: (n,) lower bounds, -inf for none.
        upper: (n,) upper bounds, inf for none.
        equality: E (m, n) and e (m,).
    """
    n = gradient.size
    if equality is None:
        x = np.empty(n)
        if minimise_in_box(x, np.ascontiguousarray(hessian), gradient, lower, upper, np.empty((n + 2, n))):
            return QuadraticSolution(x, True)
        rows, values = np.zeros((0, n)), np.zeros(0)
    else:
        rows, values = np.ascontiguousarray(equality[0]), equality[1]
    # Imported here because hardly any run comes here.
    import daqp

    sense = np.zeros(n + values.size, dtype=np.intc)
    sense[n:] = _EQUALITY
    x, _, flag, _ = daqp.solve(
        np.ascontiguousarray(hessian),
        gradient,
        rows,
        np.concatenate([upper, values]),
        np.concatenate([lower, values]),
        sense,
    )
    return QuadraticSolution(np.asarray(x), flag == _OPTIMAL and bool(np.isfinite(x).all()))


@cython.ccall
def minimise_in_box(
    x: cython.double[::1],
    hessian: cython.double[:, ::1],
    gradient: cython.double[::1],
    lower: cython.double[::1],
    upper: cython.double[::1],
    work: cython.double[:, ::1],
) -> cython.bint:
    """Set x (n,) to the solution of `minimise` without equality; return False if it was not found.

    The primal-dual active-set method (Hintermueller, Ito, Kunisch 2003): solve with the active variables at their
    bounds; then those beyond a bound become active, and active ones whose slope points into the box become free. When
    none changes, x meets the optimality conditions. That mostly happens, but need not.

    `work` (n + 2, n) is overwritten: an array costs more than the arithmetic.
    """
    n: cython.Py_ssize_t = x.shape[0]
    i: cython.Py_ssize_t
    matrix: cython.double[:, ::1] = work[:n]
    right: cython.double[::1] = work[n]
    # -1 where the lower bound is active, 1 where the upper one is, 0 where the variable is free.
    active: cython.double[::1] = work[n + 1]
    for i in range(n):
        if not lower[i] <= upper[i]:
            return False
        active[i] = -1.0 if lower[i] == upper[i] else 0.0
    for _ in range(_PASSES):
        _set_equations(matrix, right, active, hessian, gradient, lower, upper)
        for i in range(n):
            x[i] = right[i]
        if not solve_linear(matrix, right, n):
            return False
        for i in range(n):
            # Active ones are exactly at their bounds.
            if active[i] == 0.0:
                x[i] = right[i]
        if _is_optimal(active, x, hessian, gradient, lower, upper):
            return _is_finite(x)
    return False


@cython.cfunc
@cython.exceptval(check=False)
def _set_equations(
    matrix: cython.double[:, ::1],
    right: cython.double[::1],
    active: cython.double[::1],
    hessian: cython.double[:, ::1],
    gradient: cython.double[::1],
    lower: cython.double[::1],
    upper: cython.double[::1],
) -> cython.void:
    """Set `matrix x = right`: no slope along free variables, the active ones at their bounds."""
    n: cython.Py_ssize_t = right.shape[0]
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    for i in range(n):
        for j in range(n):
            matrix[i, j] = hessian[i, j] if active[i] == 0.0 else (1.0 if i == j else 0.0)
        if active[i] == 0.0:
            right[i] = -gradient[i]
        else:
            right[i] = lower[i] if active[i] < 0.0 else upper[i]


@cython.cfunc
@cython.exceptval(check=False)
def _is_optimal(
    active: cython.double[::1],
    x: cython.double[::1],
    hessian: cython.double[:, ::1],
    gradient: cython.double[::1],
    lower: cython.double[::1],
    upper: cython.double[::1],
) -> cython.bint:
    """Whether x meets the optimality conditions; otherwise what contradicts them becomes active or free."""
    n: cython.Py_ssize_t = x.shape[0]
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    slope: cython.double
    optimal: cython.bint = True
    for i in range(n):
        if active[i] == 0.0:
            if x[i] < lower[i] or x[i] > upper[i]:
                active[i] = -1.0 if x[i] < lower[i] else 1.0
                optimal = False
        elif lower[i] < upper[i]:
            slope = gradient[i]
            for j in range(n):
                slope += hessian[i, j] * x[j]
            if slope * active[i] > 0.0:
                active[i] = 0.0
                optimal = False
    return optimal


@cython.cfunc
@cython.exceptval(check=False)
def _is_finite(x: cython.double[::1]) -> cython.bint:
    i: cython.Py_ssize_t
    for i in range(x.shape[0]):  # noqa: SIM110 - typed
        if not isfinite(x[i]):
            return False
    return True
