"""Small dense quadratic programs, solved by the active-set solver daqp."""

from dataclasses import dataclass

import daqp
import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

_OPTIMAL = 1
_EQUALITY = 5


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
        rows, values = np.zeros((0, n)), np.zeros(0)
    else:
        rows, values = np.ascontiguousarray(equality[0]), equality[1]
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
