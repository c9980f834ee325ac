"""The metrics of a run, computed from its log alone."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from bench.analysis.boundary import margin
from bench.analysis.motion import Array, Motion, motion, told
from bench.analysis.step_times import step_times_ms
from bench.control.outcome import GainSource, SolverStatus
from bench.cycle import CYCLE_S
from bench.record import Run
from bench.record.time_join import same_times

GAP_BAND_M = 0.5
SPEED_BAND_MPS = 0.2
LATERAL_BAND_M = 0.2
YAW_BAND_RAD = 0.01


@dataclass(frozen=True)
class Metrics:
    """The metrics of one run; lists hold one value per vehicle, `final_gaps_m` one per gap from the head.

    Attributes:
        scenario: its name.
        vehicles: number of vehicles.
        duration_s: simulated time in the log.
        complete: whether the log is undamaged and the run reached its end.
        formed: whether the platoon was formed at the end.
        formation_time_s: time from which gaps, speeds, lateral errors and yaw angles stay in their bands to the end;
            None if they are outside at the end.
        least_distance_m: minimum distance between two centres of mass; None for a single vehicle.
        final_gaps_m: distance along the road from each vehicle to the next one behind.
        final_speeds_mps: longitudinal speeds.
        final_lateral_errors_m: offset from the centre of the platoon's lane, positive to the left.
        final_yaws_rad: yaw angles.
        boundary_margin_min: minimum of 1 - |gamma| / gamma_max of the ground truth; negative is outside the boundary.
        speed_rmse_mps: RMS of ground truth minus the tracker's reference of the same cycle; None without a reference.
        yaw_rate_rmse_radps: the same for the yaw rate.
        solver_ms: time of the RMPC's solve, median and 99th percentile over all vehicles; empty if not recorded.
        tracker_ms: the same for the tracker's complete step.
        planner_ms: the same for the planner's complete step.
        fallback_steps: cycles in which a tracker ran but its gain did not come from the SDP of that cycle.
        frames_lost: number of frames dropped by receive queues.
        e2e_errors: number of frames rejected by E2E protection.
        real_time_factor: simulated time divided by wall-clock time; None if the run was cut off.
    """

    scenario: str
    vehicles: int
    duration_s: float
    complete: bool
    formed: bool
    formation_time_s: float | None
    least_distance_m: float | None
    final_gaps_m: list[float]
    final_speeds_mps: list[float]
    final_lateral_errors_m: list[float]
    final_yaws_rad: list[float]
    boundary_margin_min: float
    speed_rmse_mps: list[float | None]
    yaw_rate_rmse_radps: list[float | None]
    solver_ms: dict[str, float]
    tracker_ms: dict[str, float]
    planner_ms: dict[str, float]
    fallback_steps: int
    frames_lost: int
    e2e_errors: int
    real_time_factor: float | None

    def as_dict(self) -> dict[str, Any]:
        """Return the metrics as JSON-serialisable values."""
        return asdict(self)


def compute(run: Run) -> Metrics:
    """Return the metrics of a run.

    Raises:
        BadInput: the log has no ground truth or no scenario.
    """
    scenario = run.scenario
    goal = scenario.platoon
    truth = motion(run)
    formed_at = formation_time(truth, goal.lane_y_m, goal.speed_mps, goal.gap_m)
    distances = truth.distances()
    duration = _duration(run, truth)
    wall_s = _number(run.result.get("wall_s"))
    return Metrics(
        scenario=scenario.name,
        vehicles=run.vehicles,
        duration_s=duration,
        complete=not run.damage and duration >= scenario.duration_s - 1e-6,
        formed=formed_at is not None,
        formation_time_s=formed_at,
        least_distance_m=min((float(d.min()) for d in distances.values()), default=None),
        final_gaps_m=truth.gaps[:, -1].tolist(),
        final_speeds_mps=truth.v_x[:, -1].tolist(),
        final_lateral_errors_m=(truth.Y[:, -1] - goal.lane_y_m).tolist(),
        final_yaws_rad=truth.psi[:, -1].tolist(),
        boundary_margin_min=float(margin(truth.gamma, truth.v_x, truth.mu).min()),
        speed_rmse_mps=[_rmse(run, vehicle, truth.t, values, "VelocityX") for vehicle, values in _each(truth.v_x)],
        yaw_rate_rmse_radps=[_rmse(run, vehicle, truth.t, values, "YawRate") for vehicle, values in _each(truth.gamma)],
        solver_ms=step_times_ms(run, "TrackerTiming", "SolveTime"),
        tracker_ms=step_times_ms(run, "TrackerTiming", "StepTime"),
        planner_ms=step_times_ms(run, "PlannerTiming", "StepTime"),
        fallback_steps=fallback_steps(run),
        frames_lost=max(_last_sum(run, "FramesLost"), int(_number(run.result.get("frames_lost")) or 0)),
        e2e_errors=max(_last_sum(run, "E2EErrors"), int(_number(run.result.get("e2e_errors")) or 0)),
        real_time_factor=duration / wall_s if wall_s else None,
    )


def formation_time(truth: Motion, lane_y: float, speed: float, gap: float) -> float | None:
    """Return the time from which the platoon is formed to the end, s; None if it is not formed at the end.

    Args:
        truth: the motion.
        lane_y: centre of the platoon's lane, m.
        speed: speed of the platoon, m/s.
        gap: centre to centre, m.
    """
    good = (np.abs(truth.gaps - gap) <= GAP_BAND_M).all(axis=0)
    good &= (np.abs(truth.v_x - speed) <= SPEED_BAND_MPS).all(axis=0)
    good &= (np.abs(truth.Y - lane_y) < LATERAL_BAND_M).all(axis=0)
    good &= (np.abs(truth.psi) < YAW_BAND_RAD).all(axis=0)
    bad = np.flatnonzero(~good)
    first = int(bad[-1]) + 1 if len(bad) else 0
    return float(truth.t[first]) if first < len(truth.t) else None


def fallback_steps(run: Run) -> int:
    """Return the number of cycles, over all vehicles, in which a running tracker did not use that cycle's SDP gain."""
    total = 0
    for vehicle in range(1, run.vehicles + 1):
        bus = f"veh{vehicle}"
        if run.has(bus, "TrackerStatus"):
            status = run.message(bus, "TrackerStatus")
            ran = status["SolverStatus"] != SolverStatus.NOT_RUN
            total += int((ran & (status["GainSource"] != GainSource.SDP)).sum())
    return total


def _each(values: Array) -> list[tuple[int, Array]]:
    return list(enumerate(values, start=1))


def _rmse(run: Run, vehicle: int, t: Array, truth: Array, signal: str) -> float | None:
    """Return the RMS of ground truth minus reference over the cycles that have a reference."""
    reference = told(run, vehicle, "TrackerReferenceState")
    if reference is None:
        return None
    rows, at = same_times(reference["t"], t)
    return float(np.sqrt(np.mean((truth[at] - reference[signal][rows]) ** 2))) if len(rows) else None


def _last_sum(run: Run, signal: str) -> int:
    """Return the sum of a counter's last values over all health messages of all buses."""
    total = 0
    for bus in run.buses:
        for message in run.messages(bus):
            if message.endswith("BusHealth"):
                total += int(run.message(bus, message)[signal][-1:].sum())
    return total


def _duration(run: Run, truth: Motion) -> float:
    cycles = _number(run.result.get("cycles"))
    if cycles:
        return cycles * CYCLE_S
    return float(truth.t[-1] - truth.t[0]) + CYCLE_S


def _number(text: str | None) -> float | None:
    try:
        return float(text) if text else None
    except ValueError:
        return None
