"""The command `platoon`; its exit codes are in `EXIT_CODES`.

What a command needs is imported inside it, so that help and the start of a run do not wait for the rest.
"""

import errno
import json
import os
import sys
import warnings
from contextlib import ExitStack
from datetime import datetime
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bench.cli.fmu import fmu_app, say_first_use, vehicle_fmu
from bench.cli.log import log_app
from bench.cli.replay import add_replay
from bench.cli.resim import add_resim
from bench.errors import BadInput, BenchError
from bench.files import check_directory, check_new, check_report, readable_log
from platoon_fmu.errors import FmuError

if TYPE_CHECKING:
    from contextlib import AbstractContextManager

    from bench.live.session import LiveSession

LOGS = Path("logs")
"""Where runs land if not told otherwise, in the working directory."""

EXIT_CODES = "Exit codes: 0 done, 1 the run failed, formed no platoon or had vehicles too near each other, 2 bad input."

app = typer.Typer(
    name="platoon",
    help="A bench for cooperative vehicle control: a vehicle FMU, ECUs on CAN, MCAP logs.",
    epilog=EXIT_CODES,
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
)
app.add_typer(fmu_app, name="fmu")
app.add_typer(log_app, name="log")
add_replay(app)
add_resim(app)


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
    """Take the options that go before a command."""


class Role(StrEnum):
    """What an ECU is for."""

    PLANNER = "planner"
    TRACKER = "tracker"


Log = Annotated[Path, typer.Argument(metavar="RUN.mcap", help="The log of a run.")]
ScenarioName = Annotated[
    str, typer.Argument(metavar="SCENARIO", help="The name of a shipped scenario, or a TOML file.")
]
Buses = Annotated[
    list[str] | None,
    typer.Option(
        "--can",
        metavar="[BUS=]udp|vcan|direct|IFACE:CHANNEL",
        help="Where the CAN buses are, all or, with BUS= before it, one: udp (multicast on this host; udp:PORT for "
        "fixed ports; udp:PORT@DEVICE to reach other hosts), vcan (SocketCAN vcan0, vcan1 ...), direct (all in one "
        "process), or any python-can interface. udp if not given.",
        show_default=False,
    ),
]
Overrides = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Override a key of the scenario: --set vehicles.0.x_m=5.0"),
]
Seed = Annotated[int | None, typer.Option(help="Override the scenario's seed.")]


