"""Runs with ECUs of one's own: the examples in Python, ECUs that are started by hand, the tracker in C on SocketCAN."""

import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from bench.analysis.figures import Figures
from bench.analysis.metrics import compute
from bench.bus.link.address import Address
from bench.bus.link.opening import settle
from bench.bus.states import ActuatorState, EcuState
from bench.conductor.options import RunOptions
from bench.conductor.run import run
from bench.ecu.loading import DEFAULT_ECUS
from bench.errors import BadInput
from bench.events import EcuFailed, StrayFrame
from bench.record.compare import diff
from bench.record.reader import Run
from bench.scenario import load

ROOT = Path(__file__).parents[2]
EXAMPLES = ROOT / "bench" / "examples"
SIMPLE = {
    "planner": f"{ROOT}/tests/ecus/simple.py:CruisePlanner",
    "tracker": f"{ROOT}/tests/ecus/simple.py:SpeedTracker",
}
OWN = {"planner": f"{EXAMPLES}/follow.py:Follow", "tracker": f"{EXAMPLES}/single_track.py:SingleTrack"}
SINGLE_TRACK = {"planner": SIMPLE["planner"], "tracker": f"{EXAMPLES}/single_track.py:SingleTrack"}
PLATOON = [sys.executable, "-m", "bench.cli"]
PLATOON_HERE = [sys.executable, "-P", "-c", "from bench.cli.main import main; main()"]
"""As the installed command: it imports nothing from the working directory."""

GUARD_S = 120.0

Start = Callable[..., subprocess.Popen[str]]


@pytest.fixture
def begin() -> Iterator[Start]:
    """Start a command, and see to its end."""
    started: list[subprocess.Popen[str]] = []

    def start(*command: str, cwd: Path = ROOT) -> subprocess.Popen[str]:
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
        started.append(subprocess.Popen(command, cwd=cwd, text=True, **pipes))
        return started[-1]

    yield start
    for process in started:
        process.kill()
        process.communicate()


def log(out: Path, ecus: dict[str, str], *overrides: str, can: str = "direct") -> Path:
    return run(
        RunOptions(load("formation", overrides), address=Address.parse(can), out=out, command_line=["test"], ecus=ecus)
    ).path


def state(recorded: Run, bus: str, role: str = "Tracker") -> list[int]:
    return [int(value) for value in recorded.signal(bus, f"{role}Status", "State")[1]]


def ports() -> int:
    """UDP ports that no bench takes unasked, others for each worker."""
    return 61000 + os.getpid() % 400 * 8


def test_the_examples_drive(tmp_path: Path) -> None:
    recorded = Run(log(tmp_path / "run.mcap", OWN, "duration_s=12.0", "platoon.gap_m=12.0", "platoon.speed_mps=22.0"))
    assert recorded.metadata["e2e_errors"] == "0"
    speeds = [recorded.signal(bus, "VehicleMotion", "VelocityX")[1][-1] for bus in ("veh1", "veh2", "veh3")]
    assert speeds == pytest.approx([22.0] * 3, abs=1.0)
    x = sorted(recorded.signal(bus, "VehiclePosition", "X")[1][-1] for bus in ("veh1", "veh2", "veh3"))
    assert np.diff(x) == pytest.approx([12.0, 12.0], abs=1.5)
    for bus in ("veh1", "veh2", "veh3"):
        assert set(state(recorded, bus)) == set(state(recorded, bus, "Planner")) == {EcuState.RUN}
        assert set(recorded.signal(bus, "PlannerStatus", "Neighbours")[1][1:]) == {2}


