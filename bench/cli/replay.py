"""The command `platoon replay`: sends a log's frames again.

What it needs is imported inside it, so that help does not wait for the rest.
"""

import math
import signal
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bench.cli.output import message
from bench.errors import BadInput
from bench.files import readable_log

if TYPE_CHECKING:
    from bench.replay.player import Played

EXIT_CODES = "Exit codes: 0 all frames were sent, 1 some were not, or Ctrl-C ended it, 2 bad input."


def replay(
    log: Annotated[Path, typer.Argument(metavar="RUN.mcap", help="The log of a run.")],
    can: Annotated[
        list[str] | None,
        typer.Option(
            metavar="[BUS=]udp|vcan|IFACE:CHANNEL",
            help="Where the buses are, as for `platoon run`; udp on free ports if not given.",
        ),
    ] = None,
    speed: Annotated[
        str,
        typer.Option(
            metavar="FACTOR|max", help="1 for real time, 10 for ten times as fast, max for as fast as the bus accepts."
        ),
    ] = "1",
    only: Annotated[list[str] | None, typer.Option(metavar="BUS", help="Only this bus; may be repeated.")] = None,
    without: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ECU",
            help="Exclude this participant's frames, because a real one sends them: veh2.tracker; may be repeated.",
        ),
    ] = None,
    start_s: Annotated[float | None, typer.Option("--from", metavar="S", help="Start at this time of the log.")] = None,
    end_s: Annotated[float | None, typer.Option("--to", metavar="S", help="End before this time of the log.")] = None,
) -> None:
    """Send a log's frames again, each at its time on the wire, as a restbus for a real ECU, candump or SavvyCAN.

    Example:
      platoon replay RUN.mcap --can vcan --without veh2.tracker
    """
    from bench.bus.link.address import Address, bus_number, settle
    from bench.bus.link.opening import open_link
    from bench.record.reader import Run
    from bench.replay.order import in_order
    from bench.replay.player import play
    from bench.replay.selection import Selection

    factor = _factor(speed)
    address = Address.parse(*(can or ()))
    if address.hub is not None:
        raise BadInput("--can direct: nobody else could see the frames; allowed: udp, udp:PORT, vcan, IFACE:CHANNEL")
    run = Run(readable_log(log))
    for bus, place in address.own:
        if bus not in run.buses:
            raise BadInput(f"--can {bus}={place}: {log} has the buses {', '.join(run.buses) or '(none)'}")
    chosen = Selection.of(run, only or (), without or ())
    vehicles = max([1, *(_number(bus) for bus in chosen.buses), *(bus_number(bus) for bus, _ in address.own)])
    with ExitStack() as stack:
        settled = stack.enter_context(settle(address, vehicles))
        links = {bus: stack.enter_context(open_link(bus, settled)) for bus in chosen.buses}
        typer.echo(", ".join(f"{bus} on {settled.place_of(bus)}" for bus in links))
        if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
            # A shell makes background jobs ignore SIGINT; whoever sends it explicitly means it.
            signal.signal(signal.SIGINT, signal.default_int_handler)
        frames = (frame for frame in run.frames(start_s=start_s, end_s=end_s) if chosen.has(frame.bus, frame.can_id))
        played = play(in_order(frames), links, factor)
    if not (played.sent_frames or played.failed or played.interrupted):
        raise BadInput(f"{log} has no such frames in that time; see --from, --to, --only and --without")
    _show(played)
    if played.failed or played.interrupted:
        raise typer.Exit(1)


def add_replay(app: typer.Typer) -> None:
    """Add the command to `platoon`."""
    app.command(epilog=EXIT_CODES)(replay)


def _factor(text: str) -> float:
    try:
        factor = math.inf if text == "max" else float(text)
    except ValueError:
        factor = math.nan
    if text != "max" and not (math.isfinite(factor) and 0.001 <= factor <= 1000.0):
        raise BadInput(f"--speed {text}: give a number from 0.001 to 1000, or max")
    return factor


def _number(bus: str) -> int:
    """Return the number of a bus of the log.

    Raises:
        BadInput: a bench has no such bus.
    """
    from bench.bus.link.address import bus_number

    try:
        return bus_number(bus)
    except BadInput as error:
        raise BadInput(f"{error}; was the log made elsewhere? import it with --bus {bus}=veh1") from None


def _show(played: "Played") -> None:
    counts = ", ".join(f"{count} on {bus}" for bus, count in played.sent.items())
    typer.echo(f"{played.sent_frames} frames sent in {played.duration_s:.2f} s ({counts})")
    late = played.lateness
    if late.frames:
        p50, p99 = (late.quantile_ns(share) / 1e6 for share in (0.5, 0.99))
        typer.echo(f"late by p50 {p50:.3g} ms, p99 {p99:.3g} ms, at most {late.largest_ns / 1e6:.3g} ms")
    if played.failed:
        counts = ", ".join(f"{count} on {bus}" for bus, count in played.failed.items())
        typer.echo(message(f"frames that could not be sent: {counts}; {played.reason}"), err=True)
    if played.interrupted:
        typer.echo("platoon: ended by Ctrl-C", err=True)
