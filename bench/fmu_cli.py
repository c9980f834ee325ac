"""The commands `platoon fmu ...`: the vehicle's FMU built, checked and described.

What a command needs is imported inside it, so that help does not wait for the rest.
"""

from pathlib import Path
from typing import Annotated

import typer

from bench.errors import BadInput
from platoon_fmu.errors import FmuError

fmu_app = typer.Typer(help="The vehicle as an FMU.", no_args_is_help=True)


@fmu_app.command()
def build(
    out: Annotated[Path | None, typer.Option("--out", "-o", help="The directory; build/ if not given.")] = None,
) -> None:
    """Build Vehicle.fmu: generate the model's C code, compile it and pack it."""
    from platoon_fmu import build as builder

    directory = out or builder.default_directory()
    try:
        fmu = builder.build(directory, on_start=lambda: typer.echo("Building the vehicle FMU ...", err=True))
    except OSError as error:
        raise BadInput(f"{directory}: the FMU cannot be put there: {error.strerror}") from error
    typer.echo(str(fmu))


@fmu_app.command()
def validate(
    fmu: Annotated[Path | None, typer.Argument(help="The FMU; the one built here if not given.")] = None,
) -> None:
    """Check an FMU against the standard and run it for a moment."""
    from platoon_fmu.validate import validate as problems_of

    path = _fmu_path(fmu)
    try:
        problems = problems_of(path)
    except FmuError as error:
        raise BadInput(str(error)) from error
    for problem in problems:
        typer.echo(problem)
    if problems:
        raise typer.Exit(1)
    typer.echo(f"{path}: no problems found")


@fmu_app.command()
def info(fmu: Annotated[Path | None, typer.Argument(help="The FMU; the one built here if not given.")] = None) -> None:
    """List an FMU's variables: name, causality, start value, unit, description."""
    import fmpy

    from platoon_fmu.validate import check_archive

    path = _fmu_path(fmu)
    try:
        check_archive(path)
        description = fmpy.read_model_description(str(path), validate=False)
    except FmuError as error:
        raise BadInput(str(error)) from error
    except Exception as error:
        # What fmpy makes of any other XML file is not to be foreseen.
        raise BadInput(f"{path} is no FMU: its modelDescription.xml cannot be read: {error}") from error
    kinds = [
        name
        for name, kind in (("Model Exchange", description.modelExchange), ("Co-Simulation", description.coSimulation))
        if kind is not None
    ]
    typer.echo(f"{description.modelName}, FMI {description.fmiVersion}, {' and '.join(kinds)}")
    for variable in description.modelVariables:
        start = "" if variable.start is None else str(variable.start)
        unit = variable.unit or (variable.declaredType.unit if variable.declaredType else None) or ""
        typer.echo(f"{variable.name:22} {variable.causality:10} {start:>10} {unit:8} {variable.description or ''}")


def _fmu_path(given: Path | None) -> Path:
    if given is not None:
        if not given.is_file():
            raise BadInput(f"{given}: no such file")
        return given
    from platoon_fmu.build import default_fmu

    try:
        return default_fmu()
    except FmuError as error:
        raise BadInput(str(error)) from error