def test_the_tracker_of_the_readme_forms_the_platoon_with_the_planner_of_the_paper(tmp_path: Path) -> None:
    recorded = Run(log(tmp_path / "run.mcap", {**DEFAULT_ECUS, "tracker": OWN["tracker"]}))
    figures = compute(recorded)
    assert figures.formation_time_s is not None
    assert figures.formation_time_s < 8.0
    assert set(state(recorded, "veh1")) == {EcuState.RUN}
    # It follows what the planner sent, and says nothing of a solver that it does not have.
    assert all(error is not None and error < 0.5 for error in figures.speed_rmse_mps)
    assert all(error is not None and error < 0.05 for error in figures.yaw_rate_rmse_radps)
    assert (figures.solver_ms, figures.fallback_steps) == (None, None)
    sent = [message for message in recorded.messages("veh1") if message.startswith("Tracker")]
    assert sent == ["TrackerStatus", "TrackerBusHealth", "TrackerTiming"]
    found = Figures(recorded)
    ids = {figure.id for figure in found.figures}
    assert not ids & {"disturbancex", "disturbancey", "disturbanceyaw", "iterations", "tau", "histogram"}
    assert "Cost bound τ" in found.not_sent
    references = [found.pool[f"{v}.ref.VelocityX"] for v in (1, 2, 3)]
    assert min(value for values in references for value in values if value is not None) > 10.0


@pytest.mark.parametrize("early", [True, False], ids=["before the run", "after the run"])
def test_an_ecu_is_started_by_hand(begin: Start, start: Callable[..., object], tmp_path: Path, early: bool) -> None:
    can = f"udp:{ports()}"
    hand = [*PLATOON, "ecu", "tracker", "--vehicle", "2", "--can", can, "--class", SIMPLE["tracker"]]
    ecu = begin(*hand) if early else None
    if ecu is not None:
        assert ecu.stderr is not None
        assert ecu.stderr.readline() == f"veh2.tracker listens on veh2 at udp:{ports() + 2}\n"
    bench = start(set=["duration_s=0.5"], can=can, without=["veh2.tracker"])
    assert bench.process.stdout.readline() == f"waiting for veh2.tracker on udp:{ports() + 2} (at most 60 s) ...\n"
    ecu = ecu or begin(*hand)
    assert bench.end()[::2] == (0, "")
    ecu.communicate(timeout=GUARD_S)
    assert ecu.returncode == 0
    recorded = Run(bench.out)
    assert not any(event.kind == StrayFrame.kind for event in recorded.events)
    # Nothing of the waiting is in the log.
    assert EcuState.WAIT not in state(recorded, "veh2")
    difference = diff(bench.out, log(tmp_path / "all.mcap", SIMPLE, "duration_s=0.5"))
    assert difference.same, str(difference)


def test_a_run_waits_for_all_and_says_who_did_not_come(begin: Start, start: Callable[..., object]) -> None:
    can = f"udp:{ports()}"
    begin(*PLATOON, "ecu", "planner", "--vehicle", "1", "--can", can, "--class", SIMPLE["planner"])
    run = start(set=["duration_s=0.5"], can=can, without=["veh3.tracker", "veh1.planner"], without_wait_s=8.0)
    code, output, errors = run.end()
    assert code == 1
    veh1, v2v, veh3 = (f"udp:{ports() + number}" for number in (1, 0, 3))
    assert f"waiting for veh1.planner on {veh1} and {v2v}; veh3.tracker on {veh3} (at most 8 s)" in output
    assert "veh3.tracker not detected within 8 s" in errors
    assert "veh1.planner" not in errors
    run.assert_all_gone()
    assert Run(run.out).metadata["status"] == "failed"


def test_an_interrupt_ends_the_waiting(start: Callable[..., object]) -> None:
    run = start(set=["duration_s=0.5"], can=f"udp:{ports()}", without=["veh1.tracker"])
    assert run.process.stdout.readline().startswith("waiting for veh1.tracker")
    os.killpg(run.process.pid, signal.SIGINT)
    code, _, errors = run.end()
    assert code == 1
    assert "interrupted by SIGINT" in errors
    run.assert_all_gone()


