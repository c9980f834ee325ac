"""Two overlaid runs as the data of one page: A's figures with B's curves in them, and the metrics of both."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from bench.analysis.comfort import Comfort
from bench.analysis.metrics import Metrics
from bench.analysis.page_data import PageData
from bench.analysis.requirements import Group
from bench.record.settings import MOST_SHOWN, NOTHING_DIFFERS, Settings, text_of

B = "B/"
"""Prefix of the keys of B's columns."""

Value = float | Sequence[float | None] | None


def _of_comfort(values: Callable[[Comfort], Sequence[float | None]]) -> Callable[[Metrics], Value]:
    """Return what takes values of comfort from the metrics, None if these have none."""
    return lambda metrics: None if metrics.comfort is None else values(metrics.comfort)


# For each numeric row of `requirements.table`: its values, and digits and unit of a difference.
_NUMBERS: dict[str, tuple[Callable[[Metrics], Value], int, str]] = {
    "Formation time": (lambda m: m.formation_time_s, 2, "s"),
    "Least distance": (lambda m: m.least_distance_m, 2, "m"),
    "Least clearance": (lambda m: m.least_clearance_m, 2, "m"),
    "Final gaps": (lambda m: m.final_gaps_m, 3, "m"),
    "Final speeds": (lambda m: m.final_speeds_mps, 3, "m/s"),
    "Final lateral errors": (lambda m: m.final_lateral_errors_m, 3, "m"),
    "Final yaw angles": (lambda m: m.final_yaws_rad, 4, "rad"),
    "Least margin to the stability boundary": (lambda m: m.boundary_margin_min, 3, ""),
    "Speed error, RMS": (lambda m: m.speed_rmse_mps, 4, "m/s"),
    "Yaw rate error, RMS": (lambda m: m.yaw_rate_rmse_radps, 5, "rad/s"),
    "Lateral acceleration, largest": (_of_comfort(lambda c: c.lateral_acceleration_max_mps2), 2, "m/s²"),
    "Lateral jerk, largest 0.5 s mean": (_of_comfort(lambda c: c.lateral_jerk_max_mps3), 2, "m/s³"),
    "Acceleration, largest": (_of_comfort(lambda c: c.acceleration_max_mps2), 2, "m/s²"),
    "Braking, largest": (_of_comfort(lambda c: c.braking_max_mps2), 2, "m/s²"),
    "Longitudinal jerk, largest 0.5 s mean": (_of_comfort(lambda c: c.longitudinal_jerk_max_mps3), 2, "m/s³"),
    "Weighted acceleration x, RMS": (_of_comfort(lambda c: c.weighted_rms_x_mps2), 3, "m/s²"),
    "Weighted acceleration y, RMS": (_of_comfort(lambda c: c.weighted_rms_y_mps2), 3, "m/s²"),
    "Weighted acceleration, vector sum": (_of_comfort(lambda c: c.weighted_rms_mps2), 3, "m/s²"),
    "Steering reversals over 2 mrad": (_of_comfort(lambda c: c.steering_reversals), 0, ""),
    "Steering rate, RMS": (_of_comfort(lambda c: c.steering_rate_rms_radps), 4, "rad/s"),
    "Energy driven at the wheels": (_of_comfort(lambda c: _kilo(c.driven_energy_j)), 1, "kJ"),
    "Energy braked at the wheels": (_of_comfort(lambda c: _kilo(c.braked_energy_j)), 1, "kJ"),
    "Solver, median / p99": (lambda m: _times(m.solver_ms), 2, "ms"),
    "Tracker step, median / p99": (lambda m: _times(m.tracker_ms), 2, "ms"),
    "Planner step, median / p99": (lambda m: _times(m.planner_ms), 2, "ms"),
    "Steps limited by the clearance": (lambda m: m.clearance_steps, 0, ""),
    "Steps with hard braking": (lambda m: m.hard_braking_steps, 0, ""),
    "Steps otherwise uncomfortable": (lambda m: m.uncomfortable_steps, 0, ""),
    "Steps solved by the Riccati equation": (lambda m: m.riccati_steps, 0, ""),
    "Steps solved by the SDP": (lambda m: m.sdp_steps, 0, ""),
    "Steps with a fallback gain": (lambda m: m.fallback_steps, 0, ""),
    "Frames lost": (lambda m: m.frames_lost, 0, ""),
    "E2E errors": (lambda m: m.e2e_errors, 0, ""),
    "Commands that are not numbers": (lambda m: len(m.not_numbers), 0, ""),
    "Warnings": (lambda m: m.warnings.count, 0, ""),
    "Real-time factor": (lambda m: m.real_time_factor, 2, ""),
}


def together(a: PageData, b: PageData, metrics: tuple[Metrics, Metrics], settings: Settings) -> PageData:
    """Return the data of a page that shows both runs, from the data and metrics of each and their compared settings."""
    return {
        **a,
        "names": settings.names,
        "settings": _settings(settings),
        "figures": _figures(a["figures"], b["figures"]),
        "pool": {**a["pool"], **{B + key: values for key, values in b["pool"].items()}},
        "compared": _compared(a["metrics"], b["metrics"], metrics),
        "not_sent": [f"{run}: {title}" for run, data in (("A", a), ("B", b)) for title in data["not_sent"]],
        "other": {**{key: value for key, value in b.items() if key not in ("figures", "pool")}, "prefix": B},
    }


