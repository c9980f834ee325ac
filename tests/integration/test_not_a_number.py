"""Runs in which a controller's command is not a number: the vehicle is safe, and the run says so."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from bench.bus.link.address import Address
from bench.bus.states import ActuatorState
from bench.cli.main import app
from bench.conductor.options import RunOptions
from bench.conductor.run import run
from bench.record.reader import Run
from bench.scenario import load

ECUS = Path(__file__).parents[1] / "ecus"
NAN = f"{ECUS}/unruly.py:NanTracker"
SENTENCE = "veh2.tracker sent SteeringCommand.SteeringAngle = nan, which is not a number, from 0.20 s for 10 cycles"


@pytest.mark.parametrize("can", ["direct", "udp"])
def test_the_actuators_hold_and_go_to_their_safe_state(tmp_path: Path, can: str) -> None:
    scenario = load("formation", ["duration_s=0.5"])
    ecus = {"planner": f"{ECUS}/simple.py:CruisePlanner", "tracker": NAN}
    options = RunOptions(scenario, address=Address.parse(can), out=tmp_path / "run.mcap", command_line=[], ecus=ecus)
    recorded = Run(run(options).path)
    notes = [event for event in recorded.events if event.source == "veh2.tracker" and "cycle" in event.fields]
    assert [(event.kind, round(event.time_s, 3), event.level) for event in notes] == [
        ("not_a_number", 0.2, "error"),
        ("clipped", 0.2, "warning"),
        ("number_again", 0.3, "info"),
    ]
    assert notes[1].text == "TorqueCommandFront.TorqueFL = 1e+06 is outside the range in the DBC and is sent as 5000"
    t, state = recorded.signal("veh2", "ActuatorStatus", "ActuatorState")
    seen = dict.fromkeys(ActuatorState(int(each)) for each in state[t > 0.195])
    assert list(seen) == [ActuatorState.ACTIVE, ActuatorState.HOLD, ActuatorState.SAFE]
    assert state[-1] == ActuatorState.ACTIVE
    sent = recorded.message("veh2", "SteeringCommand")["t"]
    assert not ((sent > 0.195) & (sent < 0.295)).any()


@pytest.mark.parametrize(("how", "code"), [("fail", 1), ("allow", 0)])
def test_the_run_fails_unless_that_is_allowed(tmp_path: Path, how: str, code: int) -> None:
    """Of a platoon that is formed from the start and stays so."""
    out = str(tmp_path / "run.mcap")
    short = ["--can", "direct", "--set", "duration_s=0.4", "--set", "road.force_y_n=0.0"]
    choice = [] if how == "fail" else ["--set", "on_not_a_number=allow"]
    runner = CliRunner()
    done = runner.invoke(app, ["run", "crosswind", *short, *choice, "--ecu", f"tracker={NAN}", "--out", out])
    assert done.exit_code == code, done.output
    assert "warnings, first at 0.20 s: veh2.tracker: SteeringCommand.SteeringAngle = nan" in done.stdout
    assert (SENTENCE in done.stderr) == (how == "fail")
    told = runner.invoke(app, ["metrics", out])
    assert told.exit_code == 0
    assert SENTENCE in told.stdout
    metrics = json.loads(runner.invoke(app, ["metrics", out, "--json"]).stdout)
    (number,) = metrics["not_numbers"]
    assert (number["ecu"], number["signal"], number["value"], number["cycles"]) == (
        "veh2.tracker",
        "SteeringAngle",
        "nan",
        10,
    )
    assert metrics["warnings"]["count"] > 1
