"""`python -m bench.benchmarks comfort`: the random scenarios, the price of comfort, the shipped scenarios, the page."""

import argparse
import os
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from rich.table import Table

from bench.benchmarks.comfort import front
from bench.benchmarks.comfort.page import page
from bench.benchmarks.comfort.runs import ROOT, Job, results
from bench.benchmarks.comfort.tables import (
    SHIPPED,
    TYRES,
    failed_sheet,
    front_sheet,
    gave_way_sheet,
    random_sheet,
    shipped_sheets,
)
from bench.benchmarks.sheet import Sheet
from bench.campaign.version import code_version
from bench.errors import BadInput
from bench.files import check_directory, check_suffix, write_text
from bench.scenario import shipped
from bench.scenario.families import MOST

SCENARIOS = 300
PARTS = ("random", "front", "shipped")
KEPT = ROOT / "build" / "comfort"


@dataclass(frozen=True)
class _Runs:
    """How runs are made.

    Attributes:
        folder: where results are kept.
        processes: how many run at a time.
    """

    folder: Path
    processes: int

    def random(self, seeds: range) -> list[Sheet | str]:
        """Return the tables of the random scenarios with these numbers."""
        found = results([Job(f"random:{seed}") for seed in seeds], self.folder, self.processes, _say)
        by_seed = dict(zip(seeds, found, strict=True))
        return [random_sheet(found), failed_sheet(by_seed), gave_way_sheet(by_seed)]

    def front(self) -> list[front.Point]:
        """Return the formation with each pair of limits."""
        jobs = front.jobs()
        found = results(list(jobs.values()), self.folder, self.processes, _say)
        return [front.Point(*limits, result) for limits, result in zip(jobs, found, strict=True)]

    def shipped(self) -> list[Sheet | str]:
        """Return the tables of the shipped scenarios, as far as they are shipped."""
        jobs = {
            (name, tyres): Job(name, (f"road.lambda_f={lambda_f}", f"road.lambda_r={lambda_r}"))
            for name in SHIPPED
            if name in shipped()
            for tyres, (lambda_f, lambda_r) in TYRES.items()
        }
        found = results(list(jobs.values()), self.folder, self.processes, _say)
        return [*shipped_sheets(dict(zip(jobs, found, strict=True)))]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `comfort`."""
    parser.add_argument(
        "--scenarios",
        type=_whole(1, MOST + 1),
        default=SCENARIOS,
        metavar="N",
        help=f"number of random scenarios, random:0 and on (default: {SCENARIOS})",
    )
    parser.add_argument("--only", choices=PARTS, help="only this part, which makes no page")
    parser.add_argument(
        "--processes",
        type=_whole(1, 1024),
        default=os.cpu_count() or 1,
        metavar="N",
        help="how many runs are made at a time (default: as many as there are cores)",
    )
    parser.add_argument("--write", type=Path, metavar="PAGE.md", help="write the tables as a page, as in docs/")


def measured(options: argparse.Namespace) -> Iterator[Table | str]:
    """Do what the options say; yield what is to be printed.

    Raises:
        BadInput: the page cannot be written, or is not to have all parts.
    """
    page_file: Path | None = options.write
    if page_file is not None and options.only is not None:
        raise BadInput(f"--write {page_file}: a page has all parts; leave out --only {options.only}")
    if page_file is not None:
        check_suffix(page_file, ".md")
        check_directory(page_file)
    runs = _Runs(KEPT / code_version(), options.processes)
    _say(f"results are kept in {runs.folder}")
    seeds = range(options.scenarios)
    wanted = PARTS if options.only is None else (options.only,)
    found: dict[str, list[Sheet | str]] = {}
    points = []
    for part in wanted:
        if part == "random":
            found[part] = runs.random(seeds)
        elif part == "front":
            points = runs.front()
            found[part] = [front_sheet(points)]
        else:
            found[part] = runs.shipped()
        yield from (each if isinstance(each, str) else each.table() for each in found[part])
    if page_file is not None:
        figure = page_file.with_name(f"{page_file.stem}-front.svg")
        write_text(figure, front.svg(points))
        write_text(page_file, page(seeds, found["random"], found["front"], found["shipped"], figure.name))


def _whole(least: int, most: int) -> Callable[[str], int]:
    """Return what reads a whole number between two limits."""

    def number(text: str) -> int:
        value = int(text)
        if not least <= value <= most:
            raise argparse.ArgumentTypeError(f"{text}: allowed: {least} to {most}")
        return value

    return number


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)  # noqa: T201 - progress
