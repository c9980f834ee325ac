"""What a campaign says, as texts for tables: on the terminal and on its page."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.campaign.results import (
    ALL_MET,
    COMPLETED,
    INPUT,
    METRIC,
    REQUIREMENT,
    Results,
    limit_of,
    purpose_of,
)
from bench.campaign.statistics import LEVELS, Share, quantiles
from bench.campaign.statuses import REFUSED

MOST_WORDS = 400
"""Characters shown of what was said of a run."""
MOST_TROUBLES = 20


@dataclass(frozen=True)
class WorstRun:
    """One of the worst runs.

    Attributes:
        number: of the run.
        value: its metric as text.
        met: whether it met the requirement; None if unknown.
        wall: wall time as text.
        log: its log, if kept.
        report: the report beside that, if there is one.
        inputs: the values of its inputs as text, by name.
    """

    number: int
    value: str
    met: bool | None
    wall: str
    log: Path | None
    report: Path | None
    inputs: dict[str, str]


@dataclass(frozen=True)
class Worst:
    """The worst runs by the metric of a requirement."""

    requirement: str
    metric: str
    runs: list[WorstRun]


@dataclass(frozen=True)
class Summary:
    """What a campaign says.

    Attributes:
        headline: how many runs of what.
        verdicts: sentences about the whole, as `text` and whether it is `good`.
        shares: for each requirement its name, the runs that failed, of how many, in percent, bounds in percent.
        choices: for each value of an input that is a text its name, the value, and as in `shares` how many failed.
        notes: what is to be known about the shares.
        worst: the worst runs by requirement.
        quantiles: for each metric its name, least, 5 %, median, 95 %, largest and the number of runs with it.
        troubles: status, number of rows, the first row's number, words, of rows without an ended run.
    """

    headline: str
    verdicts: list[dict[str, Any]]
    shares: list[list[str]]
    choices: list[list[str]]
    notes: list[str]
    worst: list[Worst]
    quantiles: list[list[str]]
    troubles: list[list[str]]


def summary(results: Results) -> Summary:
    """Return what a campaign says."""
    shares = results.shares()
    return Summary(
        _headline(results),
        [_verdict(shares[ALL_MET])],
        [[name, *_cells(share)] for name, share in shares.items()],
        [
            [name, value, *_cells(share)]
            for name, by_value in results.shares_by_choice().items()
            for value, share in by_value.items()
        ],
        _notes(results, shares),
        [found for text in results.requirements if (found := _worst(results, text)) is not None],
        list(_quantiles(results)),
        _troubles(results),
    )


def _cells(share: Share) -> list[str]:
    return [str(share.failed), str(share.known), share.text, share.bounds]


def _headline(results: Results) -> str:
    statuses = ", ".join(f"{count} {status}" for status, count in results.statuses().items())
    base = results.study.get("base")
    of = f" of {base}" if isinstance(base, str) else ""
    return f"{results.rows.height} runs{of}, {_drawn(results)}: {statuses}"


def _drawn(results: Results) -> str:
    purpose = purpose_of(results.directory)
    return f"chosen by {purpose}" if purpose else f"{results.sampling} sampling"


def _verdict(share: Share) -> dict[str, Any]:
    if not share.known:
        return {"text": "No run was started.", "good": None}
    text = f"{share.failed} of {share.known} runs failed"
    if share.high is not None:
        text += f"; probability of failure {share.bounds}, with 95 % confidence"
    return {"text": f"{text}.", "good": share.failed == 0}


def _notes(results: Results, shares: dict[str, Share]) -> list[str]:
    notes = []
    if not results.at_random:
        by = purpose_of(results.directory) or f"a {results.sampling}"
        notes.append(f"The runs of {by} are not drawn at random: their share is no probability.")
    else:
        notes.append("Bounds by Clopper and Pearson: exact for independent runs, rounded outwards.")
        if results.sampling != "monte-carlo":
            notes.append(f"Runs of {results.sampling} sampling are not independent: take the bounds as approximate.")
    refused = results.statuses().get(REFUSED, 0)
    if refused:
        notes.append(f"{refused} refused: their values make no scenario, so they count as no run.")
    if any(share.known < shares[COMPLETED].known for share in shares.values()):
        notes.append("A requirement is counted over the runs whose metric is known.")
    return notes


def _worst(results: Results, requirement: str) -> Worst | None:
    limit, rows = limit_of(requirement), results.worst(requirement)
    if limit is None or rows.is_empty():
        return None
    runs = [
        WorstRun(
            row["number"],
            number(row.get(METRIC + limit.metric)),
            row[REQUIREMENT + requirement],
            f"{row['wall_s']:.2f} s" if row["wall_s"] is not None else "–",
            results.log_of(row["log"]),
            results.report_of(row["log"]),
            {name: _shown(row[INPUT + name]) for name in results.inputs},
        )
        for row in rows.iter_rows(named=True)
    ]
    return Worst(requirement, limit.metric, runs)


def _shown(value: float | bool | str | None) -> str:
    return value if isinstance(value, str) else number(value)


def _quantiles(results: Results) -> Iterator[list[str]]:
    metrics = results.runs.select(METRIC + name for name in results.metrics)
    counts = metrics.count().row(0)
    for name, levels, count in zip(results.metrics, quantiles(metrics), counts, strict=True):
        yield [name, *(map(number, levels) if levels else ["–"] * len(LEVELS)), str(count)]


def _troubles(results: Results) -> list[list[str]]:
    rows = results.troubles().head(MOST_TROUBLES).iter_rows(named=True)
    return [[row["status"], str(row["rows"]), str(row["number"]), row["words"][:MOST_WORDS]] for row in rows]


def number(value: float | bool | None) -> str:
    """Return a metric as text with four significant digits; whole numbers as they are."""
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if float(value).is_integer() and abs(value) < 1e9:
        return str(int(value))
    return f"{value:.4g}"