HELPED = """
import sys
from bench.ecu import Command, Reference, TrackerBase, PlannerBase
import helper
class Tracker(TrackerBase):
    def control(self, motion, reference):
        from later import evenly
        return Command.evenly(evenly(reference.v_x - motion.v_x))
class Planner(PlannerBase):
    def plan(self, pose, motion, peers):
        from later import speed
        return Reference(speed)
"""


def test_ecus_in_more_than_one_file_run_on_every_bus(begin: Start, tmp_path: Path) -> None:
    """Each in its own folder, with helpers of the same name, beside files that nobody may import."""
    for folder, later in {"a": "def evenly(error): return 500.0 * error", "b": "speed = 21.0"}.items():
        (tmp_path / folder).mkdir()
        files = {"mine": HELPED, "helper": "from . import later", "later": later}
        for taken in ("bench", "platoon_fmu", "select", "json", "numpy", "can"):
            files[taken] = "raise SystemError('imported')"
        for name, text in files.items():
            (tmp_path / folder / f"{name}.py").write_text(text)
    classes = {"tracker": f"{tmp_path}/a/mine.py:Tracker", "planner": f"{tmp_path}/b/mine.py:Planner"}
    settings = ["run", "formation", "--set", "duration_s=0.3", "--no-report"]
    settings += [f"--ecu={role}={spec}" for role, spec in classes.items()]
    hand = ["ecu", "tracker", "--vehicle", "2", "--can", f"udp:{ports()}", "--class", classes["tracker"]]
    by_hand = [f"--can=udp:{ports()}", "--without=veh2.tracker"]
    logs = []
    for number, more in enumerate((["--can=direct"], ["--can=udp"], by_hand)):
        ecu = begin(*PLATOON_HERE, *hand, cwd=tmp_path / "a") if more == by_hand else None
        logs.append(tmp_path / f"{number}.mcap")
        # The folder of the ECU is the working directory: nothing else may import from there.
        run = begin(*PLATOON_HERE, *settings, *more, "--out", str(logs[-1]), cwd=tmp_path / "a")
        output, errors = run.communicate(timeout=GUARD_S)
        assert "did not form a platoon in 0.3 s" in errors, errors + output
        if ecu is not None:
            assert ecu.communicate(timeout=GUARD_S)[1].startswith("veh2.tracker listens on")
            assert ecu.returncode == 0
    for other in logs[1:]:
        assert diff(logs[0], other).same
    assert Run(logs[0]).signal("veh2", "Reference", "VelocityX")[1][5] == pytest.approx(21.0)
    again = begin(*PLATOON_HERE, "resim", str(logs[1]), "--all", *(f"--class={r}={s}" for r, s in classes.items()))
    assert again.communicate(timeout=GUARD_S)[0].count("byte for byte") == 6


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("from bench.ecu.planner import PlannerEcu as Mine", "the class PlannerEcu is a planner, not a tracker"),
        ("import os, signal\nos.kill(os.getpid(), signal.SIGKILL)", "its process was killed by SIGKILL"),
        ("import os\nos._exit(0)", "its process ended with exit code 0"),
        ("class Mine:\n def __init__(s, v, t): s.name, s.inputs = 'x', ()\n def step(s): ...", "but it takes ()"),
    ],
)
def test_an_ecu_that_cannot_be_is_refused_before_anything_is_written(
    begin: Start, tmp_path: Path, text: str, message: str
) -> None:
    (tmp_path / "my_ecu.py").write_text(f"print('printed')\n{text}\n")
    run = begin(*PLATOON_HERE, "run", "formation", "--ecu", "tracker=my_ecu.py:Mine", "--out", "o.mcap", cwd=tmp_path)
    output, errors = run.communicate(timeout=GUARD_S)
    assert (run.returncode, output) == (2, "")
    assert "printed\n" in errors
    assert message in errors
    assert [path.name for path in tmp_path.iterdir() if path.name != "__pycache__"] == ["my_ecu.py"]


