"""The tracking level: reference input, observer, target and robust MPC in one step, (21)-(23) and (37)-(62)."""

from collections.abc import Sequence
from time import perf_counter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bench.control.allocation import VIRTUAL_INPUTS
from bench.control.lqr import lqr_gain
from bench.control.outcome import GainSource, SolverStatus
from bench.control.program import Program
from bench.control.programs import programs
from bench.control.rmpc import Gain, RobustController
from bench.control.settings import TrackerSettings
from bench.control.tracking_step import TrackingStep
from bench.control.vehicle_model import VehicleModel
from platoon_fmu.parameters import VehicleParameters

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


class TrackerOutput(NamedTuple):
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

    def __init__(
        self,
        settings: TrackerSettings,
        vehicle: VehicleParameters,
        step_s: float,
        solvers: Sequence[Program] | None = None,
    ) -> None:
        state_unit = np.array([settings.speed_unit_mps, settings.lateral_speed_unit_mps, settings.yaw_rate_unit_radps])
        input_unit = np.array([settings.steering_unit_rad, settings.force_unit_n, settings.yaw_moment_unit_nm])
        self._step = TrackingStep(settings, VehicleModel(vehicle, step_s), state_unit)
        self._controller = RobustController(
            state_unit,
            input_unit,
            settings.input_weight,
            own_programs(settings) if solvers is None else solvers,
            independent=settings.independent_axles,
        )
        self._state_cost = np.diag(state_unit**-2.0)
        self._input_cost = np.diag(settings.input_weight * input_unit**-2.0)
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
        known = self._step.prepare(xi, now, then, applied)
        start = perf_counter()
        gain = self._controller.solve(known.model, known.chi, known.room)
        solve_s = perf_counter() - start
        K, source = self._choose(gain, known.model.A, known.model.B)
        u, real = self._step.finish(K, known.chi)
        tau = gain.tau if gain.usable else 0.0
        return TrackerOutput(
            u,
            float(real[0]),
            real[1:],
            known.reference,
            known.reference_u,
            known.disturbance,
            known.target,
            tau,
            gain.status,
            source,
            gain.iterations,
            solve_s,
        )

    def _choose(self, gain: Gain, A: Matrix, B: Matrix) -> tuple[Matrix, GainSource]:
        """Return the certified gain of this step, else the last certified gain, else the nominal LQR gain."""
        if gain.usable:
            self._gain_last = gain.K
            return gain.K, gain.source
        if self._gain_last is not None:
            return self._gain_last, GainSource.PREVIOUS_GAIN
        return lqr_gain(A, B, self._state_cost, self._input_cost), GainSource.LQR
