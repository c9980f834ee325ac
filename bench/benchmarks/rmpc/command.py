"""`python -m bench.benchmarks rmpc`: the tables, the check over all problems, the page in docs/, the set made anew."""

import argparse
import platform
import sys
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path

import numpy as np
from rich.table import Table

from bench.benchmarks.rmpc import nominal
from bench.benchmarks.rmpc.check import failures
from bench.benchmarks.rmpc.contestants import OURS, Contestant, Result, contestants, settings, solved
from bench.benchmarks.rmpc.page import page
from bench.benchmarks.rmpc.problems import FILE, Problems, load, save
from bench.benchmarks.rmpc.tables import groups_sheet, nominal_sheet, robust_sheet
from bench.benchmarks.rmpc.worst import FEW, RUNS, worst_sheet
from bench.benchmarks.sheet import Sheet
from bench.errors import RunFailed
from bench.files import check_directory, check_suffix, write_text

SAMPLE = 2000
"""Number of problems that the fastest contestants get unless all are wanted."""
PASSED = "passed"
NOMINAL, TREE = 300, 60
"""Number for the nominal MPC solvers, and for the scenario tree, at most."""


def tables() -> Iterator[Table | str]:
    """Yield the tables of a sample of the problems."""
    for sheet in sheets(load(), SAMPLE):
        yield sheet if isinstance(sheet, str) else sheet.table()


def sheets(problems: Problems, count: int) -> Iterator[Sheet | str]:
    """Yield each table as soon as it is measured."""
    yield f"{len(problems)} problems; {machine()}"
    results = [_result(contestant, problems, count) for contestant in contestants()]
    yield robust_sheet(results)
    yield groups_sheet(results[0])
    found = problems.chosen((problems.rho == 1.0) & problems.independent)
    outcomes = list(nominal.outcomes(found.sample(min(count, NOMINAL)), found.sample(min(count, TREE))))
    yield nominal_sheet([each for each in outcomes if not isinstance(each, str)])
    yield from (each for each in outcomes if isinstance(each, str))
    yield worst_sheet(RUNS if count == len(problems) else FEW)


def _result(contestant: Contestant, problems: Problems, count: int) -> Result:
    return solved(contestant, problems.sample(min(count, contestant.most)))


def verdict(result: Result) -> Iterator[str]:
    """Yield the outcome of the check in words."""
    bad = failures(result)
    infeasible = ~result.feasible
    yield (
        f"{len(result.gains)} problems, {infeasible.sum()} of them infeasible; {result.usable.sum()} certified gains"
        f" ({', '.join(f'{name} {number}' for name, number in result.sources.items())}); tau at most"
        f" {np.nanmax(result.ratio):.5f} times the optimum; infeasible ones with a certified gain:"
        f" {(result.usable & infeasible).sum()}"
    )
    yield from bad[:20]
    yield f"FAILED: {len(bad)} times" if bad else PASSED


def machine() -> str:
    """Return this machine's processor and the versions of what is compared."""
    lines = Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").exists() else []
    models = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    names = ("numpy", "clarabel", "cvxpy", "scs", "cvxopt", "sdpa-python", "casadi", "do-mpc")
    versions = []
    for name in names:
        try:
            versions.append(f"{name} {metadata.version(name)}")
        except metadata.PackageNotFoundError:
            continue
    processor = f"{len(models)} x {models[0]}" if models else platform.processor()
    return f"{processor}; Python {platform.python_version()}, {', '.join(versions)}"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `rmpc`."""
    parser.add_argument("--all", action="store_true", help="all problems, and the check of the bench's own solver")
    parser.add_argument("--write", type=Path, metavar="PAGE.md", help="write the tables as a page, as in docs/")
    parser.add_argument("--make", action="store_true", help=f"make {FILE.name} anew, which takes half an hour")


def measured(options: argparse.Namespace) -> Iterator[Table | str]:
    """Do what the options say; yield what is to be printed.

    Raises:
        BadInput: the page cannot be written.
        RunFailed: the check over all problems has failed.
    """
    if options.make:
        from bench.benchmarks.rmpc.making import made

        save(made(lambda line: print(line, file=sys.stderr)), FILE)  # noqa: T201 - progress
        return
    if options.write:
        check_suffix(options.write, ".md")
        check_directory(options.write)
    problems = load()
    lines = list(verdict(solved(OURS, problems))) if options.all else []
    yield from lines
    found = []
    for sheet in sheets(problems, len(problems) if options.all else SAMPLE):
        found.append(sheet)
        yield sheet if isinstance(sheet, str) else sheet.table()
    if options.write:
        write_text(options.write, page(problems, found, lines, settings(1.0, independent=True).solver_tolerance))
    if lines and lines[-1] != PASSED:
        raise RunFailed(f"the check over all problems: {lines[-1]}")
