"""The command `python -m bench.benchmarks against REV`."""

import argparse
import os
import signal
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import tomli_w
from rich.table import Table

from bench.benchmarks.against import tables
from bench.benchmarks.against.checkout import BUILDS, ROOT, Checkout, build, commit_of, this_checkout
from bench.benchmarks.against.comparison import Costs, in_pairs, in_real_time, shares_by_part
from bench.benchmarks.against.profile import is_possible
from bench.errors import BadInput, RunFailed
from bench.scenario import SCENARIO_DIR, load, shipped
from bench.scenario.families import is_random, random_text
from platoon_fmu.interpreter import interpreter

HOW_TO_READ = (
    "Columns: the median of each, the median of the ratios (this : other) of the pairs, and the smallest and the "
    "largest ratio. Other work of the machine changes the absolute values; the two runs of a pair are made one after "
    "the other, so it hardly changes their ratio. Processor time is user and system time of all processes of "
    "`platoon run --no-report`."
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of the command."""
    parser.add_argument("revision", metavar="REV", help="what to compare this checkout with: a commit, branch or tag")
    parser.add_argument("--pairs", type=_positive(int), default=5, help="number of pairs of runs (default: 5)")
    parser.add_argument(
        "--seconds", type=_positive(float), default=10.0, help="simulated time of each run (default: 10)"
    )
    parser.add_argument("--scenario", default="formation", help="shipped scenario, or file (default: formation)")
    parser.add_argument(
        "--vehicles", type=_positive(int), help="the scenario's first vehicles, or more behind them, two lanes in turn"
    )
    parser.add_argument(
        "--realtime",
        type=_positive(float),
        metavar="SECONDS",
        help="also count missed deadlines on the wall clock, on the quiet machine and with a busy process per core",
    )
    parser.add_argument("--no-profile", action="store_true", help="leave out the table of the parts of a run on direct")
    parser.add_argument(
        "--builds", type=Path, default=ROOT / BUILDS, help=f"where other revisions are built (default: {BUILDS})"
    )


def compare(options: argparse.Namespace) -> Iterator[Table | str]:
    """Build the other revision, run both, and yield the tables.

    Raises:
        BadInput: an argument, or what is needed for the build, is wrong.
        RunFailed: the other revision cannot be built, or a run failed.
    """
    commit = commit_of(options.revision)
    with tempfile.TemporaryDirectory(prefix="platoon-against-") as name, _terminable():
        folder = Path(name)
        scenario = scenario_file(options.scenario, options.vehicles, folder)
        this = this_checkout(_say)
        yield from compared(build(commit, options.builds, _say), this, scenario, options, folder)


def compared(
    other: Checkout, this: Checkout, scenario: Path, options: argparse.Namespace, folder: Path
) -> Iterator[Table | str]:
    """Run both checkouts, and yield the tables."""
    costs = in_pairs((other, this), scenario, options.seconds, options.pairs, folder, _say)
    names = other.name, this.name
    pairs = f"{options.pairs} pair{'s' if options.pairs > 1 else ''}"
    title = f"{options.scenario}, {options.seconds:g} s, this checkout against {other.name}, {pairs}"
    yield HOW_TO_READ
    yield tables.table(f"{title}: time", tables.times(costs[0], costs[1]), names)
    yield tables.table("peak memory of a process of each kind over udp, MB", tables.memory(costs[0], costs[1]), names)
    by_node = "where a cycle's processor time goes over udp: ms per cycle, all processes of a kind together"
    yield tables.table(by_node, tables.nodes(costs[0], costs[1]), names)
    if not options.no_profile:
        yield _parts(costs, scenario, options.seconds, folder, names)
    if options.realtime:
        for situation, busy in (("quiet machine", 0), ("one busy process per core", os.cpu_count() or 1)):
            with ExitStack() as stack:
                for _ in range(busy):
                    stack.enter_context(_busy())
                found = in_real_time((other, this), scenario, options.realtime, folder, _say)
            yield tables.deadlines(f"{options.realtime:g} s on the wall clock over udp, {situation}", found)


def scenario_file(name: str, vehicles: int | None, folder: Path) -> Path:
    """Return the scenario's file, with another number of vehicles if one is given: a file in `folder`.

    Both checkouts run this checkout's scenario, which may have changed since, or may be new.

    Raises:
        BadInput: there is no such scenario, or it is not possible with so many vehicles.
    """
    scenario = load(name)
    path = SCENARIO_DIR / f"{name}.toml" if name in shipped() else Path(name).resolve()
    if is_random(name):
        # The other checkout may not know the family.
        path = folder / f"{scenario.name}.toml"
        path.write_text(random_text(name), encoding="utf-8")
    if vehicles is None:
        return path
    document = tomllib.loads(path.read_text(encoding="utf-8"))
    document["vehicles"] = _some(document["vehicles"], vehicles)
    changed = folder / f"{path.stem}-{vehicles}.toml"
    changed.write_text(tomli_w.dumps(document), encoding="utf-8")
    load(changed)
    return changed


def _some(vehicles: list[dict[str, Any]], number: int) -> list[dict[str, Any]]:
    """Return the first `number` vehicles; if there are fewer, more behind the last, lanes and speeds in turn."""
    found = list(vehicles)
    if number > len(found) and len(found) < 2:
        raise BadInput(f"--vehicles {number}: the scenario needs two vehicles, for the distance between further ones")
    while len(found) < number:
        found.append({**found[-2], "x_m": 2 * found[-1]["x_m"] - found[-2]["x_m"]})
    return found[:number]


def _parts(costs: list[Costs], scenario: Path, seconds: float, folder: Path, names: tuple[str, str]) -> Table | str:
    if not is_possible():
        return "No table of the parts of a run on direct: py-spy is not installed; make bench installs it."
    try:
        shares = [shares_by_part(each, scenario, seconds, folder, _say) for each in costs]
    except RunFailed as error:
        return f"No table of the parts of a run on direct: {error}"
    title = "where a cycle's processor time goes on direct: ms per cycle, by py-spy's samples (100 a second)"
    return tables.table(title, tables.parts(costs[0], costs[1], shares), names)


@contextmanager
def _busy() -> Iterator[None]:
    """A process that keeps a core busy at normal priority."""
    process = subprocess.Popen([*interpreter(), "-c", "while True: pass"], start_new_session=True)
    try:
        yield
    finally:
        process.kill()
        process.wait()


@contextmanager
def _terminable() -> Iterator[None]:
    """End as by Ctrl-C on SIGTERM and SIGHUP, so that no process is left behind."""

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    before = {number: signal.signal(number, interrupt) for number in (signal.SIGTERM, signal.SIGHUP)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)  # noqa: T201 - progress of a benchmark


def _positive(kind: Callable[[str], Any]) -> Callable[[str], Any]:
    def parsed(text: str) -> Any:
        value = kind(text)
        if not 0 < value < 1e6:
            raise ValueError
        return value

    parsed.__name__ = "number above 0"
    return parsed