@app.command(epilog=EXIT_CODES)
def run(
    scenario: ScenarioName = "formation",
    can: Buses = None,
    clock: Annotated[
        str,
        typer.Option(
            metavar="lockstep|realtime",
            help="lockstep: simulated time, as fast as the machine goes; realtime: the wall clock.",
        ),
    ] = "lockstep",
    overrides: Overrides = None,
    seed: Seed = None,
    out: Annotated[Path | None, typer.Option(help="The log to write; logs/SCENARIO-TIME.mcap if not given.")] = None,
    no_report: Annotated[bool, typer.Option("--no-report", help="Write no report beside the log.")] = False,
    ecu: Annotated[
        list[str] | None,
        typer.Option(metavar="ROLE=CLASS", help="Another ECU class: --ecu tracker=my_ecu.py:MyTracker"),
    ] = None,
    without: Annotated[
        list[str] | None,
        typer.Option(metavar="ECU", help="Leave a seat free for an ECU that you start by hand: --without veh1.tracker"),
    ] = None,
    wait: Annotated[
        float, typer.Option(metavar="SECONDS", min=0, help="How long to wait for the ECUs of --without.")
    ] = 120.0,
    live: Annotated[bool, typer.Option("--live", help="Serve the report's page, and Foxglove, while it runs.")] = False,
    live_address: Annotated[
        str | None,
        typer.Option(
            metavar="HOST:PORT",
            help="Where --live listens, Foxglove on the port after it; a free port of 127.0.0.1 if not given.",
        ),
    ] = None,
) -> None:
    """Run a scenario: write its log and report, show what came of it."""
    from bench.bus.link.address import Address
    from bench.scenario import load

    if clock not in ("lockstep", "realtime"):
        raise BadInput(f"--clock {clock}: no such clock; allowed: lockstep, realtime")
    loaded = load(scenario, overrides or (), seed)
    address = Address.parse(*(can or loaded.bus_texts))
    ecus = _ecu_classes(ecu or [])
    log = _log_path(out, loaded.name, with_report=not no_report)
    fmu = _prepared_fmu()

    with ExitStack() as stack:
        session = stack.enter_context(_live(log, live_address)) if live or live_address else None
        from bench.cli.summary import following, show_metrics, show_timing
        from bench.conductor import run as conductor

        if session is not None:
            typer.echo(session.served())
        on_progress = stack.enter_context(following(loaded.name, loaded.duration_s))

        def tell(time_s: float) -> None:
            on_progress(time_s)
            if session is not None:
                session.check()

        result = conductor.run(
            loaded,
            address=address,
            out=log,
            command_line=["platoon", *sys.argv[1:]],
            on_progress=tell,
            ecus=ecus,
            without=without or (),
            without_wait_s=wait,
            on_waiting=_warn,
            fmu=fmu,
            realtime=clock == "realtime",
        )

    from bench.analysis.metrics import compute
    from bench.analysis.requirements import LEAST_DISTANCE_M
    from bench.analysis.timing import timing
    from bench.record.reader import Run

    recorded = Run(result.path)
    figures = compute(recorded)
    show_metrics(figures)
    times = timing(recorded)
    if times is not None:
        show_timing(times, result.scheduling)
    typer.echo(f"log:    {result.path}")
    if not no_report:
        from bench.analysis.report import write

        report = _report_path(result.path)
        write(recorded, report)
        typer.echo(f"report: {report}")
    failures = []
    if figures.formation_time_s is None:
        failures.append(f"did not form a platoon in {loaded.duration_s:g} s")
    if figures.least_distance_m is not None and figures.least_distance_m <= LEAST_DISTANCE_M:
        least = f"{figures.least_distance_m:.2f} m of each other, centre to centre"
        failures.append(f"brought vehicles within {least}, where {LEAST_DISTANCE_M:g} m is the least")
    if failures:
        typer.echo(f"platoon: {loaded.name} {' and '.join(failures)}", err=True)
        raise typer.Exit(1)


@app.command()
def metrics(
    log: Log, as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object instead of a table.")] = False
) -> None:
    """Show the figures of a run, computed from its log alone."""
    from bench.analysis.metrics import compute
    from bench.record.reader import Run

    figures = compute(Run(readable_log(log)))
    if as_json:
        typer.echo(json.dumps(figures.as_dict(), indent=2))
        return
    from bench.cli.summary import show_metrics

    show_metrics(figures)


@app.command()
def report(
    log: Log,
    other: Annotated[
        Path | None, typer.Argument(metavar="[OTHER.mcap]", help="The log of a run to lay over it.", show_default=False)
    ] = None,
    out: Annotated[Path | None, typer.Option("--out", "-o", help="The file; beside the log if not given.")] = None,
) -> None:
    """Write a report of a run, or of two laid over each other: one HTML file that needs no network."""
    from bench.analysis.report import write
    from bench.record.reader import Run

    run, second = Run(readable_log(log)), None if other is None else Run(readable_log(other))
    beside = log if other is None else log.with_name(f"{log.stem}-and-{other.stem}.mcap")
    target = out or _report_path(beside)
    check_report(target)
    write(run, target, second)
    typer.echo(str(target))


@app.command()
def live(
    log: Log,
    address: Annotated[
        str, typer.Option(metavar="HOST:PORT", help="Where to listen, for Foxglove on the port after it.")
    ] = "127.0.0.1:0",
) -> None:
    """Serve a log's page in the way of `run --live`, also while another bench writes it, until Ctrl-C."""
    from bench.live.address import LiveAddress
    from bench.live.session import check_available

    where = LiveAddress.parse(address)
    check_available()
    from bench.live.alone import serve_alone

    serve_alone(readable_log(log), where, typer.echo)


