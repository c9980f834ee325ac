"""Faults in real runs: the same frames on every bus, and ECUs that die, stop, start anew and join again."""

import os
import signal
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from bench.bus.link.address import Address
from bench.conductor.fault_desk import ask
from bench.conductor.fault_socket import listening_names
from bench.conductor.options import RunOptions
from bench.conductor.run import run
from bench.errors import BadInput
from bench.events import EcuFailed, FaultBegins, FaultEnds, FaultRequested
from bench.record.compare import diff
from bench.record.reader import Run
from bench.scenario import load

SIMPLE_FILE = Path(__file__).parents[1] / "ecus" / "simple.py"
SIMPLE = {"planner": f"{SIMPLE_FILE}:CruisePlanner", "tracker": f"{SIMPLE_FILE}:SpeedTracker"}

EVERY_KIND = [
    '{kind = "frame_loss", at_s = 0.05, for_s = 0.3, bus = "veh1", message = "Reference", probability = 0.5}',
    '{kind = "frame_loss", at_s = 0.05, bus = "v2v", bursts = {to_bad = 0.1, to_good = 0.3}}',
    '{kind = "frame_delay", at_s = 0.1, for_s = 0.2, bus = "veh2", message = "VehicleMotion", jitter_cycles = 2}',
    '{kind = "frame_duplicate", at_s = 0.2, for_s = 0.1, bus = "veh3", copies = 2}',
    '{kind = "frame_reorder", at_s = 0.3, for_s = 0.1, bus = "veh3"}',
    '{kind = "frame_corrupt", at_s = 0.05, for_s = 0.2, bus = "veh3", bits = 3, probability = 0.5}',
    '{kind = "counter_stuck", at_s = 0.1, for_s = 0.3, bus = "veh1", message = "SteeringCommand"}',
    '{kind = "signal_stuck", at_s = 0.1, for_s = 0.3, bus = "veh1", message = "VehicleMotion", signal = "YawRate"}',
    '{kind = "sensor_bias", at_s = 0.1, for_s = 0.3, bus = "veh1", message = "VehiclePosition", signal = "X", bias=2}',
    '{kind = "sensor_noise", at_s = 0.1, for_s = 0.3, bus = "veh2", message="VehiclePosition", signal="Y", sigma=1}',
    '{kind = "sensor_dropout", at_s = 0.2, for_s = 0.2, bus = "veh2", message = "VehicleAttitude", probability = 0.5}',
    '{kind = "babbling_idiot", at_s = 0.35, for_s = 0.05, node = "veh2.planner"}',
    '{kind = "bus_off", at_s = 0.4, for_s = 0.1, node = "veh3.tracker"}',
    '{kind = "v2v_outage", at_s = 0.45, for_s = 0.1, vehicle = 2}',
    '{kind = "ecu_crash", at_s = 0.2, for_s = 0.15, ecu = "veh1.tracker"}',
    '{kind = "ecu_hang", at_s = 0.25, for_s = 0.25, ecu = "veh1.planner"}',
    '{kind = "ecu_crash", at_s = 0.5, ecu = "veh2.planner"}',
    '{kind = "ecu_hang", at_s = 0.5, ecu = "veh2.tracker"}',
    '{kind = "actuator_stuck", at_s = 0.1, for_s = 0.2, vehicle = 1, actuator = "steering", value = 0.02}',
    '{kind = "tyre_blowout", at_s = 0.1, for_s = 0.2, vehicle = 1, wheel = "rr"}',
    '{kind = "axle_softening", at_s = 0.1, for_s = 0.2, vehicle = 1, axle = "front"}',
    '{kind = "ice_patch", at_s = 0.1, for_s = 0.2, mu = 0.3}',
]


def log(out: Path, can: str, *overrides: str) -> Run:
    scenario = load("formation", ["duration_s=0.6", *overrides])
    result = run(RunOptions(scenario, address=Address.parse(can), out=out, command_line=["test"], ecus=SIMPLE))
    assert result.frames_lost == 0
    return Run(result.path)


