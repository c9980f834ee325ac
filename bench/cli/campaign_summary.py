"""What a campaign says, at the terminal."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from bench.campaign.summary import WorstRun
    from bench.cli.terminal import Terminal


def show(directory: Path, *, metrics: bool = False) -> None:
    """Print on standard output what the campaign in a folder says.

    Args:
        directory: the folder.
        metrics: whether the distribution of every metric is printed too.

    Raises:
        BadInput: the folder has no results of a campaign.
    """
    from bench.campaign.results import read
    from bench.campaign.summary import summary
    from bench.cli.terminal import Terminal

    results = read(directory)
    told, console = summary(results), Terminal()
    console.print(f"{results.name}: {told.headline}")
    for verdict in told.verdicts:
        console.print(verdict["text"])
    _print(console, ("requirement", "failed", "of", "share", "95 % bounds"), told.shares)
    _print(console, ("input", "value", "failed", "of", "share", "95 % bounds"), told.choices)
    for note in told.notes:
        console.print(note)
    worst = [
        [group.requirement, group.runs[0].value, ", ".join(_number(run) for run in group.runs)] for group in told.worst
    ]
    _print(console, ("requirement", "worst", "worst runs"), worst)
    if worst:
        console.print(f"* with its log: {directory}/logs/run-NUMBER.mcap, and its scenario beside it (.toml)")
    _print(console, ("did not end", "runs", "first", "what was said"), told.troubles)
    if metrics:
        _print(console, ("metric", "least", "5 %", "median", "95 %", "largest", "runs"), told.quantiles)


def _number(run: "WorstRun") -> str:
    return f"{run.number}{'' if run.log is None else '*'}"


def _print(console: "Terminal", headings: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table of texts, unless it has no rows; all but the first and the last column are numbers."""
    from rich.table import Table

    if not rows:
        return
    table = Table()
    for index, heading in enumerate(headings):
        # A name keeps its lines; what was said may wrap.
        between = 0 < index < len(headings) - 1
        table.add_column(heading, justify="right" if between else "left", no_wrap=between, overflow="fold")
    for row in rows:
        table.add_row(*row)
    console.print(table)
