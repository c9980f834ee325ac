"""A run at the terminal: its progress, then its metrics.

rich is imported where it draws: without a terminal, a run starts before that.
"""

import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, NamedTuple

import typer

from bench.cli.output import message, one_line

if TYPE_CHECKING:  # a run is to start before what its analysis needs is imported
    from rich.table import Table

    from bench.analysis.comfort import Comfort
    from bench.analysis.metrics import Metrics
    from bench.analysis.timing import Timing

PLAIN_STEPS = 10
"""Number of progress lines if there is no terminal for a bar."""


class Following(NamedTuple):
    """Shows the progress of a run.

    Attributes:
        at: takes the simulated time (s).
        starting: takes a line about what is waited for before the run begins; on a terminal it replaces the one before,
            elsewhere only the first one is shown.
    """

    at: Callable[[float], None]
    starting: Callable[[str], None]


@contextmanager
def following(name: str, duration_s: float) -> Iterator[Following]:
    """Show the progress of a run on standard error."""
    if not sys.stderr.isatty():
        yield Following(_plain(name, duration_s), _once())
        return
    from rich.progress import BarColumn, TaskProgressColumn, TextColumn, TimeElapsedColumn

    from bench.cli.terminal import progress

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TaskProgressColumn(),
        TextColumn("{task.completed:.1f} of {task.total:g} s simulated"),
        TimeElapsedColumn(),
    )
    with progress(*columns) as bars:
        task = bars.add_task(name, total=duration_s)
        yield Following(
            lambda time_s: bars.update(task, completed=min(time_s, duration_s), description=name),
            lambda text: bars.update(task, description=f"{name}: {text}"),
        )


def _once() -> Callable[[str], None]:
    told = False

    def tell(text: str) -> None:
        nonlocal told
        if not told:
            told = True
            typer.echo(message(text), err=True)

    return tell


def _plain(name: str, duration_s: float) -> Callable[[float], None]:
    told = 0

    def tell(time_s: float) -> None:
        nonlocal told
        step = int(PLAIN_STEPS * time_s / duration_s + 1e-9)
        if step > told:
            told = step
            typer.echo(f"{name}: {min(time_s, duration_s):.1f} of {duration_s:g} s simulated", err=True)

    return tell


def show_metrics(metrics: "Metrics", label: str = "") -> None:
    """Print the metrics of a run on standard output, under its label if it has one."""
    from bench.cli.terminal import Terminal

    console = Terminal()
    if label:
        console.print(label)
    console.print(_overall(metrics))
    console.print(_vehicles(metrics))
    if metrics.comfort is not None:
        console.print(_felt(metrics.comfort))
        console.print(_steering_and_energy(metrics.comfort))
    if metrics.warnings.count:
        console.print(one_line(str(metrics.warnings)))
    if not metrics.complete:
        console.print("The run or its log is truncated: 'final' is the last value in the log.")


def show_timing(times: "Timing", scheduling: str) -> None:
    """Print a real-time run's timing on standard output, and the scheduling that the kernel granted."""
    from rich.table import Table

    from bench.cli.terminal import Terminal

    table = Table(title=f"real time: {100 * times.miss_rate:.3f} % of the ECUs' deadlines missed", title_justify="left")
    table.add_column("node")
    for heading in ("response p50\nms", "p99\nms", "largest\nms", "jitter\nms", "missed", "longest\nin a row"):
        table.add_column(heading, justify="right")
    for node in times.nodes:
        values = (*(node.response(percentile) for percentile in (50.0, 99.0, 100.0)), node.jitter_ms)
        figures = (_figure(value, "{:.2f}") for value in values)
        table.add_row(node.name, *figures, f"{node.misses} of {node.cycles}", str(node.longest_miss))
    console = Terminal()
    console.print(table)
    console.print(f"BenchSync was at most {times.clock_late_ms.max():.2f} ms late. {scheduling}")


def _overall(metrics: "Metrics") -> "Table":
    from rich.table import Table

    from bench.analysis.requirements import count_text
    from bench.analysis.step_times import median_and_p99

    formed = "not formed" if metrics.formation_time_s is None else f"{metrics.formation_time_s:.2f} s"
    rows = [
        ("formation time", formed),
        ("least distance", _figure(metrics.least_distance_m, "{:.2f} m")),
        ("least clearance", _figure(metrics.least_clearance_m, "{:.2f} m")),
        ("final gaps", _figures(metrics.final_gaps_m, "{:.2f}", "m")),
        ("boundary margin, least", _figure(metrics.boundary_margin_min, "{:.3f}")),
        (
            "steps limited by clearance / of them hard braking",
            f"{count_text(metrics.clearance_steps)} / {count_text(metrics.hard_braking_steps)}",
        ),
        ("steps otherwise uncomfortable", count_text(metrics.uncomfortable_steps)),
        ("steps solved by Riccati / SDP", f"{count_text(metrics.riccati_steps)} / {count_text(metrics.sdp_steps)}"),
        ("fallback steps", count_text(metrics.fallback_steps)),
        ("frames lost", count_text(metrics.frames_lost)),
        ("E2E errors", count_text(metrics.e2e_errors)),
    ]
    of_machine = [
        ("solver, median / p99", median_and_p99(metrics.solver_ms)),
        ("tracker's step, median / p99", median_and_p99(metrics.tracker_ms)),
        ("planner's step, median / p99", median_and_p99(metrics.planner_ms)),
        ("real-time factor", _figure(metrics.real_time_factor, "{:.2f}")),
    ]
    table = Table(show_header=False)
    for row in rows:
        table.add_row(*row)
    table.add_section()
    table.add_row("on this machine")
    for row in of_machine:
        table.add_row(*row)
    return table


