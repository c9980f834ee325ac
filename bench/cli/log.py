"""The commands `platoon log ...`: inspects logs and exchanges them with other tools.

What a command needs is imported inside it, so that help does not wait for the rest.
"""

import sys
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bench.cli.help import App
from bench.cli.output import message, one_line, say_json, say_table, shown
from bench.errors import BadInput
from bench.files import readable_log

if TYPE_CHECKING:
    from bench.record.exchange import Format
    from bench.record.overview import Noticed, Output

log_app = App(help="Inspect logs, exchange them with other tools, recover damaged ones.")


class FormatName(StrEnum):
    """A log format of other tools; python-can, which reads and writes it, is loaded later."""

    CANDUMP = "candump"
    ASC = "asc"
    BLF = "blf"
    MF4 = "mf4"


class ExportName(StrEnum):
    """A format to export to: frames as a log of another tool, or signals or events as a table."""

    CANDUMP = "candump"
    ASC = "asc"
    BLF = "blf"
    MF4 = "mf4"
    CSV = "csv"
    PARQUET = "parquet"
    JSON = "json"


_TABLES = (ExportName.CSV, ExportName.PARQUET)
_EVENTS = (*_TABLES, ExportName.JSON)


@log_app.command(epilog="Exit codes: 0 done, 2 bad input.")
def info(
    log: Annotated[Path, typer.Argument(metavar="RUN.mcap", help="A log; it may still be being written.")],
    as_json: Annotated[bool, typer.Option("--json", help="As JSON.")] = False,
) -> None:
    """Show what a log is: times, result, buses with frames and rates, attachments, damage."""
    from dataclasses import asdict

    from bench.record.overview import overview
    from bench.record.reader import Run

    found = overview(Run(readable_log(log)))
    if as_json:
        say_json(asdict(found), indent=1)
        return
    is_empty = found.start_s is None or found.end_s is None
    rows = [
        ("log", f"{found.path}, {found.bytes / 1e6:.3g} MB"),
        ("time", "no message" if is_empty else f"{found.start_s:.9g} s to {found.end_s:.9g} s"),
        *([("status", found.status)] if found.status and "status" not in found.metadata else []),
        *((key, value) for key, value in found.metadata.items() if value),
        *((f"bus {bus.name}", _rate(bus.messages, "frames", bus.per_s)) for bus in found.buses),
        ("topics", f"{len(found.topics)} beside frames, with {found.signals} signals: platoon log signals {log}"),
        ("events", ", ".join(f"{count} {level}" for level, count in found.events.items()) or "none"),
        *((f"causes {ecu}", ", ".join(map(_noticed, causes))) for ecu, causes in found.causes.items()),
        *((f"output {name}", _output(output)) for name, output in found.outputs.items()),
        (
            "attachments",
            ", ".join(f"{one_line(name)} ({size} bytes)" for name, size in found.attachments.items()) or "none",
        ),
        ("damage", found.damage or "none found"),
    ]
    if found.recovered:
        rows.append(("recovered", f"from {found.recovered.source}"))
        rows.extend(("lost", what) for what in found.recovered.lost)
    lines = [(one_line(title), shown(text)) for title, text in rows]
    width = max(len(title) for title, _ in lines)
    for title, text in lines:
        # Multi-line values, such as a command line, stay in their column.
        typer.echo(f"{title:{width}}  " + text.replace("\n", "\n" + " " * (width + 2)))


@log_app.command(epilog="Exit codes: 0 done, 2 bad input.")
def signals(
    log: Annotated[Path, typer.Argument(metavar="RUN.mcap", help="A log; it may still be being written.")],
    pattern: Annotated[
        str,
        typer.Argument(metavar="PATTERN", help="Patterns: '*.VehicleMotion.*', 'truth.veh1.*'; all if not given."),
    ] = "*",
    ranges: Annotated[
        bool, typer.Option("--ranges", help="Also show the minimum and maximum, which reads all values.")
    ] = False,
) -> None:
    """List signals and ground truth: name, unit, number of values, first and last time."""
    from bench.record.reader import Run

    found = Run(readable_log(log)).signal_table(pattern, ranges=ranges).drop("comment")
    # Numbers are right-aligned, text is left-aligned.
    texts = [[name, *map(_cell, found[name])] for name in found.columns]
    signs = ["<" if name in ("name", "unit") else ">" for name in found.columns]
    say_table(zip(*texts, strict=True), "".join(signs))


