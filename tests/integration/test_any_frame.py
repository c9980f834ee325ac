"""Whatever comes on the buses of a running bench, from before its first cycle until after its last, does not end it.

A stranger sends all identifiers of both DBC files and others, in all lengths and kinds, with good and bad CRCs.
"""

import json
import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import pytest
from typer.testing import CliRunner

from bench.analysis.timing import timing
from bench.bus.codec import load_codecs
from bench.bus.link.address import Address
from bench.bus.link.kernel_links import lack_of_can
from bench.cli.main import app
from bench.conductor.cycle import frames_due
from bench.conductor.options import RunOptions
from bench.conductor.refusals import Refusals
from bench.conductor.run import run
from bench.cycle import CYCLE_NS
from bench.ecu.loading import DEFAULT_ECUS
from bench.events import FramesRefused, Refusal, StrayFrame
from bench.record.reader import Run
from bench.scenario import load
from tests.conftest import Once, Tries
from tests.integration.conftest import Watched

ROOT = Path(__file__).parents[2]
ECUS = ROOT / "tests" / "ecus"
SIMPLE = {"planner": f"{ECUS}/simple.py:CruisePlanner", "tracker": f"{ECUS}/simple.py:SpeedTracker"}
VEHICLES = 3
CODECS = load_codecs(VEHICLES)
DUE = frames_due(CODECS, VEHICLES)
GUARD_S = 120.0
PAUSE_S = (0.02, 0.1)
"""Between two rounds of a stranger: on udp, on vcan; user-mode Linux has one core and slow system calls."""

Stranger = Callable[..., None]

on_both = pytest.mark.parametrize(
    "can",
    [
        "udp",
        pytest.param(
            "vcan",
            marks=[pytest.mark.kernel_can, pytest.mark.skipif(bool(lack_of_can()), reason="this kernel has no CAN")],
        ),
    ],
)


