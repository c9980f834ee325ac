"""The report of a campaign: a self-contained HTML file with the look and the figures of the report of a run."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import asdict
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import polars as pl

from bench.analysis.figure import Curve, Figure, Line
from bench.analysis.page_data import PageData
from bench.analysis.report import asset, filled
from bench.campaign.reports import write_reports
from bench.campaign.results import ALL_MET, INPUT, METRIC, Results, limit_of, read
from bench.campaign.sensitivity import LEAST_RUNS, influences, numeric
from bench.campaign.statistics import convergence, edges_of, finite, histogram
from bench.campaign.summary import Summary, summary
from bench.files import write_text

SHARED_SCRIPTS = ("dom", "data", "marks", "cursor", "axes", "save", "plot", "rows", "print")
"""Scripts of the report of a run that this page uses too."""
SCRIPTS = ("tornado", "campaign")
MOST_POINTS = 5000
"""Points of a scatter plot at most."""
MOST_VALUES = 400_000
"""Numbers of all scatter plots at most: with many metrics there are fewer points, so that the page stays below 5 MB."""
BLUE = "#0072b2"


def report(directory: Path, out: Path) -> Path:
    """Write the report of the campaign in a folder to `out`, and return that.

    The worst runs whose logs were kept get their own reports first, so that it links to them.

    Raises:
        BadInput: the folder has no results of a campaign, or the file cannot be written.
    """
    results = read(directory)
    write_reports(results)
    write_text(out, render(results, out.parent), option="--out")
    return out


def render(results: Results, beside: Path) -> str:
    """Return the report as HTML, with links that hold in the folder `beside`."""
    style = asset("page.css") + _asset("campaign.css")
    script = "\n".join([*(asset(f"{name}.js") for name in SHARED_SCRIPTS), *(_asset(f"{name}.js") for name in SCRIPTS)])
    title = f"platoon campaign: {results.name}"
    return filled(_asset("campaign.html"), title, style, script, {}, data_of(results, beside))


def data_of(results: Results, beside: Path) -> PageData:
    """Return what the page shows as JSON-serialisable values; paths are relative to `beside`."""
    told = summary(results)
    pool: dict[str, list[float | None]] = {"t": [0.0]}
    distributions = {name: _distribution(results, name, pool) for name in results.metrics}
    ordered = _ordered(results)
    driven = {name: _influences(results, name) for name in ordered}
    return {
        "scenario": results.name,
        "label": "",
        "live": False,
        "events": [],
        "description": told.headline,
        "verdicts": told.verdicts,
        "choices": told.choices,
        "shares": [row[:5] for row in told.shares],
        "notes": told.notes,
        "worst": list(_worst(told, beside)),
        "troubles": told.troubles,
        "quantiles": told.quantiles,
        "toml": results.text,
        "pool": pool,
        "figures": [asdict(figure) for figure in _figures(results, distributions, pool)],
        "distributions": {
            name: asdict(distributions[name]) for name in _ordered(results) if distributions[name].curves
        },
        "limits": {name: [asdict(line) for line in _limits(results, name)] for name in results.metrics},
        "points": _points(results),
        "influences": {name: found for name, found in driven.items() if found is not None},
        "no_influences": f"That needs at least {LEAST_RUNS} runs, an input that is a number, and a metric that varies.",
    }


def _asset(name: str) -> str:
    return resources.files("bench.campaign").joinpath("page", name).read_text(encoding="utf-8")


def _ordered(results: Results) -> list[str]:
    """Return the metrics, those with a requirement first."""
    asked = [limit.metric for text in results.requirements if (limit := limit_of(text))]
    known = results.metrics
    return list(dict.fromkeys([*(name for name in asked if name in known), *known]))


def _worst(told: Summary, beside: Path) -> Iterator[dict[str, Any]]:
    for group in told.worst:
        yield {
            "requirement": group.requirement,
            "metric": group.metric,
            "runs": [
                {
                    "number": str(run.number),
                    "value": run.value,
                    "met": run.met,
                    "wall": run.wall,
                    "report": _link(run.report, beside),
                    "log": "" if run.log is None else os.path.relpath(run.log, beside),
                }
                for run in group.runs
            ],
        }


def _link(report: Path | None, beside: Path) -> str:
    from urllib.parse import quote

    return "" if report is None else quote(Path(os.path.relpath(report, beside)).as_posix())


def _figures(
    results: Results, distributions: dict[str, Figure], pool: dict[str, list[float | None]]
) -> Iterator[Figure]:
    """Yield the distributions of the metrics with a requirement, then how sure the shares became."""
    asked = dict.fromkeys(limit.metric for text in results.requirements if (limit := limit_of(text)))
    for name in asked:
        if name in distributions and distributions[name].curves:
            yield distributions[name]
    if not results.at_random:
        return
    for number, (name, failed) in enumerate(results.verdicts.items()):
        shares = list(convergence(failed))
        if not shares:
            continue
        keys = {part: f"convergence.{number}.{part}" for part in ("n", "share", "low", "high")}
        pool[keys["n"]] = [float(share.known) for share in shares]
        pool[keys["share"]] = [100.0 * share.failed / share.known for share in shares]
        pool[keys["low"]] = [None if share.low is None else 100.0 * share.low for share in shares]
        pool[keys["high"]] = [None if share.high is None else 100.0 * share.high for share in shares]
        yield Figure(
            f"convergence-{number}",
            name,
            "How sure the share of failures became",
            "number of runs",
            "failed [%]",
            [
                Curve("Share of failures", keys["n"], keys["share"], BLUE, at=""),
                Curve("95 % bounds", keys["n"], keys["low"], "ink", dash=True, at="", label="lower bound"),
                Curve("95 % bounds", keys["n"], keys["high"], "ink", dash=True, at="", label="upper bound"),
            ],
            time=False,
            y_range=[0.0],
            y_top=_top(pool[keys["high"]]),
        )


def _top(high: list[float | None]) -> float:
    """Return the upper end of a share's axis, so that the bounds of the first few runs do not flatten the rest."""
    known = [value for value in high if value is not None]
    return max(1.15 * known[min(len(known) - 1, 3)], 1e-9)


