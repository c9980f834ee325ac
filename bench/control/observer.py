"""The lumped-disturbance observer, (37)-(42).

`xibar+ = A xibar + B ubar + T d`, `d+ = d`: d lumps everything the nominal model omits (cornering
stiffness, wind, slope, rolling resistance, linearisation) as an acceleration [m/s^2, m/s^2, rad/s^2]; hence E = T I.
As in the paper, all of `[v_x, v_y, gamma]` is measured (C = I).
"""

import numpy as np
from numpy.typing import NDArray

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


def augmented(A: Matrix, step_s: float) -> Matrix:
    """A_obs (6, 6) of (38) for a model A (3, 3)."""
    n = A.shape[0]
    return np.block([[A, step_s * np.eye(n)], [np.zeros((n, n)), np.eye(n)]])


class DisturbanceObserver:
    """Estimates the deviation state and the disturbance from measured states, (39).

    Args:
        gain: L (6, 3) of `design_gain`.
        step_s: sampling time T, s.
    """

    def __init__(self, gain: Matrix, step_s: float) -> None:
        self._gain = gain
        self._step_s = step_s
        self._state: Vector | None = None
        self._error: Vector = np.zeros(gain.shape[1])
        self._previous: Vector = np.zeros(gain.shape[1])
        self.disturbance: Vector = np.zeros(gain.shape[1])

    def correct(self, xi: Vector) -> Vector:
        """Process a measured state (3,) and return the disturbance estimate (3,), an acceleration.

        The first measurement initialises the observer, with zero disturbance.
        """
        if self._state is None:
            self._state = xi
        self._error = self._state - xi
        self._previous = self.disturbance
        self.disturbance = self._previous + self._gain[xi.size :] @ self._error
        return self.disturbance

    def predict(self, A: Matrix, B: Matrix, xi_ref: Vector, u_dev: Vector, drift: Vector) -> None:
        """Predict the next state from the input actually applied; `correct` must have been called before.

        Args:
            A: (3, 3) model at this step.
            B: (3, m) model at this step.
            xi_ref: (3,) this step's reference state.
            u_dev: (m,) applied input minus reference input.
            drift: (3,) next state from the reference state with the reference input.
        """
        if self._state is None:
            raise ValueError("the observer predicts only after its first measurement")
        self._state = (
            drift
            + A @ (self._state - xi_ref)
            + B @ u_dev
            + self._step_s * self._previous
            + self._gain[: xi_ref.size] @ self._error
        )
