"""Requirements on a run as limits of its metrics, and the metrics as numbers with one name each."""

from __future__ import annotations

import dataclasses
import math
import operator
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import get_type_hints

from bench.analysis.comfort import Comfort
from bench.analysis.metrics import Metrics
from bench.analysis.requirements import (
    FINAL_GAP_M,
    FINAL_LATERAL_M,
    FINAL_SPEED_MPS,
    FINAL_YAW_RAD,
    FORMATION_TIME_S,
    LEAST_DISTANCE_M,
    ROUNDING_M,
    TIMED,
)
from bench.errors import BadInput
from bench.scenario import Scenario
from bench.scenario.errors import closest

Metric = float | int | bool | None

_COMPARISONS: dict[str, Callable[[float, float], bool]] = {
    ">=": operator.ge,
    "<=": operator.le,
    "==": operator.eq,
    "!=": operator.ne,
    ">": operator.gt,
    "<": operator.lt,
}
_FORM = re.compile(r"\s*([A-Za-z_]\w*)\s*(>=|<=|==|!=|>|<)\s*(\S+)\s*")
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
_TRUTH = {"true": 1.0, "false": 0.0}

_NOT_FLAT = frozenset({"scenario", "comfort", "real_time_factor", "solver_ms", "tracker_ms", "planner_ms"})
"""Fields of `Metrics` left out: text, what `comfort_` names have, and what the machine decides and not the run."""
_COMFORT_NAMES = tuple(f"comfort_{field.name}" for field in dataclasses.fields(Comfort) if field.name != "limits")
_ADDED = ("least_distance_in_line_m", "clearance_margin_m", "final_gap_error_m", "final_speed_error_mps")

METRIC_NAMES = (
    *(field.name for field in dataclasses.fields(Metrics) if field.name not in _NOT_FLAT),
    *_ADDED,
    *_COMFORT_NAMES,
)
"""Every name that `flat_metrics` returns and a requirement may use."""


def metric_type(name: str) -> type[float] | type[int] | type[bool]:
    """Return the type of a metric that has a value."""
    owner = Comfort if name.startswith("comfort_") else Metrics
    hint = str(get_type_hints(owner).get(name.removeprefix("comfort_"), "float"))
    if name in ("warnings", "not_numbers"):
        return int
    return bool if "bool" in hint else int if "int" in hint else float


@dataclass(frozen=True)
class Requirement:
    """A limit of a metric.

    Attributes:
        metric: one of `METRIC_NAMES`.
        comparison: >, >=, <, <=, == or !=.
        limit: what the metric is compared to; true is 1 and false is 0.
    """

    metric: str
    comparison: str
    limit: float

    @property
    def text(self) -> str:
        """The requirement as a study writes it; the same text for the same requirement."""
        return f"{self.metric} {self.comparison} {self.limit:.15g}"

    @property
    def has_margin(self) -> bool:
        """Whether it limits its metric from one side; an equality has no margin."""
        return self.comparison not in ("==", "!=")

    def met(self, metrics: Mapping[str, Metric]) -> bool | None:
        """Return whether a run with these metrics meets it; None if its metric has no value.

        A platoon that has not formed at the end has no formation time, and no limit of that time is met.
        """
        value = metrics.get(self.metric)
        if value is None:
            return False if self.metric == "formation_time_s" and metrics.get("formed") is False else None
        # Not even != is met by what is not a number.
        return not math.isnan(value) and _COMPARISONS[self.comparison](float(value), self.limit)

    def margin(self, metrics: Mapping[str, Metric]) -> float | None:
        """Return by how much a run with these metrics stays on the right side of the limit; negative is beyond it.

        A missed limit without a number is infinitely far beyond it. An equality has no margin, nor has a run of which
        it is not known whether it meets the limit.
        """
        if not self.has_margin or self.met(metrics) is None:
            return None
        value = metrics.get(self.metric)
        if value is None or math.isnan(value):
            return -math.inf
        return (float(value) - self.limit) * (1.0 if self.comparison[0] == ">" else -1.0)


def requirement(text: str) -> Requirement:
    """Return the requirement that a text states, such as `least_clearance_m > 1.0` or `formed == true`.

    Raises:
        BadInput: not METRIC COMPARISON NUMBER, or an unknown metric.
    """
    form = _FORM.fullmatch(text)
    if not form:
        raise BadInput(f'requirement "{text}" cannot be read; {_how_to_write()}')
    metric, comparison, limit = form.groups()
    if metric not in METRIC_NAMES:
        near = closest(metric, METRIC_NAMES)
        meant = f"did you mean {near}? " if near else ""
        raise BadInput(
            f'requirement "{text}": {metric} is not a metric; {meant}allowed: {", ".join(sorted(METRIC_NAMES))}'
        )
    number = _TRUTH.get(limit)
    if number is None and _NUMBER.fullmatch(limit):
        number = float(limit)
    if number is None or not math.isfinite(number):
        raise BadInput(f'requirement "{text}": {limit} is not a finite number; {_how_to_write()}')
    return Requirement(metric, comparison, number + 0.0)