@log_app.command(epilog="Exit codes: 0 done, 2 bad input.")
def export(
    log: Annotated[Path, typer.Argument(metavar="RUN.mcap", help="The log of a run.")],
    kind: Annotated[
        ExportName | None, typer.Option("--format", help="The format; taken from the name after -o if not given.")
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="The file; beside the log if not given.")] = None,
    bus: Annotated[
        list[str] | None, typer.Option(metavar="BUS", help="Frames: only this bus: veh1; may be repeated.")
    ] = None,
    signal: Annotated[
        list[str] | None,
        typer.Option(metavar="PATTERN", help="Tables: which signals: 'truth.*.v_x'; may be repeated; else all."),
    ] = None,
    start_s: Annotated[
        float | None, typer.Option("--from", metavar="SECONDS", help="Tables: start at this time.")
    ] = None,
    end_s: Annotated[
        float | None, typer.Option("--to", metavar="SECONDS", help="Tables: end before this time.")
    ] = None,
    every_s: Annotated[
        float | None,
        typer.Option("--every", metavar="SECONDS", help="Tables: a row this often; else one for each value."),
    ] = None,
    labels: Annotated[bool, typer.Option("--labels", help="Tables: states by name instead of number.")] = False,
    events: Annotated[
        bool,
        typer.Option("--events", help="The events instead of frames or signals: csv (the default), parquet, json."),
    ] = False,
) -> None:
    """Write a log's frames for other tools, or its signals or events as a table.

    Frames go to candump (.log), Vector ASC or BLF, or ASAM MDF 4 (.mf4). Identifiers, data, order and times (simulated,
    from 0) come back exactly with `platoon log import`.

    Signals go to CSV or Parquet: a row for each time, a column for each signal, sampled with zero-order hold.

    Events (--events) go to CSV, Parquet or JSON: time, kind, level, vehicle, ECU, text and the named fields of each.
    """
    if events:
        others = {"--bus": bus, "--signal": signal, "--every": every_s, "--labels": labels or None}
        for option, value in others.items():
            if value is not None:
                raise BadInput(f"{option} is not for --events")
        _export_events(log, kind, out, start_s, end_s)
        return
    chosen = kind or _export_format(out)
    if chosen is ExportName.JSON:
        raise BadInput("json is for --events; signals go to csv or parquet")
    for_tables = {"--signal": signal, "--from": start_s, "--to": end_s, "--every": every_s, "--labels": labels or None}
    is_table = chosen in _TABLES
    for option, value in {"--bus": bus}.items() if is_table else for_tables.items():
        if value is not None:
            raise BadInput(f"{option} is for {'frames' if is_table else 'tables: csv, parquet'}, not for {chosen}")
    if not is_table:
        _export_frames(log, FormatName(chosen.value), out, bus or [])
        return
    from bench.record.exchange.tables import TableFormat, export_table

    table = TableFormat(chosen.value)
    target = out or log.with_suffix(table.suffix)
    patterns = signal or ["*"]
    done = export_table(
        readable_log(log), target, table, patterns, start_s=start_s, end_s=end_s, every_s=every_s, labels=labels
    )
    typer.echo(f"{target}: {done.rows} rows of {done.columns} signals")


@log_app.command(name="import", epilog="Exit codes: 0 done, 2 bad input.")
def import_(
    files: Annotated[list[Path], typer.Argument(metavar="FILE...", help="The files to import, all into one log.")],
    out: Annotated[Path, typer.Option("--out", "-o", metavar="RUN.mcap", help="The log to write.")],
    kind: Annotated[
        FormatName | None, typer.Option("--format", help="The files' format; taken from their names if not given.")
    ] = None,
    bus: Annotated[
        list[str] | None,
        typer.Option(metavar="CHANNEL=BUS", help="Name a channel: 1=veh1, can0=v2v; may be repeated."),
    ] = None,
    dbc: Annotated[
        list[str] | None,
        typer.Option(
            metavar="[BUS=]FILE",
            help="A DBC file to decode with, for all buses or one; for v2v, veh1, veh2 ... the bench's own by default.",
        ),
    ] = None,
) -> None:
    """Import the frames of candump (-L), ASC, BLF or MDF 4 files, decoding signals where a DBC is known."""
    from bench.record.exchange import import_logs

    buses = {}
    for given in bus or []:
        channel, _, name = given.partition("=")
        if not (channel and name):
            raise BadInput(f"--bus {given}: write CHANNEL=BUS, for example 1=veh1")
        buses[channel] = name
    chosen = _format(kind, None) if kind else None
    done = import_logs(files, out, kind=chosen, buses=buses, dbc=dbc or (), command_line=["platoon", *sys.argv[1:]])
    typer.echo(f"{out}: {', '.join(f'{count} frames on {name}' for name, count in done.frames.items())}")
    _show(done.notes)


