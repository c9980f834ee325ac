"""The cost of a live viewer: the same run with and without a viewer of its live page, alternately."""

import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

from rich.table import Table

from bench.benchmarks.figures import in_turns, ratio_figure, table_of, time_figure
from bench.bus.link.address import Address
from bench.conductor.options import RunOptions
from bench.conductor.run import run
from bench.live.address import DEFAULT, LiveAddress
from bench.live.session import LiveSession, live
from bench.scenario import load
from platoon_fmu.interpreter import python

ROUNDS = 7
LIMIT = 1.05
"""Allowed slowdown of a run with a viewer."""


def tables() -> Iterator[Table]:
    """Yield the table, after running the scenario alternately."""
    with tempfile.TemporaryDirectory(prefix="platoon-bench-") as folder:
        logs = Path(folder)
        seconds = in_turns({"alone": lambda: _alone(logs), "watched": lambda: _watched(logs)}, ROUNDS)
    yield table_of(
        "formation over udp, as fast as possible, with a viewer of its live page",
        [
            time_figure("alone", "", seconds["alone"]),
            time_figure("watched", "", seconds["watched"]),
            ratio_figure("watched : alone", f"at most {LIMIT}", seconds["watched"], seconds["alone"]),
        ],
    )


def _alone(logs: Path) -> float:
    return _run(_new_log(logs))


def _watched(logs: Path) -> float:
    log = _new_log(logs)
    with live(log, LiveAddress.parse(DEFAULT), _fail) as session:
        viewer = _viewer(session)
        seconds = _run(log)
    rows, _ = viewer.communicate()
    if not int(rows or "0"):
        raise RuntimeError("the viewer received no data of the run")
    return seconds


def _viewer(session: LiveSession) -> subprocess.Popen[bytes]:
    page = session.served().split()[1]
    return python("bench.benchmarks.viewer", page, stdout=subprocess.PIPE)


def _run(log: Path) -> float:
    """Return the wall-clock time (s) from the first cycle to the last."""
    result = run(
        RunOptions(load("formation"), address=Address.parse("udp"), out=log, command_line=["bench.benchmarks", "live"])
    )
    return result.wall_s


def _new_log(logs: Path) -> Path:
    return logs / f"{len(list(logs.iterdir()))}.mcap"


def _fail(text: str) -> None:
    raise RuntimeError(text)
