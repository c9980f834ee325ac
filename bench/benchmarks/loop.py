"""The closed loop's metrics: times, the result of each shipped scenario, and the remaining offset in crosswind.

Times are measured with real processes over `udp`, first as fast as possible, then in real time; results that do not
depend on time are the same on every bus and come from `direct`.
"""

import math
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from rich.table import Table

from bench.analysis.metrics import Metrics, compute
from bench.analysis.step_times import median_and_p99, step_times_ms
from bench.analysis.timing import timing as keeping
from bench.bus.link.address import Address
from bench.conductor.options import RunOptions
from bench.conductor.run import run
from bench.record.reader import Run
from bench.scenario import load, shipped

LAMBDAS = (-1.0, 0.0, 1.0)
"""Uncertainties of the cornering stiffness, both axles, at which the tracker must be offset-free."""

LAST_S = 2.0
"""The offset is the mean tracking error over this final part of a run (s)."""

REALTIME_S = 60
"""Duration of the real-time run (s)."""

TIMED_RUNS = 3
"""Number of timed runs, since the machine's other work disturbs some more than others."""


def tables() -> Iterator[Table]:
    """Yield each table as soon as its scenarios have run."""
    with tempfile.TemporaryDirectory(prefix="platoon-bench-") as folder:
        logs = Path(folder)
        yield timing([record(logs, "formation", bus="udp") for _ in range(TIMED_RUNS)])
        yield deadlines(record(logs, "formation", [f"duration_s={REALTIME_S}"], bus="udp", realtime=True))
        yield figures([record(logs, name) for name in shipped()])
        yield offsets(logs)


def record(
    logs: Path, scenario: str, overrides: Sequence[str] = (), bus: str = "direct", *, realtime: bool = False
) -> Run:
    """Run a scenario; return its log."""
    log = logs / f"{len(list(logs.iterdir()))}.mcap"
    run(
        RunOptions(
            load(scenario, overrides),
            address=Address.parse(bus),
            out=log,
            command_line=["bench.benchmarks", scenario, *overrides],
            realtime=realtime,
        )
    )
    return Run(log)


def timing(runs: Sequence[Run]) -> Table:
    """Return the table of wall-clock metrics, a column for each run."""
    table = Table(title="formation over udp: wall-clock times", title_justify="left")
    table.add_column("median / p99")
    table.add_column("target", justify="right")
    for number in range(1, len(runs) + 1):
        table.add_column(f"run {number}", justify="right")
    for title, wanted, message, signal in (
        ("tracker's whole step", "5 / 10 ms", "TrackerTiming", "StepTime"),
        ("  of which solver", "", "TrackerTiming", "SolveTime"),
        ("planner's whole step", "3 / 3 ms", "PlannerTiming", "StepTime"),
        ("  of which optimisation, if any", "", "PlannerTiming", "OptimisationTime"),
        ("plant's step, one vehicle", "", "PlantTiming", "StepTime"),
    ):
        table.add_row(title, wanted, *(_percentiles(recorded, message, signal) for recorded in runs))
    factors = (compute(recorded).real_time_factor for recorded in runs)
    table.add_row("real-time factor", "at least 1", *("-" if f is None else f"{f:.2f}" for f in factors))
    return table


def _percentiles(recorded: Run, message: str, signal: str) -> str:
    return median_and_p99(step_times_ms(recorded, message, signal))


def deadlines(recorded: Run) -> Table:
    """Return the table of response times and missed deadlines of a real-time run, a row for each node."""
    times = keeping(recorded)
    if times is None:
        raise ValueError("only a real-time run has deadlines")
    share = f"{100 * times.miss_rate:.3f} % of the ECUs' deadlines missed (target: below 0.1 %)"
    table = Table(title=f"formation over udp in real time, {REALTIME_S} s: {share}", title_justify="left")
    table.add_column("node")
    for heading in ("response p50 / p99 / largest", "jitter", "missed"):
        table.add_column(heading, justify="right")
    for node in times.nodes:
        response = " / ".join(f"{node.response(p) or math.nan:.2f}" for p in (50.0, 99.0, 100.0))
        table.add_row(node.name, f"{response} ms", f"{node.jitter_ms:.2f} ms", f"{node.misses} of {node.cycles}")
    return table