def _distribution(results: Results, name: str, pool: dict[str, list[float | None]]) -> Figure:
    """Return the histogram of a metric, failures in another colour, with its limits; no curves without values."""
    values = results.runs[METRIC + name]
    everything = finite(values)
    figure = Figure(
        f"distribution-{name}", name, "Distributions", name, "number of runs", [], time=False, y_range=[0.0]
    )
    if not len(everything):
        return figure
    edges = edges_of(everything)
    counts = histogram(everything, edges)
    _add_histogram(figure, "Runs", BLUE, edges, counts, pool)
    failed = finite(values.filter(results.verdicts[ALL_MET]))
    if len(failed):
        _add_histogram(figure, "Failed", "limit", edges, histogram(failed, edges), pool)
    for number, line in enumerate(_limits(results, name)):
        at = f"{name}.limit{number}"
        pool[f"{at}.x"], pool[f"{at}.y"] = [line.y, line.y], [0.0, float(max(counts))]
        figure.curves.append(Curve(line.name, f"{at}.x", f"{at}.y", "ink", dash=True, at=""))
    return figure


def _add_histogram(
    figure: Figure,
    name: str,
    colour: str,
    edges: npt.NDArray[np.float64],
    counts: list[int],
    pool: dict[str, list[float | None]],
) -> None:
    key = f"{figure.id}.{name}"
    # From the axis and back to it.
    pool[f"{key}.x"] = [float(edges[0]), *map(float, edges)]
    pool[f"{key}.y"] = [0.0, *map(float, counts), 0.0]
    figure.curves.append(Curve(name, f"{key}.x", f"{key}.y", colour, at="", step=True, fill=True))


def _limits(results: Results, name: str) -> list[Line]:
    """Return the limits of a metric."""
    found = [(text, limit_of(text)) for text in results.requirements]
    return [
        Line(limit.value, f"required: {text}", limit=True) for text, limit in found if limit and limit.metric == name
    ]


def _points(results: Results) -> dict[str, Any]:
    """Return the runs of the scatter plots: inputs and metrics as columns, and whether each failed."""
    failed = results.verdicts[ALL_MET]
    chosen = _chosen(failed, min(MOST_POINTS, MOST_VALUES // max(1, len(results.inputs) + len(results.metrics))))
    rows = results.runs[chosen]
    shown = "Each point is a run"
    if rows.height < results.runs.height:
        shown = f"{rows.height} of {results.runs.height} runs, failures first, others at random"
    inputs = rows.select(pl.col(INPUT + name).alias(name) for name in results.inputs)
    return {
        "inputs": {name: _numbers(inputs[name]) for name in numeric(inputs)},
        "metrics": {name: _numbers(rows[METRIC + name]) for name in _ordered(results)},
        "failed": failed[chosen].cast(pl.Int8).to_list(),
        "caption": f"{shown}.",
    }


def _chosen(failed: pl.Series, most: int) -> npt.NDArray[np.int64]:
    """Return the indices of all runs, or of `most`: failures, up to half of them, and others, both at random."""
    if len(failed) <= most:
        return np.arange(len(failed))
    mixed = np.random.default_rng(1).permutation(len(failed))
    missed = failed.to_numpy()[mixed]
    return np.concatenate([mixed[missed][: most // 2], mixed[~missed]])[:most]


def _numbers(values: pl.Series) -> list[float | None]:
    """Return values with 6 significant digits; null where they are not finite."""
    numbers = values.cast(pl.Float64).round_sig_figs(6)
    return [value if value is not None and np.isfinite(value) else None for value in numbers.to_list()]


def _influences(results: Results, name: str) -> dict[str, Any] | None:
    inputs = results.runs.select(pl.col(INPUT + each).alias(each) for each in results.inputs)
    found = influences(inputs, results.runs[METRIC + name].alias(name))
    return None if found is None else asdict(found)