@log_app.command(epilog="Exit codes: 0 nothing was lost, 3 something was, 2 bad input.")
def recover(
    log: Annotated[Path, typer.Argument(metavar="BROKEN.mcap", help="The truncated or damaged log.")],
    out: Annotated[
        Path | None,
        typer.Option("--out", "-o", metavar="CLEAN.mcap", help="The new log; BROKEN-recovered.mcap if not given."),
    ] = None,
) -> None:
    """Write a clean log from everything intact in a damaged one, and report what was lost."""
    from bench.mcap.recover import recover as recovered

    target = out or log.with_name(f"{log.stem}-recovered.mcap")
    done = recovered(readable_log(log), target)
    typer.echo(f"{target}: {done.summary}")
    for what in done.lost:
        typer.echo(f"lost: {what}")
    raise typer.Exit(3 if done.lost else 0)


@log_app.command(epilog="Exit codes: 0 done, 2 bad input.")
def layout(
    log: Annotated[
        Path | None, typer.Argument(metavar="RUN.mcap", help="Use this log's number of vehicles; else three.")
    ] = None,
) -> None:
    """Print a layout to import into Foxglove or Lichtblick: road, speeds, yaw rates, states, events.

    Example:
      platoon log layout RUN.mcap > platoon.json
    """
    from bench.record.foxglove_layout import layout as made_for
    from bench.record.reader import Run

    vehicles = 3 if log is None else Run(readable_log(log)).vehicles
    say_json(made_for(vehicles), indent=1)


def _export_format(out: Path | None) -> ExportName:
    if out is None:
        raise BadInput(
            f"give --format ({', '.join(each for each in ExportName if each is not ExportName.JSON)}) or -o FILE"
        )
    if out.suffix.lower() in [f".{each}" for each in _EVENTS]:
        return ExportName(out.suffix.lower()[1:])
    from bench.record.exchange import Format

    return ExportName(Format.of(out, _TABLES).value)


def _export_frames(log: Path, kind: FormatName, out: Path | None, buses: list[str]) -> None:
    from bench.record.exchange import export_log

    chosen = _format(kind, out)
    target = out or log.with_suffix(chosen.suffix)
    done = export_log(readable_log(log), target, chosen, buses)
    channels = ", ".join(f"{number} = {name}" for name, number in done.channels.items() if number != name)
    typer.echo(f"{target}: {done.frames} frames{f', channels {channels}' if channels else ''}")
    _show(done.notes)


def _export_events(
    log: Path, kind: ExportName | None, out: Path | None, start_s: float | None, end_s: float | None
) -> None:
    from bench.record.exchange.events import EventFormat, export_events

    formats = ", ".join(_EVENTS)
    named = out.suffix.lower().removeprefix(".") if out is not None else ExportName.CSV.value
    chosen = kind.value if kind is not None else named
    if chosen not in _EVENTS:
        raise BadInput(f"--events: {chosen or out} is not one of {formats}; give --format, or -o with that suffix")
    form = EventFormat(chosen)
    target = out or log.with_name(f"{log.stem}-events{form.suffix}")
    count = export_events(readable_log(log), target, form, start_s=start_s, end_s=end_s)
    typer.echo(f"{target}: {count} events")


def _rate(count: int, what: str, per_s: float | None) -> str:
    return f"{count} {what}" + (f", {per_s:.6g} a second" if per_s else "")


def _noticed(cause: "Noticed") -> str:
    times = f" ({cause.times} times)" if cause.times > 1 else ""
    return f"{cause.cause} at {cause.first_s:.2f} s{times}"


def _output(output: "Output") -> str:
    return output.last + (f" ({output.lines} lines)" if output.lines > 1 else "")


def _cell(value: object) -> str:
    if value is None:
        return "-"
    return f"{value:.9g}" if isinstance(value, float) else str(value)


def _format(kind: FormatName | None, out: Path | None) -> "Format":
    from bench.record.exchange import Format

    if kind is not None:
        return Format(kind.value)
    return Format.of(out or Path())


def _show(notes: tuple[str, ...]) -> None:
    for note in notes:
        typer.echo(message(note), err=True)