def default_requirements(scenario: Scenario | None = None) -> tuple[Requirement, ...]:
    """Return the requirements of a run's report on the run itself, for studies that state none.

    Args:
        scenario: the base scenario: some shipped ones must form within a time, others by the end of the run, and one
            may allow commands that are not numbers.
    """
    timed = scenario is not None and scenario.name in TIMED
    allows = scenario is not None and scenario.on_not_a_number == "allow"
    return (
        Requirement("formation_time_s", "<=", FORMATION_TIME_S) if timed else Requirement("formed", "==", 1.0),
        Requirement("least_distance_in_line_m", ">", LEAST_DISTANCE_M),
        Requirement("clearance_margin_m", ">=", -ROUNDING_M),
        Requirement("final_gap_error_m", "<=", FINAL_GAP_M),
        Requirement("final_speed_error_mps", "<=", FINAL_SPEED_MPS),
        Requirement("final_lateral_errors_m", "<", FINAL_LATERAL_M),
        Requirement("final_yaws_rad", "<", FINAL_YAW_RAD),
        Requirement("boundary_margin_min", ">", 0.0),
        Requirement("frames_lost", "==", 0.0),
        Requirement("e2e_errors", "==", 0.0),
        *(() if allows else (Requirement("not_numbers", "==", 0.0),)),
    )


def flat_metrics(metrics: Metrics, scenario: Scenario) -> dict[str, Metric]:
    """Return the metrics of a run as one number each, by the names in `METRIC_NAMES`, in the same order.

    Numbers keep their name in `Metrics`. Of lists with one value per vehicle there is the worst, None if all are
    missing: of `final_gaps_m` and `final_speeds_mps` the value furthest from the platoon's; of lateral errors and yaw
    angles the largest magnitude; of all others the largest. `warnings` and `not_numbers` are counts, and comfort's
    names begin with `comfort_`. Added are:

    - `least_distance_in_line_m`: `least_distance_m`; None if vehicles start abreast, so that it is no measure.
    - `clearance_margin_m`: `least_clearance_m` minus `required_clearance_m`.
    - `final_gap_error_m`, `final_speed_error_mps`: the largest deviation from the platoon's gap and speed.

    Times of computation are left out: they differ from one time to the next.

    Args:
        metrics: of the run.
        scenario: of the run.
    """
    goal = scenario.platoon
    least, required = metrics.least_clearance_m, metrics.required_clearance_m
    gaps, speeds = metrics.final_gaps_m, metrics.final_speeds_mps
    special: dict[str, Metric] = {
        "final_gaps_m": _furthest(gaps, goal.gap_m),
        "final_speeds_mps": _furthest(speeds, goal.speed_mps),
        "final_lateral_errors_m": _largest(map(abs, metrics.final_lateral_errors_m)),
        "final_yaws_rad": _largest(map(abs, metrics.final_yaws_rad)),
        "warnings": metrics.warnings.count,
        "not_numbers": len(metrics.not_numbers),
        "least_distance_in_line_m": None if metrics.abreast_at_start else metrics.least_distance_m,
        "clearance_margin_m": None if least is None or required is None else least - required,
        "final_gap_error_m": _largest(abs(gap - goal.gap_m) for gap in gaps),
        "final_speed_error_mps": _largest(abs(speed - goal.speed_mps) for speed in speeds),
    }
    return {name: special[name] if name in special else _plain(metrics, name) for name in METRIC_NAMES}


def _plain(metrics: Metrics, name: str) -> Metric:
    """Return a metric that has no rule of its own."""
    of_comfort = name.startswith("comfort_")
    owner = metrics.comfort if of_comfort else metrics
    value = None if owner is None else getattr(owner, name.removeprefix("comfort_") if of_comfort else name)
    if isinstance(value, list):
        return _largest(value)
    number: Metric = value
    return number


def _largest(values: Iterable[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    # A value that is not a number is worse than any.
    return next((value for value in known if math.isnan(value)), max(known, default=None))


def _furthest(values: Iterable[float], goal: float) -> float | None:
    return max(values, key=lambda value: math.inf if math.isnan(value) else abs(value - goal), default=None)


def _how_to_write() -> str:
    return 'write METRIC COMPARISON NUMBER, e.g. "least_clearance_m > 1.0"; comparisons are >, >=, <, <=, ==, !='
