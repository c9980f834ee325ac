"""Starts, ends and accidents of a run with real processes over udp."""

import json
import os
import signal
import subprocess
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import pytest

from bench.bus.link.address import Address
from bench.bus.link.opening import settle
from bench.errors import BadInput
from bench.events import ProcessOutput, RunEnded, StrayFrame
from bench.record.reader import LogDamaged, Run

ROOT = Path(__file__).parents[2]
SIMPLE = {
    "planner": f"{ROOT}/tests/ecus/simple.py:CruisePlanner",
    "tracker": f"{ROOT}/tests/ecus/simple.py:SpeedTracker",
}
Unruly = Callable[..., dict[str, str]]
LONG = ["duration_s=300.0"]
SHORT = ["duration_s=0.5"]


def read(path: Path) -> Run:
    """Read a log, which must be whole."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", LogDamaged)
        return Run(path)


def are_free(port: int) -> bool:
    """Whether a bench could use the UDP ports from `port` on."""
    try:
        with settle(Address.parse(f"udp:{port}"), vehicles=3):
            return True
    except BadInput:
        return False


def wait_until(happened: Callable[[], bool], what: str) -> None:
    """Wait for what must happen soon."""
    end = time.monotonic() + 60.0
    while not happened():
        if time.monotonic() > end:
            pytest.fail(f"waited in vain for {what}")
        time.sleep(0.01)


def test_a_run_from_start_to_end(start) -> None:
    run = start(set=SHORT)
    code, output, errors = run.end()
    assert (code, errors) == (0, "")
    assert "cycles 50" in output
    run.assert_all_gone()
    log = read(run.out)
    result = log.metadata
    assert result["status"] == "completed"
    assert result["cycles"] == "50"
    assert result["frames_lost"] == "0"
    assert {"scenario.toml", "vehicle.dbc", "v2v.dbc", "modelDescription.xml"} <= set(log.attachments)
    t, speed = log.signal("veh3", "VehicleMotion", "VelocityX")
    assert t == pytest.approx([cycle / 100 for cycle in range(50)])
    assert speed[-1] > speed[0] == pytest.approx(18.0, abs=1e-3)
    neighbours = log.signal("veh1", "PlannerStatus", "Neighbours")[1]
    assert list(neighbours[:3]) == [0, 2, 2]


@pytest.mark.parametrize("name", ["plant", "veh1.planner", "veh3.tracker"])
def test_a_killed_process_is_named(start, name: str) -> None:
    run = start(set=LONG)
    run.await_time(0.2)
    pid = run.pid_of(name)
    os.kill(pid, signal.SIGKILL)
    code, _, errors = run.end()
    assert code == 1
    assert f"{name} (process {pid}) was killed by SIGKILL" in errors
    assert "in cycle " in errors
    assert "Traceback" not in errors
    run.assert_all_gone()
    log = read(run.out)
    (ended,) = [event.fields for event in log.events if event.kind == RunEnded.kind]
    assert ended["status"] == "failed"
    assert f"{name} (process {pid}) was killed by SIGKILL" in ended["reason"]
    assert len(log.signal("veh1", "VehicleMotion", "VelocityX")[0]) >= 20


def test_the_fork_server_killed_ends_the_run(start) -> None:
    run = start(set=LONG)
    run.await_time(0.2)
    os.kill(run.pid_of("fork server"), signal.SIGKILL)
    code, _, errors = run.end()
    assert code == 1
    assert "fork server" in errors
    run.assert_all_gone()
    read(run.out)


def test_an_exception_leaves_its_traceback_as_last_words(start, unruly: Unruly) -> None:
    run = start(set=LONG, ecus=unruly(planner="FailingPlanner"))
    code, _, errors = run.end()
    assert code == 1
    assert "in cycle 20 (t = 0.20 s) veh2.planner" in errors
    assert "ended with exit code 1; its last output:" in errors
    assert "ZeroDivisionError: the gap was zero" in errors
    run.assert_all_gone()
    events = read(run.out).events
    assert any("ZeroDivisionError" in event.text for event in events)


def test_an_exception_in_one_process_ends_the_run_likewise(start, unruly: Unruly) -> None:
    run = start(set=LONG, ecus=unruly(planner="FailingPlanner"), can="direct")
    code, _, errors = run.end()
    assert code == 1
    assert "in cycle 20 (t = 0.20 s) veh2.planner failed: ZeroDivisionError: the gap was zero" in errors
    read(run.out)


def test_a_crash_in_compiled_code_leaves_last_words(start, unruly: Unruly) -> None:
    run = start(set=LONG, ecus=unruly(tracker="CrashingTracker"))
    code, _, errors = run.end()
    assert code == 1
    assert "in cycle 20 (t = 0.20 s) veh2.tracker" in errors
    assert "was killed by SIGSEGV; its last output:\nreading address 0\n" in errors
    assert "in misbehave" in errors
    run.assert_all_gone()


def test_a_full_disk_ends_the_run(start) -> None:
    run = start(set=LONG, file_limit=1_000_000)
    code, _, errors = run.end()
    assert code == 1
    assert f"cannot write the log {run.out}" in errors
    assert "Traceback" not in errors
    run.assert_all_gone()
    with pytest.warns(LogDamaged):
        log = Run(run.out)
    assert len(log.signal("veh1", "VehicleMotion", "VelocityX")[0]) > 0


def test_an_ecu_that_leaves_too_early_is_a_failure(start, unruly: Unruly) -> None:
    run = start(set=LONG, ecus=unruly(tracker="QuittingTracker"))
    code, _, errors = run.end()
    assert code == 1
    assert "veh2.tracker" in errors
    run.assert_all_gone()


@pytest.mark.parametrize(
    ("classes", "guilty"),
    [
        ({"tracker": "HangingTracker"}, "veh2.tracker sends no SteeringCommand (0x300 on veh2) and 9 more"),
        ({"planner": "HangingPlanner"}, "veh2.planner sends no "),
    ],
)
def test_a_silent_ecu_is_named_with_what_is_missing(
    start, unruly: Unruly, classes: dict[str, str], guilty: str
) -> None:
    run = start(set=LONG, ecus=unruly(**classes), silence_s=1.0)
    code, _, errors = run.end()
    assert code == 1
    assert "in cycle 20 (t = 0.20 s)" in errors
    assert guilty in errors
    if "planner" in classes:
        assert "tracker sends no" not in errors
    run.assert_all_gone()
    log = read(run.out)
    assert len(log.signal("veh2", "VehicleMotion", "VelocityX")[0]) == 21


@pytest.mark.parametrize("can", ["udp", "direct"])
def test_an_ecu_that_leaves_out_a_command_is_named_and_its_vehicle_coasts(start, unruly: Unruly, can: str) -> None:
    run = start(set=["duration_s=1.5"], ecus=unruly(tracker="TaciturnTracker"), can=can)
    code, _, errors = run.end()
    assert code == 0
    log = read(run.out)
    told = "in cycle 20 it does not send TorqueCommandRear"
    assert told in (errors if can == "direct" else " ".join(event.text for event in log.events))
    states = log.message("veh1", "ActuatorStatus")["ActuatorState"].tolist()
    assert states[20:22] == [1, 2]
    assert states[-1] == 3
    assert len(log.message("veh1", "TorqueCommandRear")["t"]) == 20


@pytest.mark.parametrize("can", ["udp", "direct"])
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_ends_everything_in_order(start, number: signal.Signals, can: str) -> None:
    run = start(set=LONG, can=can)
    run.await_time(0.2)
    os.killpg(run.process.pid, number)
    code, _, errors = run.end()
    assert code == 1
    assert f"interrupted by {number.name}" in errors
    assert "Traceback" not in errors
    run.assert_all_gone()
    log = read(run.out)
    assert len(log.signal("veh1", "VehicleMotion", "VelocityX")[0]) >= 20


def test_an_interrupt_while_it_starts_ends_it_likewise(start) -> None:
    run = start(set=LONG)
    wait_until(run.out.exists, "the log to be there")
    os.killpg(run.process.pid, signal.SIGINT)
    code, _, errors = run.end()
    assert code == 1
    assert "interrupted by SIGINT" in errors
    assert "Traceback" not in errors
    run.assert_all_gone()
    read(run.out)


def test_an_interrupt_also_ends_a_run_with_an_ecu_that_hangs(start, unruly: Unruly) -> None:
    run = start(set=LONG, ecus=unruly(tracker="HangingTracker"))
    run.await_time(0.1)
    os.killpg(run.process.pid, signal.SIGINT)
    assert run.end()[0] == 1
    run.assert_all_gone()
    read(run.out)


def test_a_killed_conductor_leaves_nothing_behind(start) -> None:
    # Ports that no bench takes unasked, another one for each worker.
    port = 61000 + os.getpid() % 400 * 8
    run = start(set=LONG, can=f"udp:{port}")
    run.await_time(2.0)
    os.kill(run.process.pid, signal.SIGKILL)
    run.assert_all_gone()
    wait_until(lambda: are_free(port), "the kernel to close the sockets of the dead")
    with pytest.warns(LogDamaged):
        log = Run(run.out)
    assert len(log.signal("veh1", "VehicleMotion", "VelocityX")[0]) > 0


def test_a_stopped_conductor_and_ecu_do_no_harm(start) -> None:
    run = start(set=["duration_s=5.0"])
    run.await_time(0.2)
    pid = run.pid_of("veh2.tracker")
    os.kill(pid, signal.SIGSTOP)
    os.kill(run.process.pid, signal.SIGSTOP)
    os.kill(run.process.pid, signal.SIGCONT)
    os.kill(pid, signal.SIGCONT)
    code, output, _ = run.end()
    assert (code, output.split()[-1]) == (0, "500")
    run.assert_all_gone()


def test_a_class_that_is_not_there_is_said_clearly(start, unruly: Unruly) -> None:
    run = start(set=SHORT, ecus=unruly(tracker="NoSuchTracker"))
    code, _, errors = run.end()
    assert code == 2
    assert "has no class NoSuchTracker" in errors
    assert "Traceback" not in errors
    assert not run.out.exists()
    run.assert_all_gone()


@pytest.mark.parametrize(
    ("can", "words"),
    [("udp", "give the port: --can udp:45000"), ("direct", "--can direct runs everything in one process")],
)
def test_an_external_ecu_that_could_not_take_part_is_refused(start, can: str, words: str) -> None:
    run = start(set=SHORT, can=can, without=["veh2.tracker"])
    code, _, errors = run.end()
    assert code == 2
    assert words in errors
    assert not run.out.exists()


def test_the_ecus_import_nothing_of_the_plant(start, unruly: Unruly) -> None:
    run = start(set=["duration_s=0.05"], ecus=unruly(planner="ConfessingPlanner", tracker="ConfessingTracker"))
    assert run.end()[0] == 0
    confessions = {e.source: json.loads(e.text) for e in read(run.out).events if e.kind == ProcessOutput.kind}
    assert set(confessions) == {f"veh{i}.{role}" for i in (1, 2, 3) for role in ("planner", "tracker")}
    for name, modules in confessions.items():
        assert f"bench.ecu.{name.split('.')[1]}" in modules
        strangers = [m for m in modules if m.split(".")[0] in ("fmpy", "cvxpy") or m.startswith("bench.plant")]
        strangers += [
            m
            for m in modules
            if m.startswith("platoon_fmu.")
            and m.removeprefix("platoon_fmu.") not in ("parameters", "wheels", "errors", "interpreter")
        ]
        assert strangers == []


def test_two_runs_at_once_do_not_hear_each_other(start) -> None:
    runs = [start(set=SHORT) for _ in range(2)]
    for run in runs:
        assert run.end()[0] == 0
        assert not any(event.kind == StrayFrame.kind for event in read(run.out).events)


def test_an_ecu_may_run_alone(start) -> None:
    port = 61000 + os.getpid() % 400 * 8
    can = f"udp:{port}"
    code = (
        "import sys; from bench.bus.link.address import Address; from bench.ecu.main import serve_ecu; "
        "from bench.bus.network import EcuSlot; from bench.scenario import load; "
        "serve_ecu(None, sys.argv[1], EcuSlot('tracker', 2), load('formation'), Address.parse(sys.argv[2]))"
    )
    alone = subprocess.Popen(
        [sys.executable, "-c", code, SIMPLE["tracker"], can], cwd=ROOT, stderr=subprocess.PIPE, text=True
    )
    try:
        assert alone.stderr is not None
        assert alone.stderr.readline() == f"veh2.tracker listens on veh2 at udp:{port + 2}\n"
        run = start(set=SHORT, can=can, without=["veh2.tracker"])
        assert run.end()[::2] == (0, "")
        assert alone.wait(60.0) == 0
    finally:
        alone.kill()
        alone.communicate()
    assert "ecu tracker" in read(run.out).metadata


def test_an_external_ecu_that_the_scenario_does_not_have_is_refused(start) -> None:
    run = start(set=SHORT, without=["veh4.tracker"])
    code, _, errors = run.end()
    assert code == 2
    assert "veh4.tracker" in errors
    assert not run.out.exists()


def test_a_log_that_exists_is_not_overwritten(start, tmp_path: Path) -> None:
    out = tmp_path / "precious.mcap"
    out.write_bytes(b"precious")
    run = start(set=SHORT, out=str(out))
    code, _, errors = run.end()
    assert code == 2
    assert "precious.mcap already exists" in errors
    assert out.read_bytes() == b"precious"
