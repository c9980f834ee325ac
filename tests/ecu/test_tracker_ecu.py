"""The tracker as a state machine: what it commands and says, fault by fault."""

from typing import Any

import numpy as np
import pytest

from bench.bus.reception import Health
from bench.bus.states import Cause, CommandState, EcuState, ReferenceState
from bench.control.outcome import GainSource
from bench.control.tracker import Tracker
from bench.ecu.tracker import TrackerEcu
from bench.scenario import load
from tests.ecu.drive import Drive

SCENARIO = load("formation", [])


class Bench:
    """The tracker of a vehicle that has exactly the motion it is to have."""

    def __init__(self) -> None:
        self.ecu = TrackerEcu(1, SCENARIO)
        self.cycle = 0
        self.speed, self.yaw_rate = 20.0, 0.0
        start = SCENARIO.vehicles[0]
        self.drive = Drive(lambda _: self.speed, lambda _: self.yaw_rate, start.x_m, start.y_m)
        self.reference: dict[str, float] | None = {"VelocityX": 20.0, "YawRate": 0.0, "ReferenceState": 1}
        self.gone: set[str] = set()
        self.steering: float | None = None
        self.actuator_state: int | None = None
        self.sent: dict[str, Any] = {}

    def step(self, cycles: int = 1) -> None:
        for _ in range(cycles):
            self.drive.actuator_state = 0 if self.cycle == 0 else self.actuator_state or 1
            command = self.sent.get("SteeringCommand", {"SteeringAngle": 0.0})
            self.drive.steering = command["SteeringAngle"] if self.steering is None else self.steering
            frames = {**self.drive.frames(), "Reference": self.reference}
            inputs = {t: None if t.message in self.gone else frames[t.message] for t in self.ecu.inputs}
            out = self.ecu.step(self.cycle, self.cycle * 0.01, inputs, Health())
            self.sent = {each.message: dict(each.values) for each in out}
            self.speed = self.sent["TrackerReferenceState"].get("VelocityX", self.speed)
            self.cycle += 1

    @property
    def state(self) -> tuple[EcuState, Cause, CommandState]:
        status = self.sent["TrackerStatus"]
        command = CommandState(int(self.sent["SteeringCommand"]["CommandState"]))
        return EcuState(int(status["State"])), Cause(int(status["Cause"])), command

    @property
    def force(self) -> float:
        torques = {**self.sent["TorqueCommandFront"], **self.sent["TorqueCommandRear"]}
        return sum(torques.values()) / 0.3


RUN = (EcuState.RUN, Cause.NONE, CommandState.VALID)


@pytest.fixture
def bench() -> Bench:
    made = Bench()
    made.step(20)
    assert made.state == RUN
    return made


def test_it_runs_from_the_first_reference_on() -> None:
    bench = Bench()
    bench.reference = None
    bench.step(5)
    assert bench.state == (EcuState.INIT, Cause.REFERENCE_MISSING, CommandState.NONE)
    bench.reference = {"VelocityX": 20.0, "YawRate": 0.0, "ReferenceState": 1}
    bench.step()
    assert bench.state == RUN


@pytest.mark.parametrize("gone", [None, {"VelocityX": 30.0, "YawRate": 0.5, "ReferenceState": ReferenceState.NONE}])
def test_a_missing_reference_is_held_then_the_vehicle_slows_down(bench: Bench, gone: dict[str, float] | None) -> None:
    bench.reference = gone
    bench.step(9)
    assert bench.state == (EcuState.DEGRADED, Cause.REFERENCE_MISSING, CommandState.DEGRADED)
    assert bench.speed == pytest.approx(20.0, abs=0.01)
    bench.step()
    assert bench.state == (EcuState.SAFE, Cause.REFERENCE_LOST, CommandState.SAFE)
    bench.step(200)
    assert bench.speed == pytest.approx(17.0, abs=0.05)
    bench.step(900)
    assert bench.speed == pytest.approx(5.0, abs=0.05)
    bench.reference = {"VelocityX": 5.0, "YawRate": 0.0, "ReferenceState": 1}
    bench.step()
    assert bench.state[2] in (CommandState.VALID, CommandState.DEGRADED)