@app.command(epilog="Exit codes: 0 the same frames, 1 different ones, 2 bad input.")
def diff(
    a: Annotated[Path, typer.Argument(metavar="A.mcap", help="The log of a run.")],
    b: Annotated[Path, typer.Argument(metavar="B.mcap", help="The log to compare it with.")],
    plot: Annotated[
        Path | None,
        typer.Option(metavar="F.html", help="Draw what differs, and both runs over each other, as one page."),
    ] = None,
) -> None:
    """Compare the frames of two runs, leaving out only messages that carry wall-clock figures."""
    from bench.record.compare import diff as compare

    logs = readable_log(a), readable_log(b)
    if plot is not None:
        from bench.analysis.report import check_drawable
        from bench.record.reader import Run

        check_report(plot)
        runs = [Run(log) for log in logs]
        for run in runs:
            check_drawable(run)
    difference = compare(*logs)
    typer.echo(str(difference))
    if plot is not None:
        from bench.analysis.differences import MAX_SIGNALS
        from bench.analysis.report import write

        write(runs[0], plot, runs[1], difference.signals)
        some = f", of the first {MAX_SIGNALS} signals" if len(difference.signals) > MAX_SIGNALS else ""
        typer.echo(f"plot:   {plot}{some}")
    raise typer.Exit(0 if difference.same else 1)


@app.command()
def scenarios(
    name: Annotated[
        str | None, typer.Argument(metavar="[NAME]", help="Print this one, to begin one's own from.")
    ] = None,
) -> None:
    """List the shipped scenarios, or print one of them."""
    from bench.scenario import SCENARIO_DIR, load, shipped

    if name is None:
        names = shipped()
        width = max(map(len, names))
        for each in names:
            typer.echo(f"{each:{width}}  {load(each).description}")
        return
    if name not in shipped():
        raise BadInput(f"No scenario {name!r}; shipped are {', '.join(shipped())}.")
    typer.echo((SCENARIO_DIR / f"{name}.toml").read_text(encoding="utf-8"), nl=False)


@app.command()
def ecu(
    role: Annotated[Role, typer.Argument(help="Which of a vehicle's ECUs.")],
    vehicle: Annotated[int, typer.Option(min=1, help="The number of the vehicle, from 1.")],
    can: Annotated[
        list[str],
        typer.Option(metavar="[BUS=]udp:PORT|vcan|IFACE:CHANNEL", help="The buses, as the run has them: all, or each."),
    ],
    scenario: Annotated[str, typer.Option(help="The scenario, as the run has it.")] = "formation",
    overrides: Overrides = None,
    seed: Seed = None,
    spec: Annotated[
        str | None,
        typer.Option("--class", metavar="CLASS", help="Another class: my_ecu.py:MyTracker, my.module:MyTracker"),
    ] = None,
) -> None:
    """Run one ECU alone, for example on another host; start the run with `--without veh1.tracker`."""
    from bench.bus.link.address import Address
    from bench.ecu.main import DEFAULT_ECUS, serve_ecu
    from bench.scenario import load

    loaded = load(scenario, overrides or (), seed)
    address = Address.parse(*can)
    if address.hub is not None:
        raise BadInput("--can direct: an ECU alone is a process of its own; allowed: udp:PORT, vcan, IFACE:CHANNEL")
    serve_ecu(None, spec or DEFAULT_ECUS[role], role, vehicle, loaded, address)


@app.command()
def fault(
    kind: Annotated[
        str | None, typer.Argument(metavar="[KIND]", help="What goes wrong; all kinds are listed if not given.")
    ] = None,
    keys: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[KEY=VALUE]...", help="To what, and how: ecu=veh2.tracker, for_s=1.0; as in [[faults]]."
        ),
    ] = None,
    run: Annotated[str | None, typer.Option(help="Part of the name of the bench, where several are running.")] = None,
) -> None:
    """Bring a fault to a bench that is running.

    For example: platoon fault ecu_crash ecu=veh2.tracker for_s=1.0
    """
    from bench.cli.fault_words import describe_kinds, parse
    from bench.conductor.fault_desk import ask

    if kind is None:
        typer.echo(describe_kinds(), nl=False)
        return
    answer = ask(run, parse(kind, keys or []))
    typer.echo(f"{kind} at {answer['at_s']:g} s")


@app.command(
    epilog="Exit code: the command's own, 128 + n where signal n ended it; 2 where there is no CAN to be had.",
    context_settings={"ignore_unknown_options": True, "allow_interspersed_args": False},
)
def vcan(
    command: Annotated[list[str], typer.Argument(metavar="[--] COMMAND...", help="Any command with its arguments.")],
    memory: Annotated[int, typer.Option(metavar="MB", help="The most memory that the small kernel may take.")] = 2048,
) -> None:
    """Run a command where the CAN links vcan0 to vcan16 are, also on a machine whose kernel has no CAN.

    Where this kernel has the links, or lets you make them, the command runs here, and the links stay. Elsewhere it runs
    in user-mode Linux, a kernel that is an ordinary program: one core, this machine's files, your rights on them. What
    the command leaves running ends with it there.
    """
    from bench.vcan.run import run_command

    raise typer.Exit(run_command(command, memory))