def told(recorded: Run, source: str) -> list[tuple[float, str, Mapping[str, Any]]]:
    return [(round(event.time_s, 3), event.kind, event.fields) for event in recorded.events if event.source == source]


def test_with_every_kind_of_fault_frames_are_the_same_on_every_bus_and_run_after_run(tmp_path: Path) -> None:
    faults = f"faults=[{', '.join(EVERY_KIND)}]"
    first = log(tmp_path / "direct.mcap", "direct", faults)
    for number, can in enumerate(("udp", "udp", "direct")):
        again = log(tmp_path / f"{number}.mcap", can, faults)
        difference = diff(first.path, again.path)
        assert difference.same, str(difference)
        assert [e for e in again.events if e.source == "fault"] == [e for e in first.events if e.source == "fault"]
    assert len([event for event in first.events if event.kind == FaultBegins.kind]) == len(EVERY_KIND)
    assert not diff(first.path, log(tmp_path / "other.mcap", "direct", faults, "seed=2").path).same


@pytest.mark.parametrize("can", ["direct", "udp"])
def test_a_crashed_tracker_starts_anew_and_joins(tmp_path: Path, can: str) -> None:
    fault = 'faults=[{kind = "ecu_crash", at_s = 0.1, for_s = 0.2, ecu = "veh2.tracker"}]'
    recorded = log(tmp_path / "run.mcap", can, fault)
    assert recorded.result["status"] == "completed"
    sent = recorded.message("veh2", "SteeringCommand")["t"].round(3).tolist()
    assert sent == [round(cycle / 100, 3) for cycle in range(60) if not 10 <= cycle < 30]
    others = recorded.message("veh1", "SteeringCommand")["t"]
    assert len(others) == 60
    states = recorded.message("veh2", "ActuatorStatus")["ActuatorState"]
    assert states[11] == 2
    assert states[35] == 1
    crash = {"fault": "ecu_crash", "parameters": {"ecu": "veh2.tracker"}}
    assert told(recorded, "fault") == [
        (0.1, FaultBegins.kind, {**crash, "until_s": 0.3}),
        (0.3, FaultEnds.kind, crash),
    ]
    hold = {"vehicle": 2, "before": "active", "after": "hold", "cause": "", "cause_before": ""}
    assert hold in [fields for _, _, fields in told(recorded, "veh2.actuators")]


@pytest.mark.parametrize("can", ["direct", "udp"])
def test_a_stopped_planner_goes_on_with_the_cycle_of_the_others(tmp_path: Path, can: str) -> None:
    fault = 'faults=[{kind = "ecu_hang", at_s = 0.1, for_s = 0.3, ecu = "veh1.planner"}]'
    recorded = log(tmp_path / "run.mcap", can, fault)
    for bus, message in (("veh1", "Reference"), ("v2v", "V2VPosition_1")):
        sent = recorded.message(bus, message)
        assert sent["t"].round(3).tolist() == [round(cycle / 100, 3) for cycle in range(60) if not 10 <= cycle < 40]
    # Its broadcast is of the cycle it goes on with, not of the one it was stopped in.
    x = recorded.message("v2v", "V2VPosition_1")
    truth = recorded.truth(1)
    assert x["X"][10] == pytest.approx(truth["X"][40], abs=1e-3)


