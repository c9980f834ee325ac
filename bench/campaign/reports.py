"""The reports of a campaign's worst runs, beside their logs."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from bench.analysis.report import write
from bench.campaign.results import Results
from bench.errors import BadInput
from bench.record import Run


def write_reports(results: Results) -> list[Path]:
    """Write the report of each of the worst runs of every requirement that has a log and no report yet.

    A log from which no report can be drawn is left out, and so is a report that cannot be written: the campaign's page
    then names the command for it, which says why.

    Returns:
        The reports that were written, each with its log's name and `.html`.
    """
    written = []
    for log in _without_report(results):
        report = log.with_suffix(".html")
        with suppress(BadInput):
            write(Run(log), report, new=True)
            written.append(report)
    return written


def _without_report(results: Results) -> Iterator[Path]:
    """Yield the logs of the worst runs that have no report, each once."""
    names = dict.fromkeys(name for text in results.requirements for name in results.worst(text)["log"])
    for name in names:
        log = results.log_of(name)
        if log is not None and results.report_of(name) is None:
            yield log