def _settings(settings: Settings) -> dict[str, Any]:
    """Return what differs as rows of group, name and both values, the number of more of them, and notes."""
    shown = settings.differences[:MOST_SHOWN]
    nothing = [NOTHING_DIFFERS] if settings.comparable and not shown else []
    return {
        "rows": [[each.group, text_of(each.name), text_of(each.a), text_of(each.b)] for each in shown],
        "more": len(settings.differences) - len(shown),
        "notes": [*nothing, *settings.notes],
    }


def _figures(of_a: list[dict[str, Any]], of_b: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return A's figures with the curves of B; figures that only B has are at the end of their groups."""
    second = {figure["id"]: figure for figure in of_b}
    figures = [_figure(_dotted(figure), second.pop(figure["id"], None)) for figure in of_a]
    for figure in second.values():
        same = [place for place, other in enumerate(figures) if other["group"] == figure["group"]]
        figures.insert(same[-1] + 1 if same else len(figures), {**_dotted(figure), "curves": _of_b(figure)})
    return figures


def _figure(a: dict[str, Any], b: dict[str, Any] | None) -> dict[str, Any]:
    curves = [{**curve, "run": "A"} for curve in a["curves"]]
    if b is None:
        return {**a, "curves": curves}
    captions = (a["caption"], _dotted(b)["caption"])
    return {
        **a,
        "curves": curves + _of_b(b),
        "caption": captions[0] if captions[0] == captions[1] else f"A: {captions[0] or '–'} B: {captions[1] or '–'}",
        "lines": a["lines"] + [line for line in b["lines"] if line not in a["lines"]],
        "lanes": _lanes(a["lanes"], b["lanes"]),
        "x_range": _range(a["x_range"], b["x_range"]),
        "y_range": _range(a["y_range"], b["y_range"]),
        "y_top": None if None in (a["y_top"], b["y_top"]) else max(a["y_top"], b["y_top"]),
    }


def _dotted(figure: dict[str, Any]) -> dict[str, Any]:
    """With two runs, B's curves are dashed, and curves that are dashed for a single run are dotted."""
    told = {
        key: figure[key].replace("(dashed)", "(dotted)").replace("Dashed:", "Dotted:") for key in ("title", "caption")
    }
    return {**figure, **told}


def _of_b(figure: dict[str, Any]) -> list[dict[str, Any]]:
    keys = ("x", "y", "at")
    return [
        {**curve, **{key: B + curve[key] if curve[key] else "" for key in keys}, "run": "B"}
        for curve in figure["curves"]
    ]


def _range(a: list[float], b: list[float]) -> list[float]:
    both = [*a, *b]
    return [min(both), max(both)] if both else []


def _lanes(a: list[tuple[float, bool]], b: list[tuple[float, bool]]) -> list[tuple[float, bool]]:
    levels = sorted({level for level, _ in [*a, *b]})
    return [(level, level in (levels[0], levels[-1])) for level in levels]


def _compared(a: list[list[Any]], b: list[list[Any]], metrics: tuple[Metrics, Metrics]) -> list[list[Any]]:
    """Return rows: name, value of A and B, B − A, requirement of A and B, whether A and B meet it, `Row.group`."""
    first, second = {row[0]: row for row in a}, {row[0]: row for row in b}
    none = ["", "–", "", None, ""]
    rows = []
    for name in dict.fromkeys([*first, *second]):
        of_a, of_b = first.get(name, none), second.get(name, none)
        group = of_a[4] or of_b[4]
        values = [name, of_a[1], of_b[1], _difference(name, metrics), of_a[2], of_b[2], of_a[3], of_b[3], group]
        rows.append(values)
    return sorted(rows, key=lambda row: list(Group).index(row[8]))


def _difference(name: str, metrics: tuple[Metrics, Metrics]) -> str:
    """Return B − A as text, value by value; empty if the runs have different numbers of values."""
    if name not in _NUMBERS:
        return ""
    numbers, digits, unit = _NUMBERS[name]
    a, b = (_listed(numbers(each)) for each in metrics)
    if len(a) != len(b) or not any(x is not None and y is not None for x, y in zip(a, b, strict=True)):
        return ""
    texts = [
        "–" if x is None or y is None else f"{round(y - x, digits) + 0.0:+.{digits}f}"
        for x, y in zip(a, b, strict=True)
    ]
    text = ", ".join("0" if text.strip("+-0.") == "" else text for text in texts).replace("-", "−")
    return f"{text}\u00a0{unit}" if unit else text


def _listed(value: Value) -> list[float | None]:
    return list(value) if isinstance(value, Sequence) else [value]


def _kilo(values: Sequence[float | None]) -> Sequence[float | None]:
    return [None if value is None else 1e-3 * value for value in values]


def _times(times: dict[str, float] | None) -> list[float | None]:
    return [None, None] if times is None else [times["p50"], times["p99"]]
