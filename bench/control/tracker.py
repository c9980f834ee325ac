# cython: boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""The tracking level: reference input, observer, target and robust MPC in one step, (21)-(23) and (37)-(62)."""

from collections.abc import Sequence
from dataclasses import dataclass
from time import perf_counter

import cython
import numpy as np
from numpy.typing import NDArray

from bench.control.allocation import VIRTUAL_INPUTS, allocate
from bench.control.kept_gain import observer_gain
from bench.control.lqr import lqr_gain
from bench.control.observer import DisturbanceObserver
from bench.control.outcome import GainSource, SolverStatus
from bench.control.program import Program
from bench.control.programs import programs
from bench.control.reference import reference_input
from bench.control.rmpc import Gain, RobustController
from bench.control.settings import TrackerSettings
from bench.control.target import Target, steady_state_target
from bench.control.vehicle_model import LinearModel, VehicleModel
from platoon_fmu.parameters import VehicleParameters

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

SLOWEST_MPS = 3.0
"""The control model divides by v_x: below this speed (m/s) it is evaluated at this speed."""


@dataclass(frozen=True)
class TrackerOutput:
    """One step of the tracker.

    Attributes:
        u: (3,) virtual input [delta, F, M] (rad, N, N m) behind the commands.
        steering: front steering angle, rad.
        wheel_forces: (4,) longitudinal forces F_x1..F_x4, N.
        reference: (3,) reference state of this step [v_x, v_y, gamma].
        reference_u: (3,) reference input [delta, F, M].
        disturbance: (3,) estimate [m/s^2, m/s^2, rad/s^2].
        target: (3,) steady-state target, deviation from the reference.
        tau: certified bound of the worst-case cost; 0 if no programme was certified.
        status: outcome of the semidefinite programme.
        source: source of the feedback gain.
        iterations: of the solver.
        solve_s: wall-clock time of the semidefinite programme including its certificate, s.
    """

    u: Vector
    steering: float
    wheel_forces: Vector
    reference: Vector
    reference_u: Vector
    disturbance: Vector
    target: Vector
    tau: float
    status: SolverStatus
    source: GainSource
    iterations: int
    solve_s: float


@dataclass(frozen=True)
class _Step:
    """Data of a step that the observer needs once the applied input is known."""

    A: Matrix
    B: Matrix
    xi_ref: Vector
    u_ref: Vector
    drift: Vector


def own_programs(settings: TrackerSettings) -> tuple[Program, ...]:
    """Return the programs that the bench's tracker tries in turn."""
    return programs(
        VIRTUAL_INPUTS,
        settings.input_weight,
        independent=settings.independent_axles,
        tolerance=settings.solver_tolerance,
        max_iterations=settings.solver_max_iterations,
    )