@pytest.fixture
def stranger() -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Let a stranger send on the buses at an address, and return it once it does."""
    started: list[subprocess.Popen[str]] = []

    def begin(can: str, **given: object) -> subprocess.Popen[str]:
        settings = {
            "can": can,
            "vehicles": VEHICLES,
            "seed": 1,
            "believed": False,
            "pause_s": PAUSE_S[can == "vcan"],
        } | given
        command = [sys.executable, str(Path(__file__).with_name("fuzzer.py")), json.dumps(settings)]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
        started.append(
            subprocess.Popen(command, cwd=ROOT, text=True, env=os.environ | {"PYTHONPATH": str(ROOT)}, **pipes)
        )
        assert started[-1].stdout is not None
        assert started[-1].stdout.readline() == "sending\n"
        return started[-1]

    yield begin
    for process in started:
        process.kill()
        process.communicate()


def sent_by(stranger: subprocess.Popen[str]) -> int:
    """End a stranger, and return how many frames it has sent."""
    output, _ = stranger.communicate("", timeout=GUARD_S)
    return int(output.split()[-1])


def address(can: str) -> str:
    """Of ports that no bench takes unasked, others for each worker."""
    return f"udp:{61000 + os.getpid() % 400 * 8}" if can == "udp" else can


def log(
    out: Path,
    can: str,
    *overrides: str,
    ecus: dict[str, str] = SIMPLE,
    realtime: bool = False,
    without: Sequence[str] = (),
) -> Run:
    options = RunOptions(
        load("formation", list(overrides)),
        address=Address.parse(can),
        out=out,
        command_line=["test"],
        ecus=ecus,
        realtime=realtime,
        without=without,
        silence_s=GUARD_S,
    )
    return Run(run(options).path)


def due_frames(recorded: Run) -> dict[str, list[tuple[int, int, bytes]]]:
    """Time, identifier and data of the whole frames that ECUs and plant send, without those that count or measure."""
    judge = Refusals(CODECS)
    left_out = {
        (bus, codec.can_id(name))
        for bus, codec in CODECS.items()
        for name in codec.names
        if name.endswith("BusHealth") or codec.is_wall_clock(codec.can_id(name))
    }
    found: dict[str, list[tuple[int, int, bytes]]] = {bus: [] for bus in CODECS}
    for frame in recorded.frames():
        bus, can_id, data = frame.bus, frame.can_id, frame.data
        if can_id in DUE[bus] and (bus, can_id) not in left_out and judge.flaw(bus, can_id, data) is None:
            found[bus].append((frame.time_ns, can_id, data))
    return {bus: sorted(frames) for bus, frames in found.items()}


def refused(recorded: Run) -> dict[str, int]:
    """How many frames were refused by reason, as the log says at its end."""
    totals = [event.fields["counts"] for event in recorded.events if event.kind == FramesRefused.kind]
    return {why: sum(counts.get(why, 0) for counts in totals) for why in {why for counts in totals for why in counts}}


def assert_readable(path: Path, folder: Path, ecus: dict[str, str]) -> None:
    """All that people do with a log works on this one."""
    timing(Run(path))
    for command in (
        ["log", "info", str(path)],
        ["log", "signals", str(path), "--ranges"],
        ["metrics", str(path), "--json"],
        ["report", str(path), "-o", str(folder / "report.html")],
        ["diff", str(path), str(path)],
        ["resim", str(path), "--ecu", "veh2.tracker", "--class", ecus["tracker"]],
        ["log", "export", str(path), "--format", "candump", "-o", str(folder / "frames.log")],
        ["log", "export", str(path), "--format", "csv", "--signal", "veh1.*Status.*", "-o", str(folder / "table.csv")],
    ):
        result = CliRunner().invoke(app, command)
        # Strangers' frames may count as differences of an ECU's.
        allowed = (0, 1) if command[0] == "resim" else (0,)
        assert result.exit_code in allowed, (command, result.output, result.exception)
        assert result.exception is None or isinstance(result.exception, SystemExit), command


@on_both
def test_frames_that_are_not_due_change_nothing_but_counts(
    can: str, stranger: Stranger, tmp_path: Path, once: Once, tries: Tries
) -> None:
    ecus = tries(SIMPLE, DEFAULT_ECUS)
    duration = f"duration_s={tries(1.0, 4.0)}"
    name = f"undisturbed-{duration}"
    undisturbed = Run(once(name, lambda folder: log(folder / "run.mcap", "direct", duration, ecus=ecus)) / "run.mcap")
    there = address(can)
    enemy = stranger(there)
    disturbed = log(tmp_path / "run.mcap", there, duration, ecus=ecus)
    sent = sent_by(enemy)
    assert disturbed.result["status"] == "completed"
    assert due_frames(disturbed) == due_frames(undisturbed)
    counts = refused(disturbed)
    kinds = {why.value for why in Refusal} - ({Refusal.MALFORMED.value} if can == "vcan" else set())
    assert set(counts) == kinds
    assert 1000 < sum(counts.values()) <= sent
    assert disturbed.result["frames_refused"] == str(sum(counts.values()))
    told = {event.fields["why"] for event in disturbed.events if event.kind == StrayFrame.kind}
    assert told == kinds
    named = {event.fields["can_id"] for event in disturbed.events if event.kind == StrayFrame.kind}
    assert {0x010, 0x011, 0x107, 0x504, 0x515} <= named
    assert_readable(disturbed.path, tmp_path, ecus)


@on_both
@pytest.mark.parametrize("realtime", [False, True], ids=["lockstep", "realtime"])
def test_valid_frames_with_nonsense_values_do_not_end_a_run(
    can: str, realtime: bool, stranger: Stranger, tmp_path: Path, tries: Tries
) -> None:
    there = address(can)
    ecus = dict(DEFAULT_ECUS) if can == "udp" else tries(SIMPLE, DEFAULT_ECUS)
    for seed in range(tries(1, 5)):
        enemy = stranger(there, believed=True, seed=seed)
        out = tmp_path / f"run{seed}.mcap"
        recorded = log(out, there, "duration_s=1.0", ecus=ecus, realtime=realtime)
        assert sent_by(enemy) > 1000
        assert recorded.result["status"] == "completed"
        assert recorded.result["cycles"] == "100"
        for bus, codec in CODECS.items():
            table = recorded.frame_table(bus)
            syncs = table[(table["can_id"] == codec.can_id("BenchSync")) & (table["length"] == 8)]
            assert {*range(100)} <= set((syncs["time"] // CYCLE_NS).tolist())
        assert_readable(out, tmp_path, ecus)
        (tmp_path / "report.html").unlink()


@on_both
def test_a_run_on_the_wall_clock_refuses_what_is_not_due(can: str, stranger: Stranger, tmp_path: Path) -> None:
    there = address(can)
    enemy = stranger(there)
    recorded = log(tmp_path / "run.mcap", there, "duration_s=1.0", realtime=True)
    assert sent_by(enemy) > 1000
    assert recorded.result["status"] == "completed"
    assert recorded.result["cycles"] == "100"
    assert set(refused(recorded)) >= {why.value for why in Refusal} - {Refusal.MALFORMED.value}
    # Whoever comes too late on a busy machine is refused, too.
    assert all(len(frames) > 0 for frames in due_frames(recorded).values())
    assert_readable(recorded.path, tmp_path, SIMPLE)


def test_strangers_frames_are_no_sign_of_an_ecu_that_is_started_by_hand(
    start: Callable[..., Watched], stranger: Stranger
) -> None:
    """Frames of its identifiers that are not whole do not begin the run without it; nor does it begin with others'."""
    there = address("udp")
    stranger(there)
    run = start(set=["duration_s=0.5"], can=there, without=["veh2.tracker"], without_wait_s=2.0)
    code, _, errors = run.end()
    assert code == 1
    assert "veh2.tracker not detected within 2 s" in errors
    recorded = Run(run.out)
    assert recorded.result["cycles"] == "0"
    assert set(refused(recorded)) >= {Refusal.LENGTH.value, Refusal.DAMAGED.value, Refusal.UNKNOWN.value}


