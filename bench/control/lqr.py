"""The last fallback of the tracker: a linear-quadratic gain for the nominal model."""

import numpy as np
from numpy.typing import NDArray

Matrix = NDArray[np.float64]


def lqr_gain(A: Matrix, B: Matrix, Q: Matrix, R: Matrix) -> Matrix:
    """K (m, n) of `u = K x` that minimises the infinite-horizon cost `sum x'Qx + u'Ru` of `x+ = A x + B u`.

    Raises:
        ValueError: (A, B) cannot be stabilised.
    """
    # Imported here: hardly any tracker needs it, and scipy takes 20 MB and a tenth of a second.
    from scipy.linalg import LinAlgError, solve_discrete_are

    try:
        S = solve_discrete_are(A, B, Q, R)
    except LinAlgError as error:
        raise ValueError(f"no stabilising gain: {error}") from error
    gain: Matrix = -np.linalg.solve(R + B.T @ S @ B, B.T @ S @ A)
    return gain