class Tracker:
    """Tracks [v_x, gamma] references without offset, for every cornering stiffness in the allowed range.

    Args:
        settings: weights and limits.
        vehicle: nominal parameters.
        step_s: cycle time T, s.
        solvers: what finds the feedback gain, tried in turn; None for `own_programs`.

    Raises:
        ValueError: the observer rate cannot be reached.
    """

    # Weights per squared unit of the states, and of the inputs relative to their limits: meet the next reference, with
    # low weight on v_y, by steering rather than by yaw moment.
    _REFERENCE_STATE = np.array([1.0, 1e-3, 10.0])
    _REFERENCE_INPUT = np.array([1e-7, 1e-7, 1e-5])
    _OBSERVER_SPEEDS_MPS = (5.0, 10.0, 20.0, 40.0)

    def __init__(
        self,
        settings: TrackerSettings,
        vehicle: VehicleParameters,
        step_s: float,
        solvers: Sequence[Program] | None = None,
    ) -> None:
        self.settings = settings
        self.model = VehicleModel(vehicle, step_s)
        self._allocation = allocate(
            vehicle, settings.steering_max_rad, settings.wheel_force_max_n, settings.yaw_moment_share
        )
        self._rate = step_s * np.array(
            [
                settings.steering_rate_max_radps,
                4.0 * settings.wheel_force_rate_max_nps * (1.0 - settings.yaw_moment_share),
                2.0 * vehicle.l_t * settings.wheel_force_rate_max_nps * settings.yaw_moment_share,
            ]
        )
        self._state_unit = np.array(
            [settings.speed_unit_mps, settings.lateral_speed_unit_mps, settings.yaw_rate_unit_radps]
        )
        self._input_unit = np.array([settings.steering_unit_rad, settings.force_unit_n, settings.yaw_moment_unit_nm])
        self._controller = RobustController(
            self._state_unit,
            self._input_unit,
            settings.input_weight,
            own_programs(settings) if solvers is None else solvers,
            independent=settings.independent_axles,
        )
        straight = [self.model.linearise(np.array([v, 0.0, 0.0]), np.zeros(5)).A for v in self._OBSERVER_SPEEDS_MPS]
        self._observer = DisturbanceObserver(observer_gain(straight, step_s, settings.observer_rate), step_s)
        self._last: _Step | None = None
        self._u_last: Vector = np.zeros(3)
        self._u_ref_last: Vector = np.zeros(3)
        self._gain_last: Matrix | None = None

    def step(
        self, xi: Vector, now: tuple[float, float], then: tuple[float, float], applied: Vector | None = None
    ) -> TrackerOutput:
        """Run one cycle.

        Args:
            xi: (3,) measured state [v_x, v_y, gamma].
            now: this cycle's reference (v_x, gamma), m/s and rad/s.
            then: the next cycle's.
            applied: (3,) virtual input actually applied since the last step; None if it was the one returned then.
        """
        xi = np.array([max(xi[0], SLOWEST_MPS), xi[1], xi[2]])
        xi_ref, xi_next = self._reference_state(now), self._reference_state(then)
        u_last = self._u_last if applied is None else applied

        if self._last is not None:
            self._observer.predict(
                self._last.A, self._last.B, self._last.xi_ref, u_last - self._last.u_ref, self._last.drift
            )
        disturbance = self._observer.correct(xi)

        reference = reference_input(
            self.model,
            self._allocation,
            xi_ref,
            xi_next,
            self._u_ref_last,
            self._REFERENCE_STATE,
            self._REFERENCE_INPUT,
        )
        linear = self.model.linearise(xi_ref, self._allocation.matrix @ reference.u)
        linear = linear.with_inputs(self._allocation.matrix)
        A, B = linear.A, linear.B
        known = reference.residual
        if self.settings.offset_free:
            known = known + self.model.step_s * disturbance
        target = self._target(A, B, known, reference.u, u_last)

        chi = xi - xi_ref - target.xi
        start = perf_counter()
        gain = self._solve(linear, chi, reference.u + target.u)
        solve_s = perf_counter() - start
        K, source = self._choose(gain, A, B)

        u = _limited(reference.u + target.u + K @ chi, u_last, self._rate, self._allocation.limit)

        drift = xi_next + reference.residual
        self._last = _Step(A, B, xi_ref, reference.u, drift)
        self._u_last, self._u_ref_last = u, reference.u
        U = self._allocation.matrix @ u
        return TrackerOutput(
            u=u,
            steering=float(U[0]),
            wheel_forces=U[1:],
            reference=xi_ref,
            reference_u=reference.u,
            disturbance=disturbance,
            target=target.xi,
            tau=gain.tau if gain.usable else 0.0,
            status=gain.status,
            source=source,
            iterations=gain.iterations,
            solve_s=solve_s,
        )

    def _reference_state(self, reference: tuple[float, float]) -> Vector:
        v_x = max(reference[0], SLOWEST_MPS)
        gamma = reference[1]
        return np.array([v_x, self.model.steady_lateral_velocity(v_x, gamma), gamma])

    def _target(self, A: Matrix, B: Matrix, known: Vector, u_ref: Vector, u_last: Vector) -> Target:
        lower, upper = _target_range(u_last, self._rate, self._allocation.limit)
        return steady_state_target(A, B, known, u_ref, lower, upper, self._state_unit, self._allocation.limit)

    def _solve(self, linear: LinearModel, chi: Vector, u_target: Vector) -> Gain:
        limit = self._allocation.limit
        return self._controller.solve(linear, chi, _room(limit, u_target))

    def _choose(self, gain: Gain, A: Matrix, B: Matrix) -> tuple[Matrix, GainSource]:
        """Return the certified gain of this step, else the last certified gain, else the nominal LQR gain."""
        if gain.usable:
            self._gain_last = gain.K
            return gain.K, gain.source
        if self._gain_last is not None:
            return self._gain_last, GainSource.PREVIOUS_GAIN
        Q = np.diag(self._state_unit**-2.0)
        R = np.diag(self.settings.input_weight * self._input_unit**-2.0)
        return lqr_gain(A, B, Q, R), GainSource.LQR


def _limited(
    u: cython.double[::1], u_last: cython.double[::1], rate: cython.double[::1], limit: cython.double[::1]
) -> Vector:
    """The input u within a step's change (rate) of the last one, and within its limit."""
    i: cython.Py_ssize_t
    out = np.empty(u.shape[0])
    limited: cython.double[::1] = out
    for i in range(u.shape[0]):
        limited[i] = min(max(u[i], u_last[i] - rate[i]), u_last[i] + rate[i])
        limited[i] = min(max(limited[i], -limit[i]), limit[i])
    return out


def _target_range(
    u_last: cython.double[::1], rate: cython.double[::1], limit: cython.double[::1]
) -> tuple[Vector, Vector]:
    """Lower and upper bound of the target's whole input."""
    i: cython.Py_ssize_t
    largest: cython.double
    lower, upper = np.empty(limit.shape[0]), np.empty(limit.shape[0])
    low: cython.double[::1] = lower
    high: cython.double[::1] = upper
    for i in range(limit.shape[0]):
        # Part of each input's range is reserved for the feedback, whose bounds are symmetric about the target.
        largest = 0.95 * limit[i]
        low[i] = max(-largest, min(u_last[i], largest) - rate[i])
        high[i] = min(largest, max(u_last[i], -largest) + rate[i])
    return lower, upper


def _room(limit: cython.double[::1], u_target: cython.double[::1]) -> Vector:
    """Range of the feedback about the target's input; some of it is left at a limit."""
    i: cython.Py_ssize_t
    out = np.empty(limit.shape[0])
    room: cython.double[::1] = out
    for i in range(limit.shape[0]):
        room[i] = max(limit[i] - abs(u_target[i]), 0.02 * limit[i])
    return out
