# cython: boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""The lumped-disturbance observer, (37)-(42).

`xibar+ = A xibar + B ubar + T d`, `d+ = d`: d lumps everything the nominal model omits (cornering
stiffness, wind, slope, rolling resistance, linearisation) as an acceleration [m/s^2, m/s^2, rad/s^2]; hence E = T I.
As in the paper, all of `[v_x, v_y, gamma]` is measured (C = I).
"""

import cython
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
        n = gain.shape[1]
        self._gain = gain
        self._step_s = step_s
        self._started = False
        self._state = np.zeros(n)
        self._error = np.zeros(n)
        self._previous = np.zeros(n)
        self._disturbance = np.zeros(n)
        self._next = np.zeros(n)

    def correct(self, xi: cython.double[::1]) -> Vector:
        """Process a measured state (3,) and return the disturbance estimate (3,), an acceleration.

        The first measurement initialises the observer, with zero disturbance.
        """
        out = np.empty(xi.shape[0])
        self.set_disturbance(out, xi)
        return out

    def set_disturbance(self, out: cython.double[::1], xi: cython.double[::1]) -> cython.void:
        """Set `out` to the result of `correct`."""
        i: cython.Py_ssize_t
        j: cython.Py_ssize_t
        n: cython.Py_ssize_t = xi.shape[0]
        correction: cython.double
        for i in range(n):
            if not self._started:
                self._state[i] = xi[i]
            self._error[i] = self._state[i] - xi[i]
            self._previous[i] = self._disturbance[i]
        self._started = True
        for i in range(n):
            correction = 0.0
            for j in range(n):
                correction += self._gain[n + i, j] * self._error[j]
            self._disturbance[i] = self._previous[i] + correction
            out[i] = self._disturbance[i]

    def predict(
        self,
        A: cython.double[:, ::1],
        B: cython.double[:, ::1],
        xi_ref: cython.double[::1],
        u_dev: cython.double[::1],
        drift: cython.double[::1],
    ) -> None:
        """Predict the next state from the input actually applied; `correct` must have been called before.

        Args:
            A: (3, 3) model at this step.
            B: (3, m) model at this step.
            xi_ref: (3,) this step's reference state.
            u_dev: (m,) applied input minus reference input.
            drift: (3,) next state from the reference state with the reference input.

        Raises:
            ValueError: there has been no measurement.
        """
        if not self._started:
            raise ValueError("the observer predicts only after its first measurement")
        i: cython.Py_ssize_t
        j: cython.Py_ssize_t
        n: cython.Py_ssize_t = xi_ref.shape[0]
        for i in range(n):
            self._next[i] = 0.0
            for j in range(n):
                self._next[i] += self._gain[i, j] * self._error[j]
            for j in range(n):
                self._next[i] += A[i, j] * (self._state[j] - xi_ref[j])
            for j in range(u_dev.shape[0]):
                self._next[i] += B[i, j] * u_dev[j]
            self._next[i] += self._step_s * self._previous[i]
        for i in range(n):
            self._state[i] = drift[i] + self._next[i]
