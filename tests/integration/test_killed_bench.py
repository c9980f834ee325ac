"""A bench of which one process is killed with SIGKILL: what is left of the log, and that every command takes it."""

import os
import signal
import warnings
from pathlib import Path

import pytest
from click.testing import CliRunner
from typer.main import get_command

from bench.cli.main import app
from bench.events import RunEnded
from bench.mcap.recover import recover
from bench.record.reader import LogDamaged, Run

WRITTEN_S = 0.5
"""What is older than this is in the file, so the README says."""

UNDER_WAY_S = 0.03
"""The cycle that is going on, and those whose frames may still be on the wire."""

LONG = ["duration_s=300.0"]


@pytest.mark.parametrize(
    ("name", "realtime"),
    [
        ("conductor", False),
        ("veh2.planner", False),
        ("conductor", True),
        ("fork server", True),
        ("clock", True),
        ("plant", True),
        ("veh2.tracker", True),
    ],
)
def test_whatever_is_killed_at_most_half_a_second_is_lost_and_nothing_goes_on(start, name: str, realtime: bool) -> None:
    run = start(set=LONG, realtime=realtime)
    run.await_time(0.9)
    os.kill(run.process.pid if name == "conductor" else run.pid_of(name), signal.SIGKILL)
    code, output, errors = run.end()
    run.assert_all_gone()
    reached_s = float(output.split()[-1]) if output else 0.9
    assert "Traceback" not in errors
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        log = Run(run.out)
        frames = list(log.frames())
    if name == "conductor":
        assert [warning.category for warning in caught] == [LogDamaged]
    else:
        assert code == 1
        assert name in errors
        assert caught == []
        assert any(name in event.fields["reason"] for event in log.events if event.kind == RunEnded.kind)
    assert frames[-1].time_ns / 1e9 >= reached_s - WRITTEN_S - UNDER_WAY_S
    assert len(log.truth(1)["t"]) >= (reached_s - WRITTEN_S - UNDER_WAY_S) * 100


@pytest.fixture
def broken(start) -> Path:
    """The log of a bench whose conductor was killed."""
    run = start(set=LONG)
    run.await_time(0.9)
    os.kill(run.process.pid, signal.SIGKILL)
    run.end()
    run.assert_all_gone()
    return Path(run.out)


def test_every_command_takes_the_log_of_a_killed_bench_after_one_warning(broken: Path, tmp_path: Path) -> None:
    log, out, whole = str(broken), str(tmp_path / "out"), tmp_path / "whole.mcap"
    recover(broken, whole)
    commands = {
        ("metrics", log): 0,
        ("report", log, "-o", f"{out}.html"): 0,
        ("diff", log, str(whole)): 0,
        ("log", "info", log): 0,
        ("log", "signals", log, "--ranges"): 0,
        ("log", "layout", log): 0,
        ("log", "export", log, "-o", f"{out}.log"): 0,
        ("log", "export", log, "-o", f"{out}.blf"): 0,
        ("log", "export", log, "-o", f"{out}.csv"): 0,
        ("replay", log, "--speed", "max"): 0,
        ("log", "recover", log, "-o", f"{out}.mcap"): 3,
    }
    for arguments, code in commands.items():
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            result = CliRunner().invoke(get_command(app), list(arguments))
        assert result.exit_code == code, (arguments, result.output, result.exception)
        # `recover` says on its own what was lost.
        warned = [warning.category for warning in caught]
        assert warned == ([] if "recover" in arguments else [LogDamaged]), arguments
