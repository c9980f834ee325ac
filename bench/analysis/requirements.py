"""The requirements on a run next to its metrics, as a table for people."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

from bench.analysis.comfort import REVERSAL_GAP_RAD, Comfort
from bench.analysis.metrics import Metrics
from bench.analysis.step_times import NOT_SENT, median_and_p99
from bench.scenario import Scenario

LEAST_DISTANCE_M = 4.0
ROUNDING_M = 1e-3
"""A clearance that is smaller than the required one by less than this (m) is the required one, rounded."""
FINAL_GAP_M = 0.2
FINAL_SPEED_MPS = 0.1
FINAL_LATERAL_M = 0.15
FINAL_YAW_RAD = 0.01
FORMATION_TIME_S = 6.5
TIMED = ("formation", "formation-soft", "formation-stiff")
"""The shipped scenarios that must form within `FORMATION_TIME_S`; others must form by the end of the run."""
TRACKER_MS = (5.0, 10.0)
PLANNER_MS = 3.0


class Group(StrEnum):
    """What a metric is of; only those of the run are a verdict on it."""

    RUN = "run"
    COMFORT = "comfort"
    """Shown against the limits of comfort; to exceed them is no failure."""
    MACHINE = "machine"
    """Depends on the machine more than on the run."""


@dataclass(frozen=True)
class Row:
    """One metric.

    Attributes:
        name: name of the metric.
        value: as text.
        requirement: as text, of comfort the limit; empty for none.
        met: whether the requirement is met; None without one, and for a value that was not sent.
        group: the groups are shown apart.
    """

    name: str
    value: str
    requirement: str = ""
    met: bool | None = None
    group: Group = Group.RUN


def table(metrics: Metrics, scenario: Scenario) -> list[Row]:
    """Return the metrics of a run with their requirements, group by group."""
    goal = scenario.platoon
    formed = metrics.formation_time_s
    limit = FORMATION_TIME_S if scenario.name in TIMED else None
    rows = [
        Row(
            "Formation time",
            "not formed" if formed is None else f"{formed:.2f} s",
            f"at most {limit:g} s" if limit else "by the end",
            formed is not None and (limit is None or formed <= limit),
        ),
        _least_distance(metrics),
        _least_clearance(metrics),
        _near("Final gaps", metrics.final_gaps_m, goal.gap_m, FINAL_GAP_M, "m", 3),
        _near("Final speeds", metrics.final_speeds_mps, goal.speed_mps, FINAL_SPEED_MPS, "m/s", 3),
        _below("Final lateral errors", metrics.final_lateral_errors_m, FINAL_LATERAL_M, "m", 3),
        _below("Final yaw angles", metrics.final_yaws_rad, FINAL_YAW_RAD, "rad", 4),
        Row(
            "Least margin to the stability boundary",
            f"{metrics.boundary_margin_min:.3f}",
            "above 0",
            metrics.boundary_margin_min > 0,
        ),
        Row("Speed error, RMS", _list(metrics.speed_rmse_mps, 4, "m/s")),
        Row("Yaw rate error, RMS", _list(metrics.yaw_rate_rmse_radps, 5, "rad/s")),
        Row("Steps limited by the clearance", count_text(metrics.clearance_steps)),
        Row("Steps with hard braking", count_text(metrics.hard_braking_steps)),
        Row("Steps otherwise uncomfortable", count_text(metrics.uncomfortable_steps)),
        Row("Steps solved by the Riccati equation", count_text(metrics.riccati_steps)),
        Row("Steps solved by the SDP", count_text(metrics.sdp_steps)),
        Row("Steps with a fallback gain", count_text(metrics.fallback_steps)),
        _none("Frames lost", metrics.frames_lost),
        _none("E2E errors", metrics.e2e_errors),
        _numbers(metrics, scenario),
        Row("Warnings", str(metrics.warnings) if metrics.warnings.count else "0"),
        *(_comfort(metrics.comfort) if metrics.comfort else ()),
        Row("Solver, median / p99", median_and_p99(metrics.solver_ms), group=Group.MACHINE),
        _times("Tracker step, median / p99", metrics.tracker_ms, *TRACKER_MS),
        _times("Planner step, median / p99", metrics.planner_ms, PLANNER_MS, None),
    ]
    if metrics.real_time_factor is not None:
        rows.append(Row("Real-time factor", f"{metrics.real_time_factor:.2f}", group=Group.MACHINE))
    return [row for row in rows if row.value]


def count_text(count: int | None) -> str:
    """Return a number as text; None is one that no ECU has sent."""
    return NOT_SENT if count is None else str(count)


def _none(name: str, count: int | None) -> Row:
    return Row(name, count_text(count), "0", None if count is None else count == 0)


def _numbers(metrics: Metrics, scenario: Scenario) -> Row:
    """Return the row of the commands that are not numbers, which the scenario may allow."""
    found = metrics.not_numbers
    more = f" and {len(found) - 1} more" if len(found) > 1 else ""
    name, value = "Commands that are not numbers", f"{found[0]}{more}" if found else "0"
    if scenario.on_not_a_number == "allow":
        return Row(name, value, "allowed")
    return Row(name, value, "0", not found)


def _least_distance(metrics: Metrics) -> Row:
    least = metrics.least_distance_m
    if least is None:
        return Row("Least distance", "")
    if metrics.abreast_at_start:
        return Row("Least distance", f"{least:.2f} m")
    return Row("Least distance", f"{least:.2f} m", f"above {LEAST_DISTANCE_M:g} m", keeps_distance(metrics))


def _least_clearance(metrics: Metrics) -> Row:
    least, required = metrics.least_clearance_m, metrics.required_clearance_m
    if least is None or required is None:
        return Row("Least clearance", "")
    return Row("Least clearance", f"{least:.2f} m", f"at least {required:.2f} m", keeps_clear(metrics))


def keeps_clear(metrics: Metrics) -> bool:
    """Return whether the vehicles kept the clearance that is required."""
    least, required = metrics.least_clearance_m, metrics.required_clearance_m
    return least is None or required is None or least >= required - ROUNDING_M


def keeps_distance(metrics: Metrics) -> bool:
    """Return whether the vehicles kept the distance between centres that is required unless they start abreast."""
    least = metrics.least_distance_m
    return least is None or metrics.abreast_at_start or least > LEAST_DISTANCE_M


def _comfort(comfort: Comfort) -> list[Row]:
    limits, group = comfort.limits.get, Group.COMFORT
    acceleration, jerk = "m/s²", "m/s³"
    gap = f"{1e3 * REVERSAL_GAP_RAD:g} mrad"
    return [
        _within("Lateral acceleration, largest", comfort.lateral_acceleration_max_mps2, limits("a_y"), acceleration),
        _within("Lateral jerk, largest 0.5 s mean", comfort.lateral_jerk_max_mps3, limits("jerk_y"), jerk),
        _within("Acceleration, largest", comfort.acceleration_max_mps2, limits("a_x"), acceleration),
        _within("Braking, largest", comfort.braking_max_mps2, limits("a_x"), acceleration),
        _within("Longitudinal jerk, largest 0.5 s mean", comfort.longitudinal_jerk_max_mps3, limits("jerk_x"), jerk),
        Row("Weighted acceleration x, RMS", _known(comfort.weighted_rms_x_mps2, 3, acceleration), group=group),
        Row("Weighted acceleration y, RMS", _known(comfort.weighted_rms_y_mps2, 3, acceleration), group=group),
        Row("Weighted acceleration, vector sum", _known(comfort.weighted_rms_mps2, 3, acceleration), group=group),
        Row(f"Steering reversals over {gap}", ", ".join(map(str, comfort.steering_reversals)), group=group),
        Row("Steering rate, RMS", _known(comfort.steering_rate_rms_radps, 4, "rad/s"), group=group),
        Row("Energy driven at the wheels", _kilojoules(comfort.driven_energy_j), group=group),
        Row("Energy braked at the wheels", _kilojoules(comfort.braked_energy_j), group=group),
    ]


def _within(name: str, values: Sequence[float | None], limit: float | None, unit: str) -> Row:
    """Return the row of what has a limit of comfort, which is None where the run has none."""
    if limit is None:
        return Row(name, _known(values, 2, unit), group=Group.COMFORT)
    known = [value for value in values if value is not None]
    met = all(value <= limit for value in known) if known else None
    return Row(name, _known(values, 2, unit), f"at most {limit:g}\u00a0{unit}", met, Group.COMFORT)


def _kilojoules(values: Sequence[float | None]) -> str:
    return _known([None if value is None else 1e-3 * value for value in values], 1, "kJ")


def _known(values: Sequence[float | None], digits: int, unit: str) -> str:
    """Return values of the ground truth as text; empty if there is none."""
    return _list(values, digits, unit, "–") if any(value is not None for value in values) else ""


def _near(name: str, values: Sequence[float], goal: float, band: float, unit: str, digits: int) -> Row:
    met = all(abs(value - goal) <= band for value in values)
    return Row(name, _list(values, digits, unit), f"{goal:g}\u00a0±\u00a0{band:g}\u00a0{unit}", met)


def _below(name: str, values: Sequence[float], limit: float, unit: str, digits: int) -> Row:
    return Row(
        name, _list(values, digits, unit), f"within ±\u00a0{limit:g}\u00a0{unit}", all(abs(v) < limit for v in values)
    )


def _times(name: str, values: dict[str, float] | None, median: float, p99: float | None) -> Row:
    met = None if values is None else values["p50"] <= median and (p99 is None or values["p99"] <= p99)
    asked = f"at most {median:g}" + (f" / {p99:g} ms" if p99 is not None else " ms median")
    return Row(name, median_and_p99(values), asked, met, Group.MACHINE)


def _list(values: Sequence[float | None], digits: int, unit: str, missing: str = NOT_SENT) -> str:
    # A value that rounds to zero is shown without a sign.
    if values and all(value is None for value in values):
        return missing
    texts = [missing if value is None else f"{round(value, digits) + 0.0:.{digits}f}" for value in values]
    return f"{', '.join(texts)}\u00a0{unit}" if texts else ""
