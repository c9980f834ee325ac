"""The certificate of the robust controller, after (68): the cost bound that a gain and its ellipsoid prove.

Every solver result is certified before use; the certificate does not depend on how the result was found.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bench.control.compiled import njit

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Stack = NDArray[np.float64]

N = 3
_SMALLEST_AXIS = 1e-9


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
    proven = float(proven_cost(np.ascontiguousarray(K), P, rho, A, B, z, room))
    return proven if math.isfinite(proven) else None


@njit(cache=True)
def proven_cost(K: Matrix, P: Matrix, rho: float, A: Stack, B: Stack, z: Vector, room: Vector) -> float:
    """See `certified_cost`; models as A (n, 3, 3) and B (n, 3, m), and NaN if nothing is proven."""
    if not (np.isfinite(P).all() and np.isfinite(K).all()):
        return math.nan
    values, axes = np.linalg.eigh(P)
    if not values[0] > _SMALLEST_AXIS:
        return math.nan
    # In coordinates in which the ellipsoid is the unit ball, every condition is a bound on a norm.
    root = axes * np.sqrt(values)
    inverse = np.ascontiguousarray((axes / np.sqrt(values)).T)
    gain = K @ root
    radius = np.linalg.norm(inverse @ z)
    for j in range(room.size):
        # Written this way, a NaN room is rejected.
        if not radius * np.linalg.norm(gain[j]) <= 1.001 * room[j]:
            return math.nan
    stage = root.T @ root + rho * gain.T @ gain
    cost = 0.0
    for k in range(len(A)):
        step = inverse @ (A[k] @ root + B[k] @ gain)
        shrink = np.eye(N) - step.T @ step
        if not np.linalg.eigvalsh(shrink)[0] > 0.0:
            return math.nan
        # The smallest tau with shrink >= stage / tau.
        factor = np.linalg.inv(np.linalg.cholesky(shrink))
        cost = max(cost, np.linalg.eigvalsh(factor @ stage @ factor.T)[-1])
    return float(cost * radius**2)