def test_an_ecu_that_is_started_by_hand_takes_part_whatever_else_comes(
    start: Callable[..., Watched], stranger: Stranger
) -> None:
    there = address("udp")
    stranger(there)
    alone = subprocess.Popen(
        [
            sys.executable,
            "-m",
            "bench.cli",
            "ecu",
            "tracker",
            "--vehicle",
            "2",
            "--can",
            there,
            "--class",
            SIMPLE["tracker"],
        ],
        cwd=ROOT,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        # It has received many a BenchSync when the run begins.
        assert alone.stderr is not None
        assert alone.stderr.readline().startswith("veh2.tracker listens on ")
        run = start(set=["duration_s=0.5"], can=there, without=["veh2.tracker"])
        assert run.end()[::2] == (0, "")
        assert alone.wait(GUARD_S) == 0
    finally:
        alone.kill()
        alone.communicate()
    assert len(Run(run.out).message("veh2", "TrackerStatus")["t"]) >= 50


def test_a_flood_of_strangers_does_not_hide_that_an_ecu_is_silent(
    start: Callable[..., Watched], stranger: Stranger, unruly: Callable[..., dict[str, str]]
) -> None:
    there = address("udp")
    stranger(there, pause_s=0.001)
    run = start(set=["duration_s=60.0"], can=there, ecus=unruly(tracker="HangingTracker"), silence_s=1.0)
    code, _, errors = run.end()
    assert code == 1
    assert "veh2.tracker sends no SteeringCommand (0x300 on veh2)" in errors
    assert "no due frame was received for 1 s" in errors
    recorded = Run(run.out)
    assert recorded.result["status"] == "failed"
    assert "veh2.tracker sends no SteeringCommand" in recorded.result["reason"]


@pytest.mark.kernel_can
@pytest.mark.skipif(bool(lack_of_can()), reason="this kernel has no CAN")
def test_the_tracker_in_c_takes_part_whatever_else_comes(stranger: Stranger, tmp_path: Path, c_tracker: Path) -> None:
    stranger("vcan")
    with subprocess.Popen([c_tracker, "vcan1"], stderr=subprocess.PIPE, text=True) as alone:
        try:
            recorded = log(tmp_path / "run.mcap", "vcan", "duration_s=0.5", without=["veh1.tracker"])
            assert alone.wait(GUARD_S) == 0
        finally:
            alone.kill()
    assert recorded.result["status"] == "completed"
    assert len(recorded.message("veh1", "SteeringCommand")["t"]) >= 50