@pytest.mark.parametrize("can", ["udp", "direct"])
def test_an_ecu_whose_step_is_wrong_ends_the_run_with_its_place(begin: Start, tmp_path: Path, can: str) -> None:
    (tmp_path / "my_ecu.py").write_text(
        "from bench.ecu import *\nclass Mine(TrackerBase):\n def control(self, motion, reference): return 1, 2\n"
    )
    run = begin(*PLATOON_HERE, "run", "--can", can, "--ecu=tracker=my_ecu.py:Mine", "--out", "o.mcap", cwd=tmp_path)
    _, errors = run.communicate(timeout=GUARD_S)
    assert run.returncode == 1
    assert "Mine.control returned a tuple; allowed: Command(steering_angle, torque_fl, " in errors
    assert f"({tmp_path}/my_ecu.py, line 3)" in errors
    assert "Traceback" not in errors


def vcan_problem() -> str:
    """What keeps a run from using vcan here, in a line."""
    try:
        with settle(Address.parse("vcan"), 3):
            return ""
    except BadInput as error:
        return str(error).partition(";")[0].partition("\n")[0]


FAULTS = [
    '{kind = "frame_loss", at_s = 0.05, for_s = 0.15, bus = "veh2", message = "Reference", probability = 0.5}',
    '{kind = "frame_loss", at_s = 0.25, for_s = 0.15, bus = "veh2", message = "Reference"}',
    '{kind = "frame_loss", at_s = 0.45, for_s = 0.05, bus = "veh2", message = "VehicleMotion", probability = 0.5}',
    '{kind = "frame_corrupt", at_s = 0.55, for_s = 0.05, bus = "veh2", message = "VehicleMotion", bits = 2}',
    '{kind = "frame_duplicate", at_s = 0.65, for_s = 0.05, bus = "veh2", message = "Reference", copies = 2}',
    '{kind = "frame_delay", at_s = 0.75, for_s = 0.1, bus = "veh2", message = "VehicleMotion", jitter_cycles = 2}',
]


