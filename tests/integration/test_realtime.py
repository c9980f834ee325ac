"""Runs on the wall clock, in real processes over real sockets. How fast this machine is, no test says."""

from pathlib import Path

import numpy as np
import pytest

from bench.analysis.figures import Figures
from bench.analysis.timing import timing
from bench.bus import codec
from bench.bus.codec import DBC_DIR
from bench.bus.link.address import Address
from bench.bus.states import ActuatorState, BenchCommand
from bench.conductor.options import RunOptions
from bench.conductor.run import RunResult, run
from bench.errors import BadInput
from bench.events import Scheduling
from bench.record.reader import Run
from bench.scenario import load

SIMPLE_FILE = Path(__file__).parents[1] / "ecus" / "simple.py"
SIMPLE = {"planner": f"{SIMPLE_FILE}:CruisePlanner", "tracker": f"{SIMPLE_FILE}:SpeedTracker"}


def realtime(out: Path, *overrides: str, can: str = "udp", faults: str = "") -> tuple[RunResult, Run]:
    scenario = load("formation", list(overrides))
    if faults:
        text = scenario.toml().replace("faults = []", "") + faults
        out.with_suffix(".toml").write_text(text)
        scenario = load(str(out.with_suffix(".toml")))
    result = run(
        RunOptions(scenario, address=Address.parse(can), out=out, command_line=["test"], ecus=SIMPLE, realtime=True)
    )
    return result, Run(result.path)


def test_a_run_on_the_wall_clock_is_recorded_whole(tmp_path: Path) -> None:
    result, log = realtime(tmp_path / "run.mcap", "duration_s=0.5")
    assert result.cycles == 50
    assert log.metadata["clock"] == "realtime"
    assert log.result["status"] == "completed"
    assert result.scheduling.startswith(("SCHED_FIFO", "no SCHED_FIFO"))
    (granted,) = [event.fields for event in log.events if event.kind == Scheduling.kind]
    assert granted["fifo"] == result.scheduling.startswith("SCHED_FIFO")
    assert granted["processes"] > 6
    for bus in log.buses:
        sync = log.message(bus, "BenchSync")
        assert sync["Command"].tolist() == [BenchCommand.RUN_REALTIME] * 50 + [BenchCommand.STOP]
        assert sync["Cycle"].tolist() == list(range(51))
        assert sync["t"] == pytest.approx(np.arange(51) / 100)
        # Sent by one process, one after the other: the kernel's times say so, however late the conductor read them.
        table = log.frame_table(bus)
        received = table["receive"][table["can_id"] == log.can_id(bus, "BenchSync")]
        assert (np.diff(received) > 0).all()
    for vehicle in (1, 2, 3):
        assert log.truth(vehicle)["t"] == pytest.approx(np.arange(50) / 100)
        # Every cycle's frames carry its counter, late or not.
        motion = log.message(f"veh{vehicle}", "VehicleMotion")
        assert motion["AliveCounter"].tolist() == [cycle % 15 for cycle in range(50)]


def test_the_log_and_the_conductor_count_the_same_misses(tmp_path: Path) -> None:
    result, log = realtime(tmp_path / "run.mcap", "duration_s=0.5")
    times = timing(log)
    assert times is not None
    assert {node.name: node.misses for node in times.nodes} == dict(result.deadline_misses)
    assert {node.name for node in times.nodes} == {
        f"veh{vehicle}.{role}" for vehicle in (1, 2, 3) for role in ("plant", "planner", "tracker")
    }


def test_a_crash_makes_the_actuators_hold_and_the_run_goes_on(tmp_path: Path) -> None:
    crash = '\n[[faults]]\nkind = "ecu_crash"\necu = "veh2.tracker"\nat_s = 0.2\n'
    result, log = realtime(tmp_path / "run.mcap", "duration_s=0.6", faults=crash)
    assert result.cycles == 60
    status = log.message("veh2", "ActuatorStatus")
    assert status["ActuatorState"][-1] in (ActuatorState.HOLD, ActuatorState.SAFE)
    assert status["HeldCycles"][-1] > 10
    # The dead ECU sends nothing more; real time announces nothing as absent.
    assert log.message("veh2", "SteeringCommand")["t"].max() < 0.5
    assert not any(log.has(bus, "BenchAbsent") and len(log.message(bus, "BenchAbsent")["t"]) for bus in log.buses)


def test_one_process_cannot_keep_real_time(tmp_path: Path) -> None:
    with pytest.raises(BadInput, match="--clock realtime: --can direct "):
        realtime(tmp_path / "run.mcap", can="direct")
    assert list(tmp_path.iterdir()) == []


def test_the_report_has_the_response_times_as_histograms(tmp_path: Path) -> None:
    _, recorded = realtime(tmp_path / "run.mcap", "duration_s=0.4")
    figures = Figures(recorded)
    found = {figure.id: figure for figure in figures.figures if figure.group == "Real time"}
    assert set(found) == {"realtimeplanner", "realtimetracker", "realtimeplant", "realtimeclock"}
    times = timing(recorded)
    assert times is not None
    for curve in found["realtimetracker"].curves:
        node = next(node for node in times.nodes if node.name == curve.name)
        assert sum(filter(None, figures.pool[curve.y][:-1])) == node.cycles - node.missing


def test_a_bus_that_would_be_overloaded_is_refused_before_anything_starts(tmp_path: Path, monkeypatch) -> None:
    for name in ("vehicle.dbc", "v2v.dbc"):
        text = (DBC_DIR / name).read_text(encoding="cp1252").replace('BA_ "Baudrate" 500000', 'BA_ "Baudrate" 125000')
        (tmp_path / name).write_text(text, encoding="cp1252")
    monkeypatch.setattr(codec, "DBC_DIR", tmp_path)
    out = tmp_path / "run.mcap"
    with pytest.raises(BadInput, match=r"bus veh1 to veh3: overloaded: .* of 125 kbit/s.* set Baudrate to 250000"):
        run(RunOptions(load("formation"), address=Address.parse("direct"), out=out, command_line=[]))
    assert not out.exists()
