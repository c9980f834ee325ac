"""The commands `platoon log ...`: logs exchanged with other tools.

What a command needs is imported inside it, so that help does not wait for the rest.
"""

import json
import os
import sys
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bench.errors import BadInput

if TYPE_CHECKING:
    from bench.record.exchange import Format

log_app = typer.Typer(help="Logs exchanged with other tools.", no_args_is_help=True)


class FormatName(StrEnum):
    """A format of other tools' logs; python-can, which reads and writes them, is loaded later."""

    CANDUMP = "candump"
    ASC = "asc"
    BLF = "blf"
    MF4 = "mf4"


@log_app.command(epilog="Exit codes: 0 done, 2 bad input.")
def export(
    log: Annotated[Path, typer.Argument(metavar="RUN.mcap", help="The log of a run.")],
    kind: Annotated[
        FormatName | None, typer.Option("--format", help="The format; as the name after -o says, if not given.")
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="The file; beside the log if not given.")] = None,
    bus: Annotated[list[str] | None, typer.Option(metavar="BUS", help="Only this bus: veh1; may be repeated.")] = None,
) -> None:
    """Write a log's frames as candump (.log), Vector ASC or BLF, or ASAM MDF 4 (.mf4), for other tools.

    Identifiers, data, order and times (simulated, from 0) come back exactly with `platoon log import`.
    """
    from bench.record.exchange import export_log

    if kind is None and out is None:
        raise BadInput(f"give --format ({', '.join(FormatName)}) or -o FILE")
    chosen = _format(kind, out)
    target = out or log.with_suffix(chosen.suffix)
    done = export_log(_readable(log), target, chosen, bus or ())
    channels = ", ".join(f"{number} = {name}" for name, number in done.channels.items() if number != name)
    typer.echo(f"{target}: {done.frames} frames{f', channels {channels}' if channels else ''}")
    _show(done.notes)


@log_app.command(name="import", epilog="Exit codes: 0 done, 2 bad input.")
def import_(
    files: Annotated[list[Path], typer.Argument(metavar="FILE...", help="What to import; all go into one log.")],
    out: Annotated[Path, typer.Option("--out", "-o", metavar="RUN.mcap", help="The log to make.")],
    kind: Annotated[
        FormatName | None, typer.Option("--format", help="The files' format; as their names say, if not given.")
    ] = None,
    bus: Annotated[
        list[str] | None,
        typer.Option(metavar="CHANNEL=BUS", help="Name a channel: 1=veh1, can0=v2v; may be repeated."),
    ] = None,
    dbc: Annotated[
        list[str] | None,
        typer.Option(
            metavar="[BUS=]FILE",
            help="A DBC to decode with, for all buses or one; v2v and veh1, veh2 ... have the bench's own.",
        ),
    ] = None,
) -> None:
    """Make a log of the frames in candump (-L), ASC, BLF or MDF 4 files, with signals decoded where a DBC is known."""
    from bench.record.exchange import import_logs

    buses = {}
    for given in bus or []:
        channel, _, name = given.partition("=")
        if not (channel and name):
            raise BadInput(f"--bus {given}: want CHANNEL=BUS, for example 1=veh1")
        buses[channel] = name
    chosen = _format(kind, None) if kind else None
    done = import_logs(files, out, kind=chosen, buses=buses, dbc=dbc or (), command_line=["platoon", *sys.argv[1:]])
    typer.echo(f"{out}: {', '.join(f'{count} frames on {name}' for name, count in done.frames.items())}")
    _show(done.notes)


@log_app.command(epilog="Exit codes: 0 done, 2 bad input.")
def layout(
    log: Annotated[
        Path | None, typer.Argument(metavar="[RUN.mcap]", help="For as many vehicles as this log has; else three.")
    ] = None,
) -> None:
    """Print a layout to import in Foxglove or Lichtblick: road, speeds, yaw rates, states, events.

    For example: platoon log layout RUN.mcap > platoon.json
    """
    from bench.record.foxglove_layout import layout as made_for
    from bench.record.reader import Run

    vehicles = 3 if log is None else Run(_readable(log)).vehicles
    typer.echo(json.dumps(made_for(vehicles), indent=1))


def _format(kind: FormatName | None, out: Path | None) -> "Format":
    from bench.record.exchange import Format

    if kind is not None:
        return Format(kind.value)
    return Format.of(out or Path())


def _show(notes: tuple[str, ...]) -> None:
    for note in notes:
        typer.echo(f"platoon: {note}", err=True)


def _readable(log: Path) -> Path:
    if not log.is_file():
        raise BadInput(f"{log} is {'a directory' if log.is_dir() else 'not there'}; give a log, a .mcap file")
    if not os.access(log, os.R_OK):
        raise BadInput(f"{log} cannot be read: no permission")
    return log
