"""Processes of a bench that somebody stops (SIGSTOP) or kills at its start, while it runs and at its end.

The run ends within its limits, with a message, an exit code and a whole log; nothing of it is left.
"""

import os
import signal
import warnings
from pathlib import Path

import pytest

from bench.record.reader import LogDamaged, Run

from .conftest import wait_until

SET = ["duration_s=1.0"]
PROCESSES = ["fork server", "plant", "veh1.planner", "veh2.tracker"]


def result_of(path: Path) -> dict[str, str]:
    """The result in a log, which must be whole."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", LogDamaged)
        return dict(Run(path).result)


@pytest.mark.parametrize("realtime", [False, True], ids=["lockstep", "realtime"])
@pytest.mark.parametrize("at", [0.2, 0.9])
def test_a_stopped_fork_server_does_not_matter(start, at: float, realtime: bool) -> None:
    run = start(set=SET, realtime=realtime)
    run.await_time(at)
    os.kill(run.pid_of("fork server"), signal.SIGSTOP)
    code, output, errors = run.end()
    assert (code, errors) == (0, "")
    assert "cycles 100" in output
    run.assert_all_gone()
    assert result_of(run.out)["status"] == "completed"


@pytest.mark.parametrize("name", ["plant", "veh1.planner", "veh2.tracker"])
def test_a_stopped_process_is_named(start, name: str) -> None:
    run = start(set=["duration_s=300"], silence_s=1.0)
    run.await_time(0.2)
    os.kill(run.pid_of(name), signal.SIGSTOP)
    code, _, errors = run.end()
    assert code == 1
    assert f"{name} sends no " in errors
    assert "Traceback" not in errors
    run.assert_all_gone()
    assert result_of(run.out)["status"] == "failed"


@pytest.mark.parametrize("name", ["clock", "plant", "veh1.planner", "fork server"])
@pytest.mark.parametrize("number", [signal.SIGSTOP, signal.SIGKILL])
def test_the_same_in_real_time(start, name: str, number: signal.Signals) -> None:
    run = start(set=["duration_s=4"], silence_s=1.0, realtime=True)
    run.await_time(0.2)
    os.kill(run.pid_of(name), number)
    code, _, errors = run.end()
    fine = number == signal.SIGSTOP and name == "fork server"
    assert code == (0 if fine else 1), errors
    assert "Traceback" not in errors
    run.assert_all_gone()
    assert result_of(run.out)["status"] == ("completed" if fine else "failed")


@pytest.mark.parametrize("name", PROCESSES)
@pytest.mark.parametrize("number", [signal.SIGSTOP, signal.SIGKILL])
def test_at_the_end_of_a_run(start, name: str, number: signal.Signals) -> None:
    run = start(set=SET, silence_s=2.0)
    run.await_time(1.0)
    # It may have ended in the meantime.
    pid = run.processes().get(name)
    if pid is not None:
        try:
            os.kill(pid, number)
        except ProcessLookupError:
            pid = None
    code, _, errors = run.end()
    assert "Traceback" not in errors
    run.assert_all_gone()
    result = result_of(run.out)
    assert result["cycles"] == "100"
    assert (result["status"], code) in [("completed", 0), ("failed", 1)]
    if code:
        assert number == signal.SIGKILL
        assert name in errors
    else:
        assert errors == ""


def started(run, name: str) -> int:
    """Process number of a process of a run, once it is there."""

    def pids() -> list[int]:
        # Its children have its name, too, at first.
        return run.children("fork server") if name == "fork server" else [run.processes().get(name, 0)]

    wait_until(lambda: any(pids()), f"{name} to be there")
    return pids()[0]


@pytest.mark.parametrize("name", PROCESSES)
def test_killed_at_the_start(start, name: str) -> None:
    run = start(set=["duration_s=300"])
    os.kill(started(run, name), signal.SIGKILL)
    code, _, errors = run.end()
    assert code == 1
    assert name in errors
    assert "Traceback" not in errors
    run.assert_all_gone()
    assert result_of(run.out)["status"] == "failed"


@pytest.mark.parametrize("name", PROCESSES)
def test_stopped_at_the_start_and_interrupted(start, name: str) -> None:
    run = start(set=["duration_s=300"])
    os.kill(started(run, name), signal.SIGSTOP)
    wait_until(run.out.exists, "the log to be there")
    run.process.send_signal(signal.SIGINT)
    code, _, errors = run.end()
    assert code == 1
    assert "interrupted by SIGINT" in errors
    assert "Traceback" not in errors
    run.assert_all_gone()
    assert result_of(run.out)["status"] == "interrupted"


def test_what_is_stopped_at_the_start_is_named(start) -> None:
    run = start(set=["duration_s=300"], ready_s=3.0)
    os.kill(started(run, "fork server"), signal.SIGSTOP)
    code, _, errors = run.end()
    assert code == 1
    assert "not ready after 3 s; stopped by a signal: fork server" in errors
    run.assert_all_gone()
    assert result_of(run.out)["status"] == "failed"


def test_sixteen_vehicles_and_a_fork_server_stopped_before_it_reads_anything(start) -> None:
    """What it is given is more than a pipe holds."""
    rows = ", ".join(f"{{x_m = {-12.0 * number}, y_m = 0.0, speed_mps = 20.0}}" for number in range(16))
    faults = ", ".join('{kind = "v2v_outage", at_s = 1.0, for_s = 0.1, vehicle = 1}' for _ in range(500))
    run = start(set=["duration_s=300", f"vehicles=[{rows}]", f"faults=[{faults}]"])
    os.kill(started(run, "fork server"), signal.SIGSTOP)
    run.process.send_signal(signal.SIGINT)
    assert run.end()[0] in (1, -signal.SIGINT)
    run.assert_all_gone()
