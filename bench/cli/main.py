"""The command `platoon`; its exit codes are in `EXIT_CODES`.

What a command needs is imported inside it, so that help and the start of a run do not wait for the rest.
"""

import errno
import gc
import os
import sys
import warnings
from typing import Annotated

import typer

from bench.cli.campaign import campaign_app
from bench.cli.fmu import fmu_app
from bench.cli.help import WIDTH, App, HelpGroup
from bench.cli.log import log_app
from bench.cli.machine import add_machine
from bench.cli.options import EXIT_CODES
from bench.cli.output import GuardedGroup, guard, message
from bench.cli.replay import add_replay
from bench.cli.resim import add_resim
from bench.cli.results import add_results
from bench.cli.run import add_run
from bench.cli.streams import flush, prepare_streams
from bench.conductor.limits import LEAST_FILES, require_files, require_memory
from bench.errors import BadInput, BenchError, shortage
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
app.add_typer(campaign_app, name="campaign")
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
    output = prepare_streams()
    # With `python -m`, or an empty entry in PYTHONPATH, the working directory is on the path.
    sys.path[:] = search_path()
    # Before numpy is loaded: on matrices of three rows threads only slow it down.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # Looking for pydantic's plugins, in all installed packages, takes longer than building a scenario's models.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    warnings.formatwarning = lambda text, *_args, **_rest: f"{message(str(text))}\n"
    # Not undone: the interpreter itself prints the traceback of what nobody expected.
    guard()
    code = _exit_code()
    flush()
    if output.problem is not None:
        _say(f"not all output could be written: {output.problem.strerror}")
        code = code or 1
    # Else the interpreter searches all modules for garbage, a tenth of a second before the process ends anyway.
    gc.freeze()
    sys.exit(code)


def _exit_code() -> int | str | None:
    """Run the command; return its exit code."""
    try:
        require_files(LEAST_FILES)
        require_memory()
        app()
    except SystemExit as ended:
        return ended.code
    except (BenchError, FmuError) as error:
        _say(str(error))
        return error.exit_code if isinstance(error, BenchError) else 1
    except (OSError, MemoryError, RuntimeError) as error:
        lacking = shortage(error)
        if lacking is not None:
            _say(lacking)
            return 1
        # Of all that can be wrong with a file name, only its length makes the check for its existence fail.
        if isinstance(error, OSError) and error.errno == errno.ENAMETOOLONG:
            _say(f"{str(error.filename)[:60]}...: {error.strerror}")
            return BadInput.exit_code
        raise
    return 0


def _say(text: str) -> None:
    typer.echo(message(text), err=True, color=True)
