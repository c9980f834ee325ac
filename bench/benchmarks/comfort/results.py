"""The result of a run: what it is judged by, as a small file, so that a long benchmark can be stopped and continued."""

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path

import numpy as np

from bench.analysis.comfort import Comfort
from bench.analysis.metrics import compute
from bench.analysis.requirements import keeps_clear
from bench.benchmarks.comfort.limits import GIVES_WAY, LIMITS, NAMES, UNITS, WORDS
from bench.control.comfort import ComfortLimits
from bench.control.outcome import Limit
from bench.names import vehicle_bus
from bench.record import Run

FORMED_WITHIN_S = 20.0


@dataclass(frozen=True)
class Result:
    """What a run is judged by; of all vehicles the worst.

    Attributes:
        scenario: name of the scenario.
        vehicles: their number.
        description: of the scenario.
        failure: why the run ended early; empty if it did not, and all else means nothing if it did.
        formed_s: when the platoon was formed, s; None if it was not.
        clearance_m: least distance between bodies, m.
        clear: whether that is at least 1 m, or the clearance at the start.
        distance_m: least distance between centres of mass, m.
        margin: least margin to the stability boundary; negative is outside.
        comfort: the largest of what is limited, by name of the limit.
        reversals: reversals of the steering angle.
        weighted_rms_mps2: RMS of the acceleration, weighted as in ISO 2631-1, m/s^2.
        speed_rmse_mps: RMS of the speed's deviation from its reference, m/s.
        yaw_rate_rmse_radps: the same for the yaw rate, rad/s.
        fallback_steps: cycles in which a tracker had no certified gain.
        limits: number of cycles of all planners with each value of `Limit`, by name.
        events: number of events of each kind.
    """

    scenario: str
    vehicles: int
    description: str
    failure: str = ""
    formed_s: float | None = None
    clearance_m: float = 0.0
    clear: bool = False
    distance_m: float = 0.0
    margin: float = 0.0
    comfort: Mapping[str, float] | None = None
    reversals: int = 0
    weighted_rms_mps2: float = 0.0
    speed_rmse_mps: float = 0.0
    yaw_rate_rmse_radps: float = 0.0
    fallback_steps: int = 0
    limits: Mapping[str, int] | None = None
    events: Mapping[str, int] | None = None

    @property
    def in_time(self) -> bool:
        """Whether the platoon was formed within 20 s."""
        return self.formed_s is not None and self.formed_s <= FORMED_WITHIN_S

    @property
    def inside(self) -> bool:
        """Whether all vehicles stayed inside the stability boundary."""
        return self.margin > 0.0

    @property
    def exceeded(self) -> list[str]:
        """The names of the limits of comfort that were exceeded."""
        return [name for name in NAMES if (self.comfort or {}).get(name, 0.0) > LIMITS[name]]

    @property
    def told(self) -> bool:
        """Whether a planner said that comfort gives way."""
        return any((self.limits or {}).get(name) for name in GIVES_WAY)

    @property
    def problems(self) -> list[str]:
        """What is wrong with the run, in words; empty if nothing is."""
        if self.failure:
            return [f"ended early: {self.failure}"]
        found = [] if self.clear else [f"clearance {self.clearance_m:.2f} m"]
        if not self.inside:
            found.append(f"outside the stability boundary, margin {self.margin:.2f}")
        if self.formed_s is None:
            found.append("not formed")
        elif not self.in_time:
            found.append(f"formed after {self.formed_s:.1f} s")
        if self.exceeded and not self.told:
            found.append(f"{self.discomfort}, and no planner said so")
        return found

    @property
    def discomfort(self) -> str:
        """Which limits of comfort were exceeded, and how far, in words."""
        values = self.comfort or {}
        return ", ".join(f"{WORDS[name]} {values[name]:.2f} {UNITS[name]}" for name in self.exceeded)


def result_of(run: Run) -> Result:
    """Return the result of a run that was completed."""
    metrics = compute(run)
    felt = metrics.comfort
    if felt is None:
        raise ValueError(f"{run.path} has no accelerations")
    scenario = run.scenario
    return Result(
        scenario=scenario.name,
        vehicles=run.vehicles,
        description=scenario.description,
        formed_s=metrics.formation_time_s,
        clearance_m=_or_infinity(metrics.least_clearance_m),
        clear=keeps_clear(metrics),
        distance_m=_or_infinity(metrics.least_distance_m),
        margin=metrics.boundary_margin_min,
        comfort=_largest(felt),
        reversals=max(felt.steering_reversals),
        weighted_rms_mps2=_most(felt.weighted_rms_mps2),
        speed_rmse_mps=_most(metrics.speed_rmse_mps),
        yaw_rate_rmse_radps=_most(metrics.yaw_rate_rmse_radps),
        fallback_steps=metrics.fallback_steps or 0,
        limits=_limits(run),
        events=dict(sorted(Counter(event.kind for event in run.events).items())),
    )


def _largest(felt: Comfort) -> dict[str, float]:
    """Return the largest value of what is limited, by the name of its limit."""
    values = ComfortLimits(
        lateral_acceleration_mps2=_most(felt.lateral_acceleration_max_mps2),
        lateral_jerk_mps3=_most(felt.lateral_jerk_max_mps3),
        longitudinal_acceleration_mps2=_most([*felt.acceleration_max_mps2, *felt.braking_max_mps2]),
        longitudinal_jerk_mps3=_most(felt.longitudinal_jerk_max_mps3),
    )
    return {name: getattr(values, name) for name in NAMES}


def _most(values: Sequence[float | None]) -> float:
    return max(0.0 if value is None else value for value in values)


def _or_infinity(value: float | None) -> float:
    """Return a distance; infinity where there is none, since there is one vehicle only."""
    return float("inf") if value is None else value


def _limits(run: Run) -> dict[str, int]:
    """Return the number of cycles of all planners in which each boundary limited the reference, by its name."""
    found: Counter[str] = Counter()
    for vehicle in range(1, run.vehicles + 1):
        values, counts = np.unique(run.message(vehicle_bus(vehicle), "PlannerStatus")["Limit"], return_counts=True)
        found.update({Limit(int(value)).name: int(count) for value, count in zip(values, counts, strict=True)})
    return dict(found)


def write(result: Result, path: Path) -> None:
    """Write a result to a file, which is there as a whole or not at all."""
    aside = path.with_suffix(".part")
    aside.write_text(json.dumps(asdict(result), indent=1), encoding="utf-8")
    aside.replace(path)


def read(path: Path) -> Result:
    """Return the result in a file."""
    document = json.loads(path.read_text(encoding="utf-8"))
    return Result(**{field.name: document[field.name] for field in fields(Result)})
