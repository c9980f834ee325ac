"""The command `platoon resim`: runs ECUs again on their recorded inputs.

What it needs is imported inside it, so that help does not wait for the rest.
"""

import shlex
import sys
from pathlib import Path
from typing import Annotated

import typer

from bench.cli.machine_code import use_machine_code
from bench.cli.output import message
from bench.errors import BadInput
from bench.files import readable_log

EXIT_CODES = (
    "Exit codes: 0 same outputs, 1 different ones, or an ECU never ran or failed, 2 bad input, or no room for -o."
)
STEP_LIMIT_S = 30.0
"""Wall-clock time; even an ECU's first step, in which it may compile, takes far less."""


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
            help="Accept values that differ by at most this: 2 is two steps of each signal's resolution, "
            "SteeringCommand.SteeringAngle=1e-4 is in the signal's unit. States must be equal.",
        ),
    ] = None,
    step_limit: Annotated[
        float,
        typer.Option(metavar="S", help="Give up an ECU whose step takes longer than this, wall-clock time in s."),
    ] = STEP_LIMIT_S,
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="NEW.mcap", help="Write the log that would have resulted."),
    ] = None,
) -> None:
    """Run ECUs again on their recorded inputs and compare their outputs, byte by byte, then signal by signal.

    Examples:
      platoon resim RUN.mcap --all        # after a change of a controller
      platoon resim RUN.mcap --ecu veh2.tracker --class my_ecu.py:MyTracker
    """
    from bench.record.reader import Run
    from bench.resim.fleet import run_all
    from bench.resim.plan import make_plan
    from bench.resim.text import describe

    if not 0.1 <= step_limit <= 3600.0:
        raise BadInput(f"--step-limit {step_limit:g}: give a number of seconds from 0.1 to 3600")
    readable_log(log)
    if out is not None:
        from bench.files import check_new

        check_new(out, ".mcap")
    plan = make_plan(Run(log), ecu or (), every=every, classes=spec or (), tolerances=tolerance or ())
    use_machine_code()
    for note in plan.notes:
        typer.echo(message(note), err=True)
    outcomes = []
    for outcome in run_all(plan.jobs, step_limit):
        if outcome.bad_input:
            raise BadInput(outcome.error)
        typer.echo(describe(outcome, plan.codecs))
        outcomes.append(outcome)
    failed = [outcome.name for outcome in outcomes if outcome.failed]
    if out is not None and failed:
        # It would mix recorded frames with new ones.
        typer.echo(message(f"{out} is not written, as {', '.join(failed)} failed"), err=True)
    elif out is not None:
        from bench.resim.rewrite import write

        write(plan, outcomes, out, shlex.join(["platoon", *sys.argv[1:]]))
        typer.echo(f"log: {out}")
    if not all(outcome.same for outcome in outcomes):
        raise typer.Exit(1)


def add_resim(app: typer.Typer) -> None:
    """Add the command to `platoon`."""
    app.command(epilog=EXIT_CODES)(resim)