@app.command()
def doctor() -> None:
    """Tell what this machine can do, and what to type for the rest. Exit code 1 where no run would work."""
    from bench.cli.doctor import examine

    can_run = True
    for finding in examine(LOGS):
        mark = typer.style("ok     ", fg="green") if finding.fine else typer.style("missing", fg="yellow")
        typer.echo(f"{mark}  {finding.subject:14}  {finding.found}")
        if not finding.fine:
            for line in finding.mend.splitlines():
                typer.echo(f"{'':25}> {line.strip()}")
        can_run &= finding.fine or not finding.needed
    raise typer.Exit(0 if can_run else 1)


def main() -> None:
    """Run the command; show what went wrong as one message."""
    # Before numpy is loaded: on matrices of three rows its threads only stand in each other's way.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    warnings.formatwarning = lambda message, *_args, **_rest: f"platoon: {message}\n"
    try:
        app()
    except (BenchError, FmuError) as error:
        typer.echo(f"platoon: {error}", err=True)
        sys.exit(error.exit_code if isinstance(error, BenchError) else 1)
    except OSError as error:
        # Asking whether a file is there already fails on this; of all that can be wrong with a name only on this.
        if error.errno != errno.ENAMETOOLONG:
            raise
        typer.echo(f"platoon: {str(error.filename)[:60]}...: {error.strerror}", err=True)
        sys.exit(BadInput.exit_code)


def _live(log: Path, address: str | None) -> "AbstractContextManager[LiveSession]":
    """Serve a log while the context lasts.

    Raises:
        BadInput: not an address, or the packages for it are not installed.
    """
    from bench.live.address import DEFAULT, LiveAddress
    from bench.live.session import live

    return live(log, LiveAddress.parse(address or DEFAULT), _warn)


def _prepared_fmu() -> Path:
    """Return the vehicle's FMU, with all compiled that a run needs: of an installed package, it is done here, once.

    Raises:
        BadInput: there is no FMU, and none can be built.
    """
    from platoon_fmu.build import in_checkout

    fmu = vehicle_fmu()
    if not in_checkout():
        from bench.cli.warm_up import warm_up_once

        warm_up_once(fmu.parent, say_first_use)
    return fmu


def _warn(text: str) -> None:
    typer.echo(f"platoon: {text}", err=True)


def _ecu_classes(chosen: list[str]) -> dict[str, str]:
    """Return the class of each role's ECU: the bench's own but for the chosen ones.

    Raises:
        BadInput: not ROLE=CLASS, or no such role.
    """
    from bench.ecu.main import DEFAULT_ECUS

    classes = dict(DEFAULT_ECUS)
    for choice in chosen:
        role, _, spec = choice.partition("=")
        if role not in classes or not spec:
            raise BadInput(f"--ecu {choice}: want ROLE=CLASS with a role of {', '.join(classes)}")
        classes[role] = spec
    return classes


def _log_path(out: Path | None, name: str, *, with_report: bool) -> Path:
    """Return where the log goes, known to be free and writable.

    Raises:
        BadInput: it cannot be written there.
    """
    if out is None:
        if LOGS.exists() and not LOGS.is_dir():
            raise BadInput(f"{LOGS} is a file, where runs should land; name another place with --out")
        check_directory(LOGS / "any" if LOGS.exists() else LOGS)
        LOGS.mkdir(exist_ok=True)
        # With milliseconds, so that runs started together get a log each.
        moment = datetime.now().astimezone().isoformat(timespec="milliseconds")[:23]
        return LOGS / f"{name}-{moment.replace(':', '').replace('T', '-')}.mcap"
    check_new(out, ".mcap", option="--out")
    if with_report:
        check_new(_report_path(out), ".html", option="--out")
    try:
        out.touch(exist_ok=False)
        out.unlink()
    except OSError as error:
        raise BadInput(f"{out} cannot be made: {error.strerror}") from error
    return out


def _report_path(log: Path) -> Path:
    return log.with_suffix(".html")
