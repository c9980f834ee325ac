"""What a campaign says as a page of Markdown, with what drives its metrics as a figure beside it."""

from __future__ import annotations

import html
from collections.abc import Sequence
from pathlib import Path

import polars as pl

from bench.campaign.results import INPUT, METRIC, Results, limit_of, read
from bench.campaign.sensitivity import Influences, influences
from bench.campaign.summary import Summary, summary
from bench.files import write_text

_WIDTH, _ROW, _BAR, _TOP, _BOTTOM, _LETTER = 720, 24, 13, 12, 44, 7.2
_STYLE = (
    ".text{font:13px system-ui,sans-serif;fill:#808080}.grid{stroke:#80808040}.whisker{stroke:#505050;fill:none}"
    ".chance{stroke:#808080;stroke-dasharray:4 3}.title{font-weight:600}"
)
_DIRECTION = 0.1
"""Rank correlations nearer to 0 than this are no direction."""
MOST_INPUTS = 4
"""Inputs shown of a metric, the strongest."""
_TITLE = "What drives the metrics"
_HOW = (
    f"PAWN indices of the {MOST_INPUTS} strongest inputs, with 95 % confidence intervals; left of the dashed line an"
    " influence cannot be told from chance. Blue: the metric rises with the input; orange: it falls."
)
_RISES, _FALLS, _NEITHER = "#0072b2", "#d55e00", "#8a8a8a"


def write(directory: Path, page: Path) -> Path:
    """Write what the campaign in a folder says as Markdown, and what drives it as a figure (SVG) beside it.

    Args:
        directory: the folder.
        page: the file.

    Raises:
        BadInput: the folder has no results of a campaign, or a file cannot be written.
    """
    results = read(directory)
    driven = _driven(results)
    figure = page.with_name(f"{page.stem}-drives.svg")
    if driven:
        write_text(figure, tornado(driven))
    write_text(page, text(results, summary(results), figure.name if driven else ""))
    return page


def tornado(driven: Sequence[Influences]) -> str:
    """Return the strongest influences on metrics as an SVG: bars with their confidence intervals, on one scale."""
    rows = [(found, each) for found in driven for each in (None, *found.inputs[:MOST_INPUTS])]
    left = max(len(each.input) for _, each in rows if each is not None) * _LETTER + 14
    most = 1.04 * max(each.index + each.half_width for _, each in rows if each is not None)
    bottom = _TOP + _ROW * len(rows)

    def x(value: float) -> float:
        return left + max(0.0, value) / most * (_WIDTH - left - 16)

    parts = []
    for step in range(5):
        value = most * step / 4.0
        parts.append(f'<path class="grid" d="M{x(value):.1f} {_TOP}V{bottom}"/>')
        parts.append(_text(f"{value:.2f}", x(value), bottom + 17, "middle"))
    for place, (found, each) in enumerate(rows):
        y = _TOP + _ROW * (place + 0.5)
        if each is None:
            count = min(MOST_INPUTS, len(found.inputs))
            parts.append(_text(found.metric, left, y + 6, "start", "title"))
            parts.append(f'<path class="chance" d="M{x(found.chance):.1f} {y + _ROW / 2}v{_ROW * count}"/>')
            continue
        ink = _RISES if each.direction > _DIRECTION else _FALLS if each.direction < -_DIRECTION else _NEITHER
        low, high = x(each.index - each.half_width), x(each.index + each.half_width)
        parts.append(_text(each.input, left - 8, y + 4, "end"))
        bar = f'x="{left:.1f}" y="{y - _BAR / 2:.1f}" width="{x(each.index) - left:.1f}" height="{_BAR}"'
        parts.append(f'<rect {bar} fill="{ink}"/>')
        parts.append(f'<path class="whisker" d="M{low:.1f} {y}H{high:.1f}M{low:.1f} {y - 4}v8M{high:.1f} {y - 4}v8"/>')
    parts.append(_text("PAWN index", (left + _WIDTH) / 2, bottom + 36, "middle"))
    size = f'viewBox="0 0 {_WIDTH} {bottom + _BOTTOM}" width="{_WIDTH}" height="{bottom + _BOTTOM}"'
    head = f'<svg xmlns="http://www.w3.org/2000/svg" {size}><title>{_TITLE}</title><style>{_STYLE}</style>'
    return "\n".join([head, *parts, "</svg>", ""])


def _driven(results: Results) -> list[Influences]:
    """Return what drives the metrics of the requirements, each once."""
    limits = [limit for text in results.requirements if (limit := limit_of(text)) is not None]
    names = dict.fromkeys(limit.metric for limit in limits if limit.side and limit.metric in results.metrics)
    inputs = results.runs.select(pl.col(INPUT + each).alias(each) for each in results.inputs)
    found = (influences(inputs, results.runs[METRIC + name].alias(name)) for name in names)
    return [each for each in found if each is not None and each.inputs[0].index > each.chance]


def text(results: Results, told: Summary, figure: str) -> str:
    """Return the page; `figure` is the name of the figure's file, empty if there is none."""
    parts = [f"# {results.name}", f"{told.headline}.", *(each["text"] for each in told.verdicts)]
    parts.append(_table(["Requirement", "Failed", "Of", "Share", "95 % bounds"], told.shares))
    parts += told.notes
    if told.choices:
        parts.append(_table(["Input", "Value", "Failed", "Of", "Share", "95 % bounds"], told.choices))
    worst = [
        [
            f"`{group.requirement}`",
            group.runs[0].value,
            ", ".join(str(run.number) for run in group.runs),
            ", ".join(f"{name} {value}" for name, value in group.runs[0].inputs.items()),
        ]
        for group in told.worst
    ]
    if worst:
        parts += [
            "## The worst",
            _table(["Requirement", "Worst", "Runs, the worst first", "Inputs of the worst"], worst),
        ]
    if told.troubles:
        parts += ["## What did not end", _table(["Status", "Runs", "First", "What was said"], told.troubles)]
    if figure:
        parts += ["## What drives it", _HOW, f"![{_TITLE}]({figure})"]
    parts.append("## Metrics")
    parts.append(_table(["Metric", "Least", "5 %", "Median", "95 %", "Largest", "Runs"], told.quantiles))
    return "\n\n".join(parts) + "\n"


def _table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    rule = ["---", *("---:" for _ in headings[1:])]
    cells = [[cell.replace("|", "\\|").replace("\n", " ") for cell in row] for row in rows]
    return "\n".join(f"| {' | '.join(row)} |" for row in (headings, rule, *cells))


def _text(words: str, x: float, y: float, anchor: str, kind: str = "") -> str:
    return f'<text class="text {kind}" x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{html.escape(words)}</text>'
