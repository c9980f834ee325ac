"""The command `platoon`; its exit codes are in `EXIT_CODES`.

What a command needs is imported inside it, so that help and the start of a run do not wait for the rest.
"""

import errno
import os
import sys
import warnings
from typing import Annotated

import typer

from bench.cli.fmu import fmu_app
from bench.cli.help import WIDTH, App, HelpGroup
from bench.cli.log import log_app
from bench.cli.machine import add_machine
from bench.cli.options import EXIT_CODES
from bench.cli.output import GuardedGroup, guard
from bench.cli.replay import add_replay
from bench.cli.resim import add_resim
from bench.cli.results import add_results
from bench.cli.run import add_run
from bench.errors import BadInput, BenchError
from platoon_fmu.errors import FmuError
from platoon_fmu.interpreter import search_path


class _Platoon(HelpGroup, GuardedGroup):
    """The commands."""


app = App(
    name="platoon",
    cls=_Platoon,
    help="A bench for cooperative vehicle control: a vehicle FMU, ECUs on CAN, MCAP logs.",
    epilog=EXIT_CODES,
    add_completion=False,
    pretty_exceptions_enable=False,
    # Colours in foreign text are shown as escapes in a file as on a terminal, not left out.
    context_settings={"color": True, "max_content_width": WIDTH},
)
add_run(app)
add_results(app)
add_replay(app)
add_resim(app)
add_machine(app)
app.add_typer(log_app, name="log")
app.add_typer(fmu_app, name="fmu")


def _show_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        typer.echo(f"platoon {version('platoon')}")
        raise typer.Exit


@app.callback()
def _options(
    *,
    version: Annotated[
        bool, typer.Option("--version", help="Show the version.", callback=_show_version, is_eager=True)
    ] = False,
) -> None:
    """Take the options before a command."""


def main() -> None:
    """Run the command; show what went wrong as one message."""
    # With `python -m`, or an empty entry in PYTHONPATH, the working directory is on the path.
    sys.path[:] = search_path()
    # Before numpy is loaded: on matrices of three rows threads only slow it down.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    warnings.formatwarning = lambda message, *_args, **_rest: f"platoon: {message}\n"
    # Not undone: the interpreter itself prints the traceback of what nobody expected.
    guard()
    try:
        app()
    except (BenchError, FmuError) as error:
        typer.echo(f"platoon: {error}", err=True, color=True)
        sys.exit(error.exit_code if isinstance(error, BenchError) else 1)
    except OSError as error:
        # Of all that can be wrong with a file name, only its length makes the check for its existence fail.
        if error.errno != errno.ENAMETOOLONG:
            raise
        typer.echo(f"platoon: {str(error.filename)[:60]}...: {error.strerror}", err=True, color=True)
        sys.exit(BadInput.exit_code)