@pytest.mark.kernel_can
@pytest.mark.skipif(bool(vcan_problem()), reason=f"vcan is needed (platoon vcan -- pytest ...): {vcan_problem()}")
class TestInC:
    """The C tracker drives vehicle 2 on a real SocketCAN link."""

    @pytest.mark.parametrize(
        "faults", [pytest.param([], id="sound", marks=pytest.mark.nightly), pytest.param(FAULTS, id="faults")]
    )
    def test_it_sends_what_a_python_ecu_of_its_kind_sends(
        self, begin: Start, start: Callable[..., object], c_tracker: Path, tmp_path: Path, faults: list[str]
    ) -> None:
        settings = [f"duration_s={1.0 if faults else 0.4}", f"faults=[{', '.join(faults)}]"]
        ecu = begin(str(c_tracker), "vcan2")
        bench = start(set=settings, can="vcan", ecus=SINGLE_TRACK, without=["veh2.tracker"])
        code, _, errors = bench.end()
        assert code == 0, errors
        assert ecu.communicate(timeout=GUARD_S) == ("", "tracker listens on vcan2\n")
        assert ecu.returncode == 0
        recorded = Run(bench.out)
        seen = set(state(recorded, "veh2"))
        assert seen == ({EcuState.RUN, EcuState.DEGRADED, EcuState.SAFE} if faults else {EcuState.RUN})
        difference = diff(bench.out, log(tmp_path / "python.mcap", SINGLE_TRACK, *settings))
        assert difference.same, str(difference)

    def test_while_it_is_stopped_the_run_goes_on_and_afterwards_it_hears_the_end(
        self, begin: Start, start: Callable[..., object], c_tracker: Path
    ) -> None:
        ecu = begin(str(c_tracker), "vcan2")
        settings = ["duration_s=1.0", 'on_ecu_failure="continue"']
        run = start(set=settings, can="vcan", ecus=SINGLE_TRACK, without=["veh2.tracker"], silence_s=1.0)
        run.await_time(0.2)
        ecu.send_signal(signal.SIGSTOP)
        run.await_time(0.6)
        ecu.send_signal(signal.SIGCONT)
        code, _, errors = run.end()
        assert code == 0, errors
        ecu.communicate(timeout=GUARD_S)
        assert ecu.returncode == 0
        recorded = Run(run.out)
        assert [event.fields["ecus"] for event in recorded.events if event.kind == EcuFailed.kind] == [["veh2.tracker"]]
        t, _ = recorded.signal("veh2", "SteeringCommand", "AliveCounter")
        assert not np.any((t > 0.3) & (t < 0.55))
        assert ActuatorState.SAFE in recorded.signal("veh2", "ActuatorStatus", "ActuatorState")[1]

    def test_it_drives_in_real_time(self, begin: Start, c_tracker: Path, tmp_path: Path) -> None:
        ecu = begin(str(c_tracker), "vcan1")
        out = tmp_path / "run.mcap"
        command = [
            "run",
            "formation",
            "--clock",
            "realtime",
            "--can",
            "vcan",
            "--without",
            "veh1.tracker",
            "--no-report",
        ]
        ecus = [f"--ecu={role}={spec}" for role, spec in SINGLE_TRACK.items()]
        # One vehicle, as the kernel of `platoon vcan` has one core.
        alone = ["--set", "vehicles=[{x_m=0.0, y_m=0.0, speed_mps=18.0}]", "--set", "duration_s=3.0"]
        bench = begin(*PLATOON, *command, *ecus, *alone, "--out", str(out))
        errors = bench.communicate(timeout=GUARD_S)[1]
        assert "waiting for veh1.tracker on vcan1" in errors
        ecu.communicate(timeout=GUARD_S)
        assert ecu.returncode == 0
        recorded = Run(out)
        assert recorded.metadata["status"] == "completed"
        assert EcuState.RUN in state(recorded, "veh1")
        # On a busy machine many a command comes late; some come in time.
        assert ActuatorState.ACTIVE in recorded.signal("veh1", "ActuatorStatus", "ActuatorState")[1]


SLOW = """
import time
from bench.ecu import Command, TrackerBase
{load}
class Mine(TrackerBase):
    def __init__(self, vehicle, scenario):
        super().__init__(vehicle, scenario)
        {create}
    def control(self, motion, reference): return Command()
"""


@pytest.mark.parametrize(
    ("load", "create", "said"),
    [
        (
            "time.sleep(3)",
            "",
            r"waiting for ECU 'my_ecu.py:Mine' to start \(\d s\): it is being loaded and created once",
        ),
        (
            "",
            "import multiprocessing, os; os.getppid() == int(os.environ['RUN']) or time.sleep(3)",
            r"waiting for (plant, )?veh1\.planner.* to start \(\d s\): |"
            r"waiting for (.*, )?veh[123]\.tracker(, veh.\.tracker)* to start \(\d s\): ",
        ),
    ],
    ids=["loading", "starting"],
)
def test_a_slow_start_says_what_is_waited_for(begin: Start, tmp_path: Path, load: str, create: str, said: str) -> None:
    (tmp_path / "my_ecu.py").write_text(SLOW.format(load=load, create=create))
    command = f"import os; os.environ['RUN'] = str(os.getpid()); {PLATOON_HERE[-1]}"
    settings = ["--set", "duration_s=0.05", "--no-report", "--can", "udp", "--out", "o.mcap"]
    run = begin(*PLATOON_HERE[:-1], command, "run", *settings, "--ecu=tracker=my_ecu.py:Mine", cwd=tmp_path)
    _, errors = run.communicate(timeout=GUARD_S)
    lines = [line for line in errors.splitlines() if line.startswith("platoon: waiting for ")]
    # Without a terminal, one line.
    assert len(lines) == 1, errors
    assert re.search(said, lines[0]), lines
    assert "o.mcap" not in errors
