"""The metrics of a run, computed from its log alone."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from bench.analysis.boundary import margin
from bench.analysis.clearance import abreast, clearances
from bench.analysis.comfort import Comfort, comfort
from bench.analysis.motion import Array, Motion, motion
from bench.analysis.step_times import step_times_ms
from bench.analysis.told import told
from bench.analysis.troubles import NotNumber, Warnings, has_fault, not_numbers, warnings_of
from bench.bus.network import ROLES, EcuSlot
from bench.bus.states import EcuState
from bench.control.outcome import GainSource, Limit, SolverStatus
from bench.cycle import CYCLE_S
from bench.names import vehicle_bus
from bench.record import Run
from bench.record.time_join import same_times

GAP_BAND_M = 0.5
SPEED_BAND_MPS = 0.2
LATERAL_BAND_M = 0.2
YAW_BAND_RAD = 0.01
CLEARANCE_M = 1.0
"""Clearance (m) to keep without a fault; at most the clearance at the start."""
CLEARANCE_WITH_FAULT_M = 0.3
"""Clearance (m) to keep with one."""


@dataclass(frozen=True)
class Metrics:
    """The metrics of one run; lists hold one value per vehicle, `final_gaps_m` one per gap from the head.

    What ECUs report of themselves is None if none of them sent it.

    Attributes:
        scenario: its name.
        vehicles: number of vehicles.
        duration_s: simulated time in the log.
        complete: whether the log is undamaged and the run reached its end.
        formed: whether the platoon was formed at the end.
        formation_time_s: time from which gaps, speeds, lateral errors and yaw angles stay in their bands to the end;
            None if they are outside at the end.
        least_distance_m: minimum distance between two centres of mass; None for a single vehicle.
        least_clearance_m: minimum distance between the bodies of two vehicles, negative where they overlap; None for a
            single vehicle.
        required_clearance_m: the clearance to keep: `CLEARANCE_M` or less if the vehicles start nearer, and
            `CLEARANCE_WITH_FAULT_M` with a fault.
        abreast_at_start: whether vehicles start abreast, in different lanes, so that the distance between centres of
            mass is no measure.
        final_gaps_m: distance along the road from each vehicle to the next one behind.
        final_speeds_mps: longitudinal speeds.
        final_lateral_errors_m: offset from the centre of the platoon's lane, positive to the left.
        final_yaws_rad: yaw angles.
        boundary_margin_min: minimum of 1 - |gamma| / gamma_max of the ground truth; negative is outside the boundary.
        speed_rmse_mps: RMS of ground truth minus the planner's reference for the same cycle; None if it sent none.
        yaw_rate_rmse_radps: the same for the yaw rate.
        comfort: accelerations, jerk, steering and energy, see `Comfort`; None if the ground truth lacks them.
        solver_ms: time of the RMPC's solve, median and 99th percentile over all vehicles; of the longest solves in as
            many ms as the third item says, which is the DBC's cycle time of the message.
        tracker_ms: the same for the tracker's complete step.
        planner_ms: the same for the planner's complete step.
        clearance_steps: cycles, over all vehicles, in which the distance to a vehicle ahead decided a reference; None
            if no planner has reported.
        hard_braking_steps: those of them in which it braked harder than is comfortable.
        uncomfortable_steps: cycles, over all vehicles, in which a planner measured an acceleration or a jerk above the
            limits of comfort for another reason; None if not recorded.
        riccati_steps: cycles, over all vehicles, whose feedback gain came from the Riccati equation; None if no tracker
            reported a solve.
        sdp_steps: the same for the semidefinite program, which is solved where the Riccati equation has no answer.
        fallback_steps: cycles in which a tracker ran but its gain is not the certified one of that cycle.
        frames_lost: number of frames dropped by receive queues; None if none is known of, but an ECU did not report.
        e2e_errors: number of frames rejected by E2E protection; None likewise.
        warnings: the warnings and errors among the events, without the faults that were asked for.
        not_numbers: commands of ECUs that were not numbers; their messages were not sent.
        real_time_factor: simulated time divided by wall-clock time; None if the run was cut off.
    """

    scenario: str
    vehicles: int
    duration_s: float
    complete: bool
    formed: bool
    formation_time_s: float | None
    least_distance_m: float | None
    least_clearance_m: float | None
    required_clearance_m: float | None
    abreast_at_start: bool
    final_gaps_m: list[float]
    final_speeds_mps: list[float]
    final_lateral_errors_m: list[float]
    final_yaws_rad: list[float]
    boundary_margin_min: float
    speed_rmse_mps: list[float | None]
    yaw_rate_rmse_radps: list[float | None]
    comfort: Comfort | None
    solver_ms: dict[str, float] | None
    tracker_ms: dict[str, float] | None
    planner_ms: dict[str, float] | None
    clearance_steps: int | None
    hard_braking_steps: int | None
    uncomfortable_steps: int | None
    riccati_steps: int | None
    sdp_steps: int | None
    fallback_steps: int | None
    frames_lost: int | None
    e2e_errors: int | None
    warnings: Warnings
    not_numbers: list[NotNumber]
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
    apart = list(clearances(truth).values())
    duration = _duration(run, truth)
    sources = gain_sources(run)
    limits = _limits(run)
    wall_s = _number(run.result.get("wall_s"))
    return Metrics(
        scenario=scenario.name,
        vehicles=run.vehicles,
        duration_s=duration,
        complete=not run.damage and duration >= scenario.duration_s - 1e-6,
        formed=formed_at is not None,
        formation_time_s=formed_at,
        least_distance_m=min((float(d.min()) for d in distances.values()), default=None),
        least_clearance_m=min((float(each.min()) for each in apart), default=None),
        required_clearance_m=_required_clearance([float(each[0]) for each in apart], has_fault(run.events)),
        abreast_at_start=abreast(truth.X[:, 0]),
        final_gaps_m=truth.gaps[:, -1].tolist(),
        final_speeds_mps=truth.v_x[:, -1].tolist(),
        final_lateral_errors_m=(truth.Y[:, -1] - goal.lane_y_m).tolist(),
        final_yaws_rad=truth.psi[:, -1].tolist(),
        boundary_margin_min=float(margin(truth.gamma, truth.v_x, truth.mu).min()),
        speed_rmse_mps=[_rmse(run, vehicle, truth.t, values, "VelocityX") for vehicle, values in _each(truth.v_x)],
        yaw_rate_rmse_radps=[_rmse(run, vehicle, truth.t, values, "YawRate") for vehicle, values in _each(truth.gamma)],
        comfort=comfort(run),
        solver_ms=step_times_ms(run, "TrackerTiming", "SolveTime") or None,
        tracker_ms=step_times_ms(run, "TrackerTiming", "StepTime") or None,
        planner_ms=step_times_ms(run, "PlannerTiming", "StepTime") or None,
        clearance_steps=None if limits is None else limits[Limit.CLEARANCE] + limits[Limit.HARD_BRAKING],
        hard_braking_steps=None if limits is None else limits[Limit.HARD_BRAKING],
        uncomfortable_steps=None if limits is None else limits[Limit.COMFORT],
        riccati_steps=None if sources is None else sources[GainSource.RICCATI],
        sdp_steps=None if sources is None else sources[GainSource.SDP],
        fallback_steps=None
        if sources is None
        else sources.total() - sources[GainSource.RICCATI] - sources[GainSource.SDP],
        frames_lost=_reported(run, "FramesLost", "frames_lost"),
        e2e_errors=_reported(run, "E2EErrors", "e2e_errors"),
        warnings=warnings_of(run.events),
        not_numbers=not_numbers(run.events),
        real_time_factor=duration / wall_s if wall_s else None,
    )


def _required_clearance(at_start: list[float], with_fault: bool) -> float | None:
    """Return the clearance to keep, m, from that of all pairs at the start; None for a single vehicle."""
    least = CLEARANCE_WITH_FAULT_M if with_fault else CLEARANCE_M
    return min([least, *at_start]) if at_start else None


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


def _limits(run: Run) -> Counter[int] | None:
    """Return the number of cycles in which each `Limit` decided, over all planners; None if none has reported."""
    reported = [v for v in range(1, run.vehicles + 1) if run.has(vehicle_bus(v), "PlannerStatus")]
    found: Counter[int] = Counter()
    for vehicle in reported:
        found.update(run.message(vehicle_bus(vehicle), "PlannerStatus")["Limit"].astype(int).tolist())
    return found if reported else None


def gain_sources(run: Run) -> Counter[int] | None:
    """Return the number of cycles in which a running tracker's gain came from each `GainSource`, over all vehicles.

    None if no tracker has reported how a solve ended, though at least one has left its initial state.
    """
    found: Counter[int] = Counter()
    begun = False
    for vehicle in range(1, run.vehicles + 1):
        bus = f"veh{vehicle}"
        if run.has(bus, "TrackerStatus"):
            status = run.message(bus, "TrackerStatus")
            ran = status["SolverStatus"] != SolverStatus.NOT_RUN
            found.update(status["GainSource"][ran].astype(int).tolist())
            begun |= bool((status["State"] != EcuState.INIT).any())
    return found if found or not begun else None


def _each(values: Array) -> list[tuple[int, Array]]:
    return list(enumerate(values, start=1))


def _rmse(run: Run, vehicle: int, t: Array, truth: Array, signal: str) -> float | None:
    """Return the RMS of ground truth minus reference over the cycles that have a reference."""
    sent = told(run, vehicle, "Reference", signal)
    if sent is None:
        return None
    times, reference = sent
    rows, at = same_times(times, t)
    return float(np.sqrt(np.mean((truth[at] - reference[rows]) ** 2))) if len(rows) else None


def _reported(run: Run, signal: str, result: str) -> int | None:
    """Return the sum of a counter's last values over all health messages, or the run's own result if that is more.

    None if that is 0, but an ECU never sent its health message.
    """
    sent = [(bus, message) for bus in run.buses for message in run.messages(bus) if message.endswith("BusHealth")]
    known = sum(int(run.message(bus, message)[signal][-1:].sum()) for bus, message in sent)
    total = max(known, int(_number(run.result.get(result)) or 0))
    slots = [EcuSlot(role, vehicle) for role in ROLES for vehicle in range(1, run.vehicles + 1)]
    silent = any((vehicle_bus(slot.vehicle), slot.message("BusHealth")) not in sent for slot in slots)
    return None if silent and not total else total


def _duration(run: Run, truth: Motion) -> float:
    cycles = _number(run.result.get("cycles"))
    if cycles:
        return cycles * CYCLE_S
    return float(truth.t[-1] - truth.t[0]) + CYCLE_S


def _number(text: str | None) -> float | None:
    try:
        number = float(text) if text else None
    except ValueError:
        return None
    return number if number is not None and math.isfinite(number) else None
