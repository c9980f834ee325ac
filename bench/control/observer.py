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
        self.disturbance = self._previous + self._correction(xi.size)
        return self.disturbance

    def _correction(self, first: cython.Py_ssize_t) -> Vector:
        """L times the error: its states from the first one on, as many as are measured."""
        i: cython.Py_ssize_t
        j: cython.Py_ssize_t
        L: cython.double[:, ::1] = self._gain
        error: cython.double[::1] = self._error
        out = np.zeros(error.shape[0])
        correction: cython.double[::1] = out
        for i in range(error.shape[0]):
            for j in range(error.shape[0]):
                correction[i] += L[first + i, j] * error[j]
        return out

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
        i: cython.Py_ssize_t
        j: cython.Py_ssize_t
        of_state: cython.double[:, ::1] = A
        of_input: cython.double[:, ::1] = B
        state: cython.double[::1] = self._state
        origin: cython.double[::1] = xi_ref
        inputs: cython.double[::1] = u_dev
        previous: cython.double[::1] = self._previous
        T: cython.double = self._step_s
        out = self._correction(0)
        predicted: cython.double[::1] = out
        for i in range(state.shape[0]):
            for j in range(state.shape[0]):
                predicted[i] += of_state[i, j] * (state[j] - origin[j])
            for j in range(inputs.shape[0]):
                predicted[i] += of_input[i, j] * inputs[j]
            predicted[i] += T * previous[i]
        self._state = drift + out
