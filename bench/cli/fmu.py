"""The commands `platoon fmu ...`: builds, checks and describes the vehicle's FMU.

What a command needs is imported inside it, so that help does not wait for the rest.
"""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bench.cli.help import App
from bench.cli.output import message, say_json
from bench.errors import BadInput
from platoon_fmu.errors import FmuError, UnknownPlatform

if TYPE_CHECKING:
    from platoon_fmu.build import Step

fmu_app = App(help="The vehicle FMU: build, check, describe, validate.")


class Fmi(StrEnum):
    """A version of the FMI standard."""

    TWO = "2"
    THREE = "3"
    ALL = "all"


@fmu_app.command()
def build(
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", help="The directory; build/ if not given (not in a checkout: your cache)."),
    ] = None,
    fmi: Annotated[Fmi, typer.Option(help="Version: 2 gives Vehicle.fmu, 3 gives Vehicle_FMI3.fmu.")] = Fmi.ALL,
    platform: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME", help="Platform of a binary: native (if not given), all, x86_64-linux, ...; may be repeated."
        ),
    ] = None,
) -> None:
    """Build the vehicle's FMUs: generate the model's C code, compile it and pack it."""
    from platoon_fmu import build as builder
    from platoon_fmu.compilers import NATIVE, PLATFORMS
    from platoon_fmu.versions import FMI2, FMI3

    directory = out or builder.default_directory()
    wanted = [name for given in platform or [NATIVE] for name in (PLATFORMS if given == "all" else [given])]
    for version in (FMI2, FMI3):
        if fmi in (Fmi.ALL, version.name):
            try:
                with _showing_steps() as on_step:
                    fmu = builder.build(directory, version=version, platforms=wanted, on_step=on_step)
            except UnknownPlatform as error:
                raise BadInput(f"--platform: {error}, all") from error
            except OSError as error:
                raise BadInput(f"{directory}: the FMU cannot be written there: {error.strerror}") from error
            typer.echo(str(fmu))


@contextmanager
def _showing_steps() -> Iterator[Callable[["Step"], None]]:
    """Show a build's steps on standard error: a bar on a terminal, elsewhere a line each."""
    if not sys.stderr.isatty():
        yield lambda step: typer.echo(f"{step.text} ...", err=True)
        return
    from rich.progress import BarColumn, SpinnerColumn, TextColumn, TimeElapsedColumn

    from bench.cli.terminal import progress

    columns = (SpinnerColumn(), BarColumn(20), TimeElapsedColumn(), TextColumn("{task.description}"))
    with progress(*columns, transient=True) as bars:
        task = bars.add_task("", total=None, visible=False)
        yield lambda step: bars.update(task, description=step.text, completed=step.done, total=step.total, visible=True)


@fmu_app.command(epilog="Exit codes: 0 no problems, 1 problems found, 2 bad file.")
def validate(
    fmu: Annotated[Path | None, typer.Argument(help="The FMU; the bench's own if not given.")] = None,
) -> None:
    """Check any FMU against the standard, and exercise the capabilities that it declares."""
    from bench.cli.fmu_table import show_check
    from platoon_fmu.checks.findings import Outcome
    from platoon_fmu.checks.validate import validate as checks_of

    path = fmu or vehicle_fmu()
    outcomes = []
    try:
        for check in checks_of(path):
            show_check(check)
            outcomes.append(check.outcome)
    except FmuError as error:
        raise BadInput(str(error)) from error
    passed, skipped, problems = (outcomes.count(o) for o in (Outcome.PASSED, Outcome.SKIPPED, Outcome.PROBLEM))
    found = f"{problems or 'no'} {'problem' if problems == 1 else 'problems'} found"
    typer.echo(f"{path}: {found} ({passed} {'check' if passed == 1 else 'checks'} passed, {skipped} skipped)")
    if problems:
        raise typer.Exit(1)


@fmu_app.command(epilog="Exit codes: 0 done, 2 bad file.")
def info(
    fmu: Annotated[Path | None, typer.Argument(help="The FMU; the bench's own if not given.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object instead of tables.")] = False,
) -> None:
    """Show any FMU's interface types, capabilities and variables."""
    from platoon_fmu.info import info as info_of

    path = fmu or vehicle_fmu()
    try:
        found = info_of(path)
    except FmuError as error:
        raise BadInput(str(error)) from error
    if as_json:
        say_json(asdict(found), indent=2)
        return
    from bench.cli.fmu_table import show_info

    show_info(found)


@fmu_app.command(epilog="Exit codes: 0 all metrics passed, 1 some failed, 2 bad input.")
def report(
    fmu: Annotated[Path | None, typer.Argument(help="The FMU; the bench's own if not given.")] = None,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="The file; beside the FMU if not given.")] = None,
) -> None:
    """Validate an FMU's physics: drive standard manoeuvres, write the results as one HTML file."""
    from bench.files import check_report, write_text

    path = fmu or vehicle_fmu()
    target = out or path.with_suffix(".html")
    check_report(target)
    from platoon_fmu.physics.report import report as report_of

    try:
        found = report_of(path)
    except FmuError as error:
        raise BadInput(str(error)) from error
    write_text(target, found.page)
    typer.echo(str(target))
    for metric in found.missed:
        typer.echo(message(f"failed: {metric.name}"), err=True)
    if found.missed:
        raise typer.Exit(1)


def vehicle_fmu() -> Path:
    """Return the FMU that the bench drives; if an installed package builds it now, on first use, report that.

    Raises:
        BadInput: there is none, and it cannot be built.
    """
    from platoon_fmu.build import default_fmu

    try:
        return default_fmu(lambda step: say_first_use(step.text))
    except FmuError as error:
        raise BadInput(str(error)) from error


def say_first_use(text: str) -> None:
    """Say what an installed package does only once."""
    typer.echo(message(f"first use: {text} ..."), err=True)
