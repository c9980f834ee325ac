"""The results of a run, from its log: `platoon metrics`, `report`, `diff`, `live`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bench.cli.options import LiveOrigins, Log, report_path
from bench.cli.output import say_json
from bench.errors import BadInput
from bench.files import check_report, readable_log

if TYPE_CHECKING:
    from bench.analysis.saved_figures import Format


def add_results(app: typer.Typer) -> None:
    """Add the commands to the app."""
    app.command()(metrics)
    app.command()(report)
    app.command(epilog="Exit codes: 0 the same frames, 1 different ones, 2 bad input.")(diff)
    app.command()(live)


def metrics(
    log: Log, as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object instead of a table.")] = False
) -> None:
    """Show the metrics of a run, computed from its log alone."""
    from bench.analysis.metrics import compute
    from bench.record.label import label_of
    from bench.record.reader import Run

    run = Run(readable_log(log))
    figures, label = compute(run), label_of(run)
    if as_json:
        say_json({"label": label, **figures.as_dict()}, indent=2)
        return
    from bench.cli.summary import show_metrics

    show_metrics(figures, label)
    for number in figures.not_numbers:
        typer.echo(str(number))


def report(
    log: Log,
    other: Annotated[
        Path | None, typer.Argument(metavar="OTHER.mcap", help="The log of a run to overlay.", show_default=False)
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="The file; beside the log if not given.")] = None,
    figures: Annotated[
        Path | None,
        typer.Option("--save-figures", metavar="DIR", help="Also save each figure to a file in this folder."),
    ] = None,
    formats: Annotated[
        list[str] | None,
        typer.Option(
            "--format", metavar="svg|png|csv", help="What --save-figures writes: svg if not given; repeatable."
        ),
    ] = None,
) -> None:
    """Write the report of a run, or of two overlaid: one HTML file that works offline."""
    from bench.analysis.report import write
    from bench.record.reader import Run

    run, second = Run(readable_log(log)), None if other is None else Run(readable_log(other))
    beside = log if other is None else log.with_name(f"{log.stem}-and-{other.stem}.mcap")
    target = out or report_path(beside)
    check_report(target)
    if formats and figures is None:
        raise BadInput("--format is of --save-figures DIR, which is not given")
    kinds = [_format(each) for each in formats or ["svg"]]
    if figures is not None:
        from bench.analysis.saved_figures import check_savable

        check_savable(figures, kinds)
    write(run, target, second)
    typer.echo(str(target))
    if figures is not None:
        from bench.analysis.report import data_of
        from bench.analysis.saved_figures import save_figures

        saved = save_figures(data_of(run, second), figures, kinds)
        typer.echo(f"{len(saved)} figures in {figures}")


def _format(text: str) -> "Format":
    """Return a format of figures.

    Raises:
        BadInput: there is no such format.
    """
    from bench.analysis.saved_figures import Format

    if text not in set(Format):
        raise BadInput(f"--format {text}: no such format of figures; allowed: {', '.join(Format)}")
    return Format(text)


def diff(
    a: Annotated[Path, typer.Argument(metavar="A.mcap", help="The log of a run.")],
    b: Annotated[Path, typer.Argument(metavar="B.mcap", help="The log to compare it with.")],
    plot: Annotated[
        Path | None,
        typer.Option(metavar="F.html", help="Write a page that plots what differs and overlays both runs."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object instead of text.")] = False,
) -> None:
    """Compare two runs: what they were started with, then their frames, but those that carry wall-clock times."""
    from bench.record.compare import diff as compare
    from bench.record.reader import Run
    from bench.record.settings import compare_settings

    # Each is opened once, since opening a damaged log warns.
    runs = [Run(log) for log in (readable_log(a), readable_log(b))]
    if plot is not None:
        from bench.analysis.report import check_drawable

        check_report(plot)
        for run in runs:
            check_drawable(run)
    difference = compare(runs[0], runs[1])
    settings = compare_settings(runs[0], runs[1])
    if as_json:
        say_json({"settings": settings.as_dict(), "frames": difference.as_dict()}, indent=2)
    else:
        if settings.comparable:
            typer.echo(f"{settings}\n")
        typer.echo(str(difference))
    if plot is not None:
        from bench.analysis.differences import MAX_SIGNALS
        from bench.analysis.report import write

        write(runs[0], plot, runs[1], difference.signals)
        some = f", of the first {MAX_SIGNALS} signals" if len(difference.signals) > MAX_SIGNALS else ""
        typer.echo(f"plot:   {plot}{some}", err=as_json)
    raise typer.Exit(0 if difference.same else 1)


def live(
    log: Log,
    address: Annotated[
        str, typer.Option(metavar="HOST:PORT", help="Where to listen, for Foxglove on the port after it.")
    ] = "127.0.0.1:0",
    origin: LiveOrigins = None,
) -> None:
    """Serve a log's page as `run --live` does, even while it is being written, until Ctrl-C."""
    from bench.live.address import LiveAddress
    from bench.live.session import check_available

    where = LiveAddress.parse(address, origin or ())
    check_available()
    from bench.live.alone import serve_alone

    serve_alone(readable_log(log), where, typer.echo)
