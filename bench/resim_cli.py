"""The command `platoon resim`: runs ECUs again on what a log says they saw.

What it needs is imported inside it, so that help does not wait for the rest.
"""

import shlex
import sys
from pathlib import Path
from typing import Annotated

import typer

from bench.errors import BadInput
from bench.output_paths import check_directory, check_suffix, readable_log

EXIT_CODES = "Exit codes: 0 they send the same, 1 they do not, or one never ran or failed, 2 bad input."


def resim(
    log: Annotated[Path, typer.Argument(metavar="RUN.mcap", help="The log of a run.")],
    ecu: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="Which ECU: veh2.tracker; may be repeated.")
    ] = None,
    every: Annotated[bool, typer.Option("--all", help="All ECUs of the log.")] = False,
    spec: Annotated[
        list[str] | None,
        typer.Option("--class", metavar="[ROLE=]CLASS", help="Another class: --class tracker=my_ecu.py:MyTracker"),
    ] = None,
    tolerance: Annotated[
        list[str] | None,
        typer.Option(
            metavar="[MESSAGE.SIGNAL=]VALUE",
            help="Take values for the same that differ by at most this: 2 is two steps of each signal's resolution, "
            "SteeringCommand.SteeringAngle=1e-4 is in the signal's unit. States must be the same.",
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="NEW.mcap", help="Write the log as it would be with what they send now."),
    ] = None,
) -> None:
    """Run ECUs again on the frames that they saw, and compare what they send: byte for byte, then signal by signal.

    So a change of a controller is reviewed: platoon resim RUN.mcap --all
    """
    from bench.record.reader import Run
    from bench.resim.fleet import run_all
    from bench.resim.plan import make_plan
    from bench.resim.text import describe

    readable_log(log)
    if out is not None:
        check_suffix(out, ".mcap")
        check_directory(out)
        if out.exists():
            raise BadInput(f"{out} is there already; give another -o, or remove it")
    plan = make_plan(Run(log), ecu or (), every=every, classes=spec or (), tolerances=tolerance or ())
    for note in plan.notes:
        typer.echo(f"platoon: {note}", err=True)
    outcomes = []
    for outcome in run_all(plan.jobs):
        if outcome.bad_input:
            raise BadInput(outcome.error)
        typer.echo(describe(outcome, plan.codecs))
        outcomes.append(outcome)
    if out is not None:
        from bench.resim.rewrite import write

        write(plan, outcomes, out, shlex.join(["platoon", *sys.argv[1:]]))
        typer.echo(f"log: {out}")
    if not all(outcome.same for outcome in outcomes):
        raise typer.Exit(1)


def add_resim(app: typer.Typer) -> None:
    """Add the command to `platoon`."""
    app.command(epilog=EXIT_CODES)(resim)
