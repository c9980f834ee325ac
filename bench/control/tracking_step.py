# cython: boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""A step of the tracker around its gain: what the robust MPC gets, (21)-(23) and (37)-(49), and the input that follows.

All that a step needs of the one before is kept here.
"""

from typing import NamedTuple

import cython
import numpy as np
from numpy.typing import NDArray

from bench.control.allocation import allocate
from bench.control.kept_gain import observer_gain
from bench.control.settings import TrackerSettings
from bench.control.vehicle_model import LinearModel, VehicleModel

if cython.compiled:
    from cython.cimports.bench.control.observer import DisturbanceObserver
    from cython.cimports.bench.control.reference import ReferenceSearch
    from cython.cimports.bench.control.target import TargetSearch
    from cython.cimports.bench.control.vehicle_model import linearise, multiply, steady_lateral_velocity
    from cython.cimports.libc.math import fabs
else:
    from math import fabs

    from bench.control.observer import DisturbanceObserver
    from bench.control.reference import ReferenceSearch
    from bench.control.target import TargetSearch
    from bench.control.vehicle_model import linearise, multiply, steady_lateral_velocity

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

SLOWEST_MPS = 3.0
"""The control model divides by v_x: below this speed (m/s) it is evaluated at this speed."""

_REFERENCE_STATE = np.array([1.0, 1e-3, 10.0])
_REFERENCE_INPUT = np.array([1e-7, 1e-7, 1e-5])
"""Weights per squared unit of the states, and of the inputs relative to their limits: meet the next reference, with low
weight on v_y, by steering rather than by yaw moment."""

_OBSERVER_SPEEDS_MPS = (5.0, 10.0, 20.0, 40.0)

_SLOWEST = cython.declare(cython.double, SLOWEST_MPS)
_N = cython.declare(cython.int, 3)
_REAL_INPUTS = cython.declare(cython.int, 5)
_PASSES = cython.declare(cython.int, 2)


class Prepared(NamedTuple):
    """What a step knows before its gain is found.

    Attributes:
        reference: (3,) reference state of this step [v_x, v_y, gamma].
        reference_u: (3,) reference input [delta, F, M] (rad, N, N m).
        disturbance: (3,) estimate [m/s^2, m/s^2, rad/s^2].
        target: (3,) steady-state target, deviation from the reference.
        model: model with virtual inputs at the reference.
        chi: (3,) deviation from the target.
        room: (3,) range of each input about its target.
    """

    reference: Vector
    reference_u: Vector
    disturbance: Vector
    target: Vector
    model: LinearModel
    chi: Vector
    room: Vector


class TrackingStep:
    """The numbers of the tracker's steps.

    Args:
        settings: weights and limits.
        model: the control model with nominal parameters.
        state_unit: (3,) size of one unit of each state.

    Raises:
        ValueError: the observer rate cannot be reached.
    """

    def __init__(self, settings: TrackerSettings, model: VehicleModel, state_unit: Vector) -> None:
        vehicle, share = model.vehicle, settings.yaw_moment_share
        allocation = allocate(vehicle, settings.steering_max_rad, settings.wheel_force_max_n, share)
        self._numbers = model.numbers
        self._T = model.step_s
        self._offset_free = settings.offset_free
        self._allocation = self._of_virtual = allocation.matrix
        self._limit = allocation.limit
        self._rate = model.step_s * np.array(
            [
                settings.steering_rate_max_radps,
                4.0 * settings.wheel_force_rate_max_nps * (1.0 - share),
                2.0 * vehicle.l_t * settings.wheel_force_rate_max_nps * share,
            ]
        )
        straight = [model.linearise(np.array([v, 0.0, 0.0]), np.zeros(5)).A for v in _OBSERVER_SPEEDS_MPS]
        gain = observer_gain(straight, model.step_s, settings.observer_rate)
        self._observer = DisturbanceObserver(gain, model.step_s)
        self._search = ReferenceSearch(model, allocation, _REFERENCE_STATE, _REFERENCE_INPUT)
        self._target_search = TargetSearch(state_unit, allocation.limit)
        # Of this step and, until it is prepared, of the one before: model, reference, its next state, input.
        self._has_model = False
        self._model = np.zeros((5, _N, _N))
        of_step = np.zeros((8, _N))
        self._reference, self._reference_u, self._drift, self._u = of_step[0], of_step[1], of_step[2], of_step[3]
        self._target_u = of_step[4]
        work = np.zeros((7, _N))
        self._xi, self._next, self._u_dev, self._residual = work[0], work[1], work[2], work[3]
        self._known, self._lower, self._upper = work[4], work[5], work[6]
        self._real_B, self._real_N2 = np.zeros((_N, _REAL_INPUTS)), np.zeros((_N, _REAL_INPUTS))

    def prepare(
        self, xi: Vector, now: tuple[float, float], then: tuple[float, float], applied: Vector | None
    ) -> Prepared:
        """Return what a step knows before its gain is found; the arguments are those of `Tracker.step`."""
        i: cython.Py_ssize_t
        # One array for all vectors, because an array costs more than the arithmetic.
        vectors, models = np.empty((6, _N)), np.empty((5, _N, _N))
        rows: cython.double[:, ::1] = vectors
        reference: cython.double[::1] = rows[0]
        reference_u: cython.double[::1] = rows[1]
        disturbance: cython.double[::1] = rows[2]
        target: cython.double[::1] = rows[3]
        self._measure(disturbance, xi, applied)
        self._set_reference_state(reference, now[0], now[1])
        self._set_reference_state(self._next, then[0], then[1])
        self._search.find(reference_u, self._residual, reference, self._next, self._reference_u, _PASSES)
        self._model = models
        # numpy's product rounds differently from one written out.
        self._linearise(reference, self._allocation.dot(vectors[1]))
        self._set_target(target, disturbance, reference_u)
        for i in range(_N):
            rows[4, i] = self._xi[i] - reference[i] - target[i]
            # Some of it is left at a limit.
            rows[5, i] = max(self._limit[i] - fabs(reference_u[i] + self._target_u[i]), 0.02 * self._limit[i])
            self._reference[i], self._reference_u[i] = reference[i], reference_u[i]
            self._drift[i] = self._next[i] + self._residual[i]
        self._has_model = True
        model = LinearModel(models[0], models[1], models[2], models[3], models[4])
        return Prepared(vectors[0], vectors[1], vectors[2], vectors[3], model, vectors[4], vectors[5])

    def finish(self, K: Matrix, chi: Vector) -> tuple[Vector, Vector]:
        """Return the virtual input (3,) and the real one (5,) of the step with the gain K (3, 3)."""
        i: cython.Py_ssize_t
        out = np.empty(_N)
        u: cython.double[::1] = out
        feedback: cython.double[::1] = K.dot(chi)
        for i in range(_N):
            u[i] = self._reference_u[i] + self._target_u[i] + feedback[i]
            u[i] = min(max(u[i], self._u[i] - self._rate[i]), self._u[i] + self._rate[i])
            u[i] = min(max(u[i], -self._limit[i]), self._limit[i])
            self._u[i] = u[i]
        return out, self._allocation.dot(out)

    def _measure(self, disturbance: cython.double[::1], xi: cython.double[::1], applied: Vector | None) -> None:
        """Set the disturbance from what was measured, and applied since the last step."""
        i: cython.Py_ssize_t
        if applied is not None:
            told: cython.double[::1] = applied
            for i in range(_N):
                self._u[i] = told[i]
        for i in range(_N):
            self._xi[i] = xi[i]
            self._u_dev[i] = self._u[i] - self._reference_u[i]
        self._xi[0] = max(xi[0], _SLOWEST)
        if self._has_model:
            self._observer.predict(self._model[0], self._model[1], self._reference, self._u_dev, self._drift)
        self._observer.set_disturbance(disturbance, self._xi)

    def _set_reference_state(self, xi: cython.double[::1], v_x: cython.double, gamma: cython.double) -> cython.void:
        v_x = max(v_x, _SLOWEST)
        xi[0], xi[1], xi[2] = v_x, steady_lateral_velocity(self._numbers, v_x, gamma), gamma

    def _linearise(self, xi: cython.double[::1], U: cython.double[::1]) -> cython.void:
        """Set A, B, H, N1, N2 of the model with virtual inputs."""
        model: cython.double[:, :, ::1] = self._model
        linearise(model[0], self._real_B, model[2], model[3], self._real_N2, self._numbers, xi, U)
        multiply(model[1], self._real_B, self._of_virtual)
        multiply(model[4], self._real_N2, self._of_virtual)

    def _set_target(
        self, target: cython.double[::1], disturbance: cython.double[::1], reference_u: cython.double[::1]
    ) -> None:
        i: cython.Py_ssize_t
        largest: cython.double
        for i in range(_N):
            self._known[i] = self._residual[i]
            if self._offset_free:
                self._known[i] += self._T * disturbance[i]
            # Part of each input's range is reserved for the feedback, whose bounds are symmetric about the target.
            largest = 0.95 * self._limit[i]
            self._lower[i] = max(-largest, min(self._u[i], largest) - self._rate[i])
            self._upper[i] = min(largest, max(self._u[i], -largest) + self._rate[i])
        self._target_search.find(
            target,
            self._target_u,
            self._model[0],
            self._model[1],
            self._known,
            reference_u,
            self._lower,
            self._upper,
        )