def figures(runs: Sequence[Run]) -> Table:
    """Return the table of results, a row for each scenario."""
    table = Table(title="shipped scenarios: at the end, the worst vehicle", title_justify="left")
    table.add_column("scenario")
    for heading in (
        "formed\ns",
        "least\ndistance m",
        "gap error\nm",
        "speed error\nm/s",
        "lateral\nerror m",
        "yaw\nrad",
        "boundary\nmargin",
        "fallback\nsteps",
    ):
        table.add_column(heading, justify="right")
    for recorded in runs:
        metrics = compute(recorded)
        formed = "never" if metrics.formation_time_s is None else f"{metrics.formation_time_s:.2f}"
        table.add_row(
            recorded.scenario.name,
            formed,
            *_worst(metrics, recorded.scenario.platoon.gap_m, recorded.scenario.platoon.speed_mps),
        )
    return table


def _worst(metrics: Metrics, gap_m: float, speed_mps: float) -> list[str]:
    return [
        f"{metrics.least_distance_m:.2f}" if metrics.least_distance_m is not None else "-",
        f"{max((abs(gap - gap_m) for gap in metrics.final_gaps_m), default=0.0):.3f}",
        f"{max(abs(speed - speed_mps) for speed in metrics.final_speeds_mps):.3f}",
        f"{max(map(abs, metrics.final_lateral_errors_m)):.3f}",
        f"{max(map(abs, metrics.final_yaws_rad)):.4f}",
        f"{metrics.boundary_margin_min:.3f}",
        str(metrics.fallback_steps),
    ]


def offsets(logs: Path) -> Table:
    """Return the table of the remaining crosswind offset with the disturbance estimate."""
    table = Table(
        title=f"crosswind: mean tracking error over the last {LAST_S:g} s, with and without the disturbance estimate",
        title_justify="left",
    )
    headings = ("lambda", "yaw rate with\nrad/s", "without\nrad/s", "ratio", "speed with\nm/s", "without\nm/s", "ratio")
    for heading in headings:
        table.add_column(heading, justify="right")
    for value in LAMBDAS:
        tyres = [f"road.lambda_f={value}", f"road.lambda_r={value}"]
        with_estimate = record(logs, "crosswind", tyres)
        without = record(logs, "crosswind", [*tyres, "tracker.offset_free=false"])
        row = [f"{value:+g}"]
        for signal, truth in (("YawRate", "gamma"), ("VelocityX", "v_x")):
            left, full = (worst_offset(recorded, signal, truth) for recorded in (with_estimate, without))
            ratio = left / full if full > 0.0 else math.nan
            row += [f"{left:.2e}", f"{full:.2e}", f"{100 * ratio:.1f} %"]
        table.add_row(*row)
    return table


def worst_offset(recorded: Run, signal: str, truth: str) -> float:
    """Return the largest mean tracking error of any vehicle over the last `LAST_S`, from truth and reference."""
    return max(
        abs(_offset(recorded, vehicle, signal, truth)) for vehicle in range(1, len(recorded.scenario.vehicles) + 1)
    )


def _offset(recorded: Run, vehicle: int, signal: str, truth: str) -> float:
    t, reference = recorded.signal(f"veh{vehicle}", "TrackerReferenceState", signal)
    rows = recorded.truth(vehicle)
    actual: NDArray[np.float64] = np.interp(t, rows["t"], rows[truth])
    last = t >= recorded.scenario.duration_s - LAST_S
    return float(np.mean((actual - reference)[last]))