def test_slowing_down_turns_the_course_along_the_road() -> None:
    bench = Bench()
    bench.step()
    bench.yaw_rate = 0.2
    bench.step(50)
    bench.yaw_rate = 0.0
    bench.reference = None
    bench.step(60)
    assert bench.sent["TrackerReferenceState"]["YawRate"] < -0.05


def test_without_any_reference_from_the_start_it_slows_down_from_its_own_speed() -> None:
    bench = Bench()
    bench.reference = None
    bench.step(60)
    assert bench.state == (EcuState.SAFE, Cause.REFERENCE_LOST, CommandState.SAFE)
    assert bench.speed < 20.0


def test_a_degraded_reference_is_followed(bench: Bench) -> None:
    bench.reference = {"VelocityX": 20.0, "YawRate": 0.0, "ReferenceState": ReferenceState.DEGRADED}
    bench.step()
    assert bench.state == (EcuState.DEGRADED, Cause.REFERENCE_DEGRADED, CommandState.DEGRADED)


@pytest.mark.parametrize("message", ["VehicleMotion", "VehiclePosition", "VehicleAttitude", "WheelSpeedsFront"])
def test_with_a_sensor_less_it_goes_on(bench: Bench, message: str) -> None:
    bench.gone = {message}
    bench.step()
    assert bench.state == (EcuState.DEGRADED, Cause.SENSOR_MISSING, CommandState.DEGRADED)
    bench.step(10)
    assert bench.state == (EcuState.DEGRADED, Cause.SENSOR_LOST, CommandState.DEGRADED)


def test_without_its_own_motion_it_gives_no_command(bench: Bench) -> None:
    bench.gone = {topic.message for topic in bench.ecu.inputs if topic.message != "Reference"}
    bench.step(5)
    assert bench.state == (EcuState.DEGRADED, Cause.SENSOR_LOST, CommandState.DEGRADED)
    bench.step()
    assert bench.state == (EcuState.SAFE, Cause.OWN_MOTION_LOST, CommandState.NONE)


def test_a_steering_that_does_not_answer_is_found_and_the_vehicle_slows_down_on_its_wheels(bench: Bench) -> None:
    bench.steering = 0.01
    bench.yaw_rate = 0.05
    bench.step(2)
    assert bench.state == (EcuState.SAFE, Cause.ACTUATOR_FAULT, CommandState.SAFE)
    bench.step(20)
    front, rear = bench.sent["TorqueCommandFront"], bench.sent["TorqueCommandRear"]
    # The vehicle turns to the left: the wheels on the right brake more.
    assert front["TorqueFR"] + rear["TorqueRR"] < front["TorqueFL"] + rear["TorqueRL"]
    assert bench.sent["SteeringCommand"]["SteeringAngle"] == 0.0
    bench.steering = None
    bench.yaw_rate = 0.0
    bench.step(60)
    assert bench.state[2] in (CommandState.VALID, CommandState.DEGRADED)


def test_actuators_that_get_no_commands_are_a_fault(bench: Bench) -> None:
    bench.actuator_state = 2
    bench.step(3)
    assert bench.state == (EcuState.DEGRADED, Cause.ACTUATOR_FAULT, CommandState.DEGRADED)


def test_a_failed_programme_falls_back_and_says_so(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    choose = Tracker._choose

    def fail(self: Tracker, gain: Any, A: np.ndarray, B: np.ndarray) -> tuple[np.ndarray, GainSource]:
        return choose(self, gain, A, B)[0], GainSource.PREVIOUS_GAIN

    monkeypatch.setattr(Tracker, "_choose", fail)
    bench.step()
    assert bench.state == (EcuState.DEGRADED, Cause.SOLVER_FALLBACK, CommandState.DEGRADED)
