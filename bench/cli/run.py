"""`platoon run` and what belongs to it: scenarios, single ECUs, faults in a running bench."""

import gc
import sys
from collections.abc import Mapping
from contextlib import ExitStack
from datetime import datetime
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bench.cli.fmu import vehicle_fmu
from bench.cli.machine_code import use_machine_code
from bench.cli.options import EXIT_CODES, LOGS, Buses, LiveOrigins, Overrides, ScenarioName, Seed, report_path
from bench.cli.output import message
from bench.errors import BadInput
from bench.files import already_exists, check_directory, check_new
from bench.label import checked_label

if TYPE_CHECKING:
    from contextlib import AbstractContextManager

    from bench.analysis.metrics import Metrics
    from bench.conductor.fork_server_process import ForkServer
    from bench.live.session import LiveSession
    from bench.scenario import Scenario


class Role(StrEnum):
    """What an ECU is for."""

    PLANNER = "planner"
    TRACKER = "tracker"


def add_run(app: typer.Typer) -> None:
    """Add the commands to the app."""
    app.command(epilog=EXIT_CODES)(run)
    app.command()(scenarios)
    app.command()(ecu)
    app.command()(fault)


def run(
    scenario: ScenarioName = "formation",
    can: Buses = None,
    clock: Annotated[
        str,
        typer.Option(
            metavar="lockstep|realtime",
            help="lockstep: simulated time, as fast as the machine allows; realtime: the wall clock.",
        ),
    ] = "lockstep",
    overrides: Overrides = None,
    seed: Seed = None,
    out: Annotated[Path | None, typer.Option(help="The log to write; logs/SCENARIO-TIME.mcap if not given.")] = None,
    label: Annotated[
        str | None,
        typer.Option(metavar="TEXT", help="A few words that tell this run from others: --label 'soft gains'."),
    ] = None,
    no_report: Annotated[bool, typer.Option("--no-report", help="Write no report beside the log.")] = False,
    ecu: Annotated[
        list[str] | None,
        typer.Option(metavar="ROLE=CLASS", help="Another ECU class: --ecu tracker=my_ecu.py:MyTracker"),
    ] = None,
    without: Annotated[
        list[str] | None,
        typer.Option(metavar="ECU", help="Exclude a built-in ECU, to start your own by hand: --without veh1.tracker"),
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
    live_origin: LiveOrigins = None,
) -> None:
    """Run a scenario, write its log and report, and show its metrics.

    Examples:
      platoon run five --set platoon.gap_m=12.0 --set vehicles.0.x_m=5.0
      platoon run formation --can vcan --without veh1.tracker
      platoon run --ecu tracker=my_ecu.py:MyTracker --out mine.mcap

    What can be set: platoon scenarios --keys
    """
    with ExitStack() as stack:
        # What is imported stays; the search for garbage in it is a tenth of the time until the run starts.
        gc.disable()
        stack.callback(gc.enable)
        from bench.bus.link.address import Address
        from bench.scenario import load

        if clock not in ("lockstep", "realtime"):
            raise BadInput(f"--clock {clock}: no such clock; allowed: lockstep, realtime")
        loaded = load(scenario, overrides or (), seed)
        named = "" if label is None else checked_label(label)
        address = Address.parse(*(can or loaded.bus_texts))
        ecus = _ecu_classes(ecu or [])
        log = _log_path(out, loaded.name, with_report=not no_report)
        use_machine_code()

        # First, so that no ECU's process has what the plant needs.
        server = None if address.hub is not None else stack.enter_context(_fork_server(loaded, ecus))
        fmu = vehicle_fmu()
        session = (
            stack.enter_context(_live(log, live_address, live_origin or []))
            if live or live_address or live_origin
            else None
        )
        from bench.cli.summary import following, show_metrics, show_timing
        from bench.conductor import run as conductor
        from bench.conductor.options import RunOptions

        if session is not None:
            typer.echo(session.served())
        shown = stack.enter_context(following(loaded.name, loaded.duration_s))

        def tell(time_s: float) -> None:
            shown.at(time_s)
            if session is not None:
                session.check()

        options = RunOptions(
            loaded,
            address=address,
            out=log,
            label=named,
            command_line=["platoon", *sys.argv[1:]],
            on_progress=tell,
            ecus=ecus,
            without=without or (),
            without_wait_s=wait,
            on_waiting=_warn,
            on_starting=shown.starting,
            fmu=fmu,
            realtime=clock == "realtime",
            fork_server=server,
        )
        gc.freeze()
        gc.enable()
        result = conductor.run(options)

    from bench.analysis.metrics import compute
    from bench.analysis.timing import timing
    from bench.record.reader import Run

    recorded = Run(result.path)
    figures = compute(recorded)
    show_metrics(figures, named)
    times = timing(recorded)
    if times is not None:
        show_timing(times, result.scheduling)
    typer.echo("".join(f"{refused.text}\n" for refused in result.refused) + f"log:    {result.path}")
    if not no_report:
        from bench.analysis.report import write

        report = report_path(result.path)
        write(recorded, report, new=True)
        typer.echo(f"report: {report}")
    failures = _failures(figures, loaded)
    if failures:
        typer.echo("\n".join(map(message, failures)), err=True)
        raise typer.Exit(1)


def scenarios(
    name: Annotated[
        str | None,
        typer.Argument(
            metavar="NAME|PATTERN",
            help="Print this scenario, as a template; with --keys, which keys, by name or meaning.",
        ),
    ] = None,
    keys: Annotated[
        bool, typer.Option("--keys", help="List what can be set: unit, allowed values, default and meaning.")
    ] = False,
    schema: Annotated[
        bool, typer.Option("--schema", help="Print the JSON schema of scenario files, for editors.")
    ] = False,
    random: Annotated[
        int | None,
        typer.Option(
            metavar="SEED",
            min=0,
            max=2**32 - 1,
            help="Print the random scenario of this number, which is the same for ever.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """List the shipped scenarios, or print one of them or a random one, the keys of scenarios, or their schema.

    Examples:
      platoon scenarios five > mine.toml
      platoon scenarios --random 7 > mine.toml
      platoon scenarios random-fault:7 > mine.toml
      platoon scenarios --keys gap
      platoon scenarios --keys 'planner.*'
      platoon scenarios --schema > scenario.schema.json
    """
    options = {"--keys": keys, "--schema": schema, "--random": random is not None}
    given = [option for option, is_given in options.items() if is_given]
    if len(given) > 1:
        raise BadInput(f"{' and '.join(given)}: give one of them")
    if random is not None and name is not None:
        raise BadInput(f"--random {random} {name}: give a number or a name")
    if schema:
        from bench.scenario.keys import editor_schema_text

        if name is not None:
            raise BadInput(f"--schema {name}: it is the same for all scenarios; give no name")
        typer.echo(editor_schema_text(), nl=False)
    elif keys:
        from bench.cli.scenario_keys import described

        typer.echo(described(name))
    elif random is not None:
        from bench.scenario.random_family import random_scenario

        typer.echo(random_scenario(random), nl=False)
    else:
        typer.echo(_scenario_list() if name is None else _scenario_text(name), nl=False)


def _scenario_list() -> str:
    """Return a line for each shipped scenario, and one for each family of random ones."""
    from bench.scenario import load, shipped
    from bench.scenario.families import FAMILIES

    described = {name: load(name).description for name in shipped()}
    described |= {f"{family.name}:SEED": family.description for family in FAMILIES.values()}
    width = max(map(len, described))
    return "".join(f"{name:{width}}  {description}\n" for name, description in described.items())


def _scenario_text(name: str) -> str:
    """Return the TOML of a shipped or a random scenario.

    Raises:
        BadInput: there is no such scenario.
    """
    from bench.scenario import SCENARIO_DIR, shipped
    from bench.scenario.families import is_random, random_text

    if is_random(name):
        return random_text(name)
    if name not in shipped():
        raise BadInput(f"No scenario {name!r}; shipped are {', '.join(shipped())}.")
    return (SCENARIO_DIR / f"{name}.toml").read_text(encoding="utf-8")


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
    """Run one ECU alone, for example on another host.

    Examples:
      platoon run --can udp:45000 --without veh1.tracker
      platoon ecu tracker --vehicle 1 --can udp:45000 --class my_ecu.py:Mine
    """
    from bench.bus.link.address import Address
    from bench.bus.network import EcuSlot
    from bench.ecu.loading import DEFAULT_ECUS
    from bench.ecu.main import serve_ecu
    from bench.scenario import load

    loaded = load(scenario, overrides or (), seed)
    address = Address.parse(*can)
    if address.hub is not None:
        raise BadInput("--can direct: an ECU alone is a separate process; allowed: udp:PORT, vcan, IFACE:CHANNEL")
    use_machine_code()
    serve_ecu(None, spec or DEFAULT_ECUS[role], EcuSlot(role, vehicle), loaded, address)


def fault(
    kind: Annotated[
        str | None, typer.Argument(metavar="KIND", help="The kind of fault; all kinds are listed if not given.")
    ] = None,
    keys: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="KEY=VALUE",
            help="Target and settings, as in [[faults]] of a scenario: ecu=veh2.tracker, for_s=1.0.",
        ),
    ] = None,
    run: Annotated[
        str | None,
        typer.Option(help="Process number of the bench, or part of its log; the bench started here if not given."),
    ] = None,
) -> None:
    """Inject a fault into the bench that was started in this directory, or into the one that --run names.

    Example:
      platoon fault ecu_crash ecu=veh2.tracker for_s=1.0
    """
    from bench.cli.fault_words import describe_kinds, parse
    from bench.conductor.fault_desk import ask

    if kind is None:
        typer.echo(describe_kinds(), nl=False)
        return
    answer = ask(run, parse(kind, keys or []))
    typer.echo(f"{kind} at {answer['at_s']:g} s in {answer['log']}")


def _live(log: Path, address: str | None, origins: list[str]) -> "AbstractContextManager[LiveSession]":
    """Serve a log while the context lasts.

    Raises:
        BadInput: not an address or origin, or the packages for it are not installed.
    """
    from bench.live.address import DEFAULT, LiveAddress
    from bench.live.session import live

    return live(log, LiveAddress.parse(address or DEFAULT, origins), _warn)


def _fork_server(scenario: "Scenario", ecus: Mapping[str, str]) -> "ForkServer":
    """Start the process that forks plant and ECUs, which imports them while this one prepares the rest of the run.

    It is forked from here once everything that both need has been imported, and before anything is opened.
    """
    from bench.bus.codec import load_codecs
    from bench.conductor.fork_server_process import fork_server
    from bench.ecu.loading import DEFAULT_ECUS

    load_codecs(len(scenario.vehicles))
    return fork_server([each for each in ecus.values() if each in DEFAULT_ECUS.values()])


def _failures(metrics: "Metrics", scenario: "Scenario") -> list[str]:
    """Return why a run that has been completed counts as failed, a line each; none if it does not."""
    from bench.analysis.requirements import LEAST_DISTANCE_M, keeps_clear, keeps_distance

    lines = [str(each) for each in metrics.not_numbers] if scenario.on_not_a_number == "fail" else []
    failures = ["had commands that are not numbers"] if lines else []
    if metrics.formation_time_s is None:
        failures.append(f"did not form a platoon in {scenario.duration_s:g} s")
    if not keeps_distance(metrics):
        least = f"{metrics.least_distance_m:.2f} m of each other, centre to centre"
        failures.append(f"brought vehicles within {least}, where {LEAST_DISTANCE_M:g} m is the least")
    if not keeps_clear(metrics):
        least = f"{metrics.least_clearance_m:.2f} m"
        failures.append(f"left {least} between two bodies, where {metrics.required_clearance_m:.2f} m is the least")
    return [*lines, f"{scenario.name} {' and '.join(failures)}"] if failures else []


def _warn(text: str) -> None:
    typer.echo(message(text), err=True)


def _ecu_classes(chosen: list[str]) -> dict[str, str]:
    """Return the class of each role's ECU: the built-in one unless another is chosen.

    Raises:
        BadInput: not ROLE=CLASS, or no such role.
    """
    from bench.ecu.loading import DEFAULT_ECUS

    classes = dict(DEFAULT_ECUS)
    for choice in chosen:
        role, _, spec = choice.partition("=")
        if role not in classes or not spec:
            raise BadInput(f"--ecu {choice}: write ROLE=CLASS, where ROLE is {' or '.join(classes)}")
        classes[role] = spec
    return classes


def _log_path(out: Path | None, name: str, *, with_report: bool) -> Path:
    """Return where to write the log, after checking that this is possible.

    Raises:
        BadInput: it cannot be written there.
    """
    if out is None:
        if LOGS.exists() and not LOGS.is_dir():
            raise BadInput(
                f"{LOGS} is a file, but runs are written to a directory of that name; give another place with --out"
            )
        check_directory(LOGS / "any" if LOGS.exists() else LOGS)
        LOGS.mkdir(exist_ok=True)
        # With milliseconds, so that runs started together get separate logs.
        moment = datetime.now().astimezone().isoformat(timespec="milliseconds")[:23]
        return LOGS / f"{name}-{moment.replace(':', '').replace('T', '-')}.mcap"
    check_new(out, ".mcap", option="--out")
    if with_report:
        check_new(report_path(out), ".html", option="--out")
    try:
        out.touch(exist_ok=False)
        out.unlink()
    except FileExistsError as error:
        raise already_exists(out, "--out") from error
    except OSError as error:
        raise BadInput(f"{out} cannot be created: {error.strerror}") from error
    return out