def _vehicles(metrics: "Metrics") -> "Table":
    from bench.analysis.step_times import NOT_SENT

    headings = ("final speed\nm/s", "lateral error\nm", "yaw\nrad", "speed RMSE\nm/s", "yaw rate RMSE\nrad/s")
    columns = (
        metrics.final_speeds_mps,
        metrics.final_lateral_errors_m,
        metrics.final_yaws_rad,
        metrics.speed_rmse_mps,
        metrics.yaw_rate_rmse_radps,
    )
    rows = (
        (
            f"{speed:.3f}",
            f"{lateral:+.3f}",
            f"{yaw:+.4f}",
            NOT_SENT if speed_rmse is None else f"{speed_rmse:.4f}",
            NOT_SENT if yaw_rate_rmse is None else f"{yaw_rate_rmse:.5f}",
        )
        for speed, lateral, yaw, speed_rmse, yaw_rate_rmse in zip(*columns, strict=True)
    )
    return _by_vehicle("vehicle", headings, rows)


def _felt(comfort: "Comfort") -> "Table":
    """Return the table of what is felt in each vehicle, with the limits of comfort if the run has any."""
    limits = comfort.limits.get
    columns: tuple[tuple[str, Sequence[float | None], float | None], ...] = (
        ("lateral\nm/s²", comfort.lateral_acceleration_max_mps2, limits("a_y")),
        ("lateral\njerk\nm/s³", comfort.lateral_jerk_max_mps3, limits("jerk_y")),
        ("forward\nm/s²", comfort.acceleration_max_mps2, limits("a_x")),
        ("braking\nm/s²", comfort.braking_max_mps2, limits("a_x")),
        ("longitudinal\njerk\nm/s³", comfort.longitudinal_jerk_max_mps3, limits("jerk_x")),
        ("ISO 2631-1\nRMS\nm/s²", comfort.weighted_rms_mps2, None),
    )
    rows = list(zip(*([_against(value, limit) for value in values] for _, values, limit in columns), strict=True))
    above = any(text.endswith(_ABOVE) for row in rows for text in row)
    table = _by_vehicle("largest", [heading for heading, _, _ in columns], rows)
    if comfort.limits:
        table.add_section()
        table.add_row("limit", *("" if limit is None else f"{limit:g}  " for _, _, limit in columns))
    table.caption = f"{_ABOVE} above the limit of comfort; the run has not failed by that" if above else None
    return table


_ABOVE = "!"


def _against(value: float | None, limit: float | None) -> str:
    """Return a value as text, marked if it is above its limit of comfort."""
    mark = "" if limit is None else f" {_ABOVE}" if value is not None and value > limit else "  "
    return _figure(value, "{:.2f}") + mark


def _steering_and_energy(comfort: "Comfort") -> "Table":
    from bench.analysis.comfort import REVERSAL_GAP_RAD

    headings = (
        f"steering reversals\nover {1e3 * REVERSAL_GAP_RAD:g} mrad",
        "steering rate\nRMS, rad/s",
        "energy driven\nkJ",
        "energy braked\nkJ",
    )
    columns = (
        [str(count) for count in comfort.steering_reversals],
        [_figure(value, "{:.4f}") for value in comfort.steering_rate_rms_radps],
        [_figure(None if value is None else 1e-3 * value, "{:.1f}") for value in comfort.driven_energy_j],
        [_figure(None if value is None else 1e-3 * value, "{:.1f}") for value in comfort.braked_energy_j],
    )
    return _by_vehicle("vehicle", headings, zip(*columns, strict=True))


def _by_vehicle(corner: str, headings: Sequence[str], rows: Iterable[Sequence[str]]) -> "Table":
    """Return a table with a row of texts for each vehicle."""
    from rich.table import Table

    table = Table()
    table.add_column(corner)
    for heading in headings:
        table.add_column(heading, justify="right")
    for number, row in enumerate(rows, 1):
        table.add_row(f"veh{number}", *row)
    return table


def _figure(value: float | None, form: str) -> str:
    return "-" if value is None else form.format(value)


def _figures(values: Sequence[float], form: str, unit: str) -> str:
    return f"{', '.join(form.format(value) for value in values)} {unit}" if values else "-"