def test_a_run_goes_on_without_an_ecu_that_failed_where_the_scenario_says_so(start, unruly) -> None:
    end = start(set=["duration_s=0.5"], ecus=unruly(tracker="CrashingTracker"))
    code, _, errors = end.end()
    assert code == 1
    assert "veh2.tracker" in errors

    goes_on = start(set=["duration_s=0.5", 'on_ecu_failure="continue"'], ecus=unruly(tracker="CrashingTracker"))
    code, output, errors = goes_on.end()
    assert (code, errors) == (0, "")
    assert "cycles 50" in output
    goes_on.assert_all_gone()
    recorded = Run(goes_on.out)
    (failure,) = [event for event in recorded.events if event.level == "error"]
    assert failure.time_s == pytest.approx(0.2)
    assert "veh2.tracker (process" in failure.text
    assert "was killed by SIGSEGV" in failure.text
    assert (failure.kind, failure.fields["ecus"]) == (EcuFailed.kind, ["veh2.tracker"])
    assert len(recorded.message("veh2", "SteeringCommand")["t"]) == 20
    assert len(recorded.message("veh1", "SteeringCommand")["t"]) == 50


def test_a_run_does_not_go_on_without_its_plant(start) -> None:
    run_ = start(set=["duration_s=300.0", 'on_ecu_failure="continue"'])
    run_.await_time(0.2)
    os.kill(run_.pid_of("plant"), signal.SIGKILL)
    code, _, errors = run_.end()
    assert code == 1
    assert "plant" in errors
    run_.assert_all_gone()


def test_a_fault_is_brought_to_a_running_bench(start) -> None:
    run_ = start(set=["duration_s=20.0"])
    run_.await_time(0.2)
    (name,) = [name for name in listening_names() if name.startswith(f"{run_.process.pid}-")]
    with pytest.raises(BadInput, match=r"mu = 0\.01 is not allowed; allowed: a finite number from 0\.05 to 1\.5"):
        ask(name, {"kind": "ice_patch", "mu": 0.01})
    with pytest.raises(BadInput, match=r'the fault has the kind "earthquake"; allowed: one of .*frame_loss, '):
        ask(name, {"kind": "earthquake"})
    with pytest.raises(BadInput, match="the fault has no kind; allowed: one of "):
        ask(name, {})
    with pytest.raises(BadInput, match=r"bus is missing; allowed: .*; probability = 2 is not allowed"):
        ask(name, {"kind": "frame_loss", "probability": 2})
    with pytest.raises(BadInput, match=r"bursts\.to_good is missing; allowed: a finite number above 0 and at most 1"):
        ask(name, {"kind": "frame_loss", "bus": "veh1", "bursts": {"to_bad": 0.1}})
    with pytest.raises(BadInput, match="vehicle = 9 does not exist; allowed: 1 to 3"):
        ask(name, {"kind": "ice_patch", "vehicle": 9})
    with pytest.raises(BadInput, match=r"at_s = 0\.01"):
        ask(name, {"kind": "ice_patch", "at_s": 0.01})
    with pytest.raises(BadInput, match=r"at_s = 20 is not before the run's end at 20 s"):
        ask(name, {"kind": "ice_patch", "at_s": 20.0})
    with pytest.raises(BadInput, match="no running bench has 'nonsense' in its name"):
        ask("nonsense", {"kind": "ice_patch"})
    crash = ask(name, {"kind": "ecu_crash", "ecu": "veh2.planner", "for_s": 0.1})
    ice = ask(name, {"kind": "ice_patch", "vehicle": 1, "mu": 0.3})
    code, _, errors = run_.end()
    assert (code, errors) == (0, "")
    run_.assert_all_gone()
    assert name not in listening_names()
    recorded = Run(run_.out)
    assert [(time, fields["fault"]) for time, _, fields in told(recorded, "fault")] == sorted(
        [
            (round(crash["at_s"], 3), "ecu_crash"),
            (round(crash["at_s"] + 0.1, 3), "ecu_crash"),
            (round(ice["at_s"], 3), "ice_patch"),
        ]
    )
    asked = [event.fields["fault"] for event in recorded.events if event.kind == FaultRequested.kind]
    assert asked == [crash["fault"], ice["fault"]]
    mu = recorded.truth(1)
    assert set(mu["mu"][mu["t"] > ice["at_s"] + 0.005]) == {0.3}
    assert set(mu["mu"][mu["t"] < ice["at_s"]]) == {0.8}
