"""The planner as a state machine: what it does, says and tells the others, fault by fault."""

from typing import Any

import pytest

from bench.bus.reception import Health, Reception, ReceptionState
from bench.bus.states import Cause, EcuState, Manoeuvre, ReferenceState
from bench.bus.topic import Topic
from bench.control.outcome import Limit
from bench.ecu.planner import PlannerEcu
from bench.scenario import load
from tests.ecu.drive import Drive

SMALL = ["planner.genetic.population=4", "planner.genetic.generations=1", "planner.genetic.horizon_steps=5"]
GRID = [f"vehicles.{n}.{key}={value}" for n in range(3) for key, value in (("x_m", 10.0 - 10.0 * n), ("y_m", 7.0))]
SCENARIO = load("formation", [*SMALL, *GRID, *(f"vehicles.{n}.speed_mps=20.0" for n in range(3))])
Sent = dict[str, dict[str, float]]


class Bench:
    """The planner of one of three vehicles that keep a formed platoon, fed with frames; cycle after cycle."""

    def __init__(self, vehicle: int, first_cycle: int = 0, others_slots: bool = False) -> None:
        self.vehicle = vehicle
        self.ecu = PlannerEcu(vehicle, SCENARIO)
        self.cycle = first_cycle
        self.others_slots = others_slots
        self.silent: set[int] = set()
        self.reports: dict[int, dict[str, float]] = {}
        self.sensors_gone: set[str] = set()
        self.follows = True
        self.actuators: dict[str, float] = {}
        self._ages = dict.fromkeys(self.ecu.inputs, 0)
        self._drive = Drive(v_x=lambda _: self.speed, yaw_rate=lambda _: self.yaw_rate, x=self._x(vehicle), y=7.0)
        self.speed, self.yaw_rate = 20.0, 0.0
        self.sent: Sent = {}

    @staticmethod
    def _x(vehicle: int) -> float:
        return 10.0 * (2 - vehicle)

    def step(self, cycles: int = 1) -> Sent:
        for _ in range(cycles):
            frames = self._drive.frames()
            frames["ActuatorStatus"] = (frames["ActuatorStatus"] or {}) | self.actuators
            if self.cycle == 0:
                frames["ActuatorStatus"] |= {"ActuatorState": 0}
            inputs = {Topic(f"veh{self.vehicle}", name): frame for name, frame in frames.items()}
            inputs |= dict.fromkeys([topic for topic in inputs if topic.message in self.sensors_gone])
            inputs |= self._heard()
            self._ages = {t: self._ages[t] + 1 if inputs[t] is None else 0 for t in self.ecu.inputs}
            states = {
                topic: Reception(
                    ReceptionState.LOST if age >= (10 if topic.bus == "v2v" else 5) else ReceptionState.OK, age
                )
                for topic, age in self._ages.items()
            }
            out = self.ecu.step(self.cycle, self.cycle * 0.01, inputs, Health(inputs=states))
            self.sent = {message.message: dict(message.values) for message in out}
            if self.follows:
                self.speed, self.yaw_rate = self.sent["Reference"]["VelocityX"], self.sent["Reference"]["YawRate"]
            self.cycle += 1
        return self.sent

    def feels(self, a_x: float) -> None:
        """Let the vehicle measure a longitudinal acceleration (m/s^2) from now on."""
        self._drive.a_x = a_x

    def _heard(self) -> dict[Topic, Any]:
        t = (self.cycle - 1) * 0.01
        heard: dict[Topic, Any] = {}
        for number in (1, 2, 3):
            if number != self.vehicle:
                silent = number in self.silent or self.cycle == 0
                slot = number if self.others_slots or self.cycle > 1 else 0
                status = {"State": 1, "Slot": slot, "Cause": 0, "LeaderX": 10.0 + 20.0 * t, "Manoeuvre": 1}
                frames = {
                    "Position": {"X": self._x(number) + 20.0 * t, "Y": 7.0},
                    "Motion": {"Speed": 20.0, "Course": 0.0, "YawRate": 0.0},
                    "Status": status | self.reports.get(number, {}),
                }
                heard |= {Topic("v2v", f"V2V{k}_{number}"): None if silent else f for k, f in frames.items()}
        return heard

    @property
    def state(self) -> tuple[EcuState, Cause, Manoeuvre]:
        status = self.sent["PlannerStatus"]
        manoeuvre = Manoeuvre(int(self.sent["PlannerTarget"]["Manoeuvre"]))
        told = self.sent[f"V2VStatus_{self.vehicle}"]
        assert (told["State"], told["Cause"], told["Manoeuvre"]) == (status["State"], status["Cause"], manoeuvre)
        return EcuState(int(status["State"])), Cause(int(status["Cause"])), manoeuvre


RUN = (EcuState.RUN, Cause.NONE, Manoeuvre.PLATOON)


def formed(vehicle: int) -> Bench:
    bench = Bench(vehicle)
    bench.step(30)
    assert bench.state == RUN
    return bench


def test_from_init_to_run_in_the_cycle_in_which_all_have_been_heard() -> None:
    bench = Bench(2)
    bench.step()
    assert bench.state == (EcuState.INIT, Cause.PEER_MISSING, Manoeuvre.NONE)
    bench.step()
    assert bench.state == RUN
    assert bench.sent["V2VStatus_2"]["Slot"] == 2
    assert bench.sent["PlannerBusHealth"]["PositionReception"] == ReceptionState.OK


def test_who_is_not_heard_from_the_start_has_its_place_by_the_start_grid() -> None:
    bench = Bench(3)
    bench.silent = {1}
    bench.step(10)
    assert bench.state[0] is EcuState.INIT
    bench.step()
    assert bench.state == (EcuState.DEGRADED, Cause.PEER_LOST, Manoeuvre.FALL_BACK)
    assert bench.sent["V2VStatus_3"]["Slot"] == 3


@pytest.mark.parametrize(("vehicle", "silent"), [(1, 2), (1, 3), (2, 1), (2, 3), (3, 1), (3, 2)])
def test_whoever_was_there_from_the_start_takes_no_slot_that_another_may_take(vehicle: int, silent: int) -> None:
    bench = Bench(vehicle)
    bench.silent = {silent}
    bench.step(11)
    assert bench.sent[f"V2VStatus_{vehicle}"]["Slot"] == vehicle


def test_a_lost_vehicle_ahead_opens_the_gap_down_to_a_crawl_and_back() -> None:
    bench = formed(2)
    bench.silent = {1}
    bench.step(9)
    assert bench.state == (EcuState.DEGRADED, Cause.PEER_MISSING, Manoeuvre.PLATOON)
    bench.step()
    assert bench.state == (EcuState.DEGRADED, Cause.PEER_LOST, Manoeuvre.FALL_BACK)
    before = bench.speed
    bench.step(100)
    # Slot 2 of 3: between the 1.5 of one that slows down in its lane and the most that a planner asks for. It begins
    # with limited jerk.
    assert before - bench.speed == pytest.approx(2.0, abs=0.15)
    slower = bench.speed
    bench.step(20)
    assert slower - bench.speed == pytest.approx(0.4, abs=0.002)
    bench.step(700)
    assert bench.speed == pytest.approx(5.0, abs=0.01)
    bench.silent = set()
    bench.step(20)
    assert bench.state == RUN
    bench.step(800)
    # It comes back slowly, however far it has fallen behind.
    assert 21.0 < bench.speed < 25.0


def test_a_lost_vehicle_behind_changes_nothing_for_those_ahead() -> None:
    bench = formed(2)
    bench.silent = {3}
    bench.step(200)
    assert bench.state == (EcuState.DEGRADED, Cause.PEER_LOST, Manoeuvre.PLATOON)
    assert bench.speed == pytest.approx(20.0, abs=0.5)
    assert bench.sent["PlannerBusHealth"]["PeersLost"] == 1


def test_those_further_back_brake_harder() -> None:
    speeds = []
    for vehicle in (2, 3):
        bench = formed(vehicle)
        bench.silent = {1}
        bench.step(200)
        speeds.append(bench.speed)
    assert speeds[1] < speeds[0] - 0.5


def test_one_ahead_that_says_it_slows_down_is_fallen_back_from_at_once() -> None:
    bench = formed(3)
    bench.reports[2] = {"State": EcuState.SAFE, "Manoeuvre": Manoeuvre.SLOW_DOWN}
    bench.step()
    assert bench.state == (EcuState.DEGRADED, Cause.PEER_UNSAFE, Manoeuvre.FALL_BACK)
    del bench.reports[2]
    bench.step()
    assert bench.state == RUN


@pytest.mark.parametrize(
    ("status", "cycles"),
    [
        ({"ActuatorState": 2, "HeldCycles": 3, "CommandState": 0}, 1),
        ({"ActuatorState": 3, "HeldCycles": 9, "CommandState": 0}, 1),
        ({"ActuatorState": 0, "CommandState": 0}, 6),
        ({"CommandState": 3}, 1),
    ],
)
def test_without_its_tracker_the_vehicle_says_so(status: dict[str, float], cycles: int) -> None:
    bench = formed(2)
    bench.actuators = status
    bench.step(cycles)
    assert bench.state == (EcuState.SAFE, Cause.TRACKER_LOST, Manoeuvre.SLOW_DOWN)
    bench.actuators = {}
    bench.step()
    assert bench.state == RUN


def test_a_vehicle_that_does_not_follow_says_so_and_gives_no_reference() -> None:
    bench = formed(2)
    bench.follows = False
    bench.yaw_rate = 0.3
    bench.step(6)
    assert bench.state == (EcuState.SAFE, Cause.VEHICLE_FAULT, Manoeuvre.SLOW_DOWN)
    assert bench.sent["Reference"]["ReferenceState"] == ReferenceState.NONE


def test_a_tracker_that_is_safe_for_want_of_a_reference_is_no_tracker_lost() -> None:
    bench = formed(2)
    bench.follows, bench.yaw_rate = False, 0.3
    bench.step(7)
    bench.actuators = {"CommandState": 3}
    for _ in range(30):
        bench.step()
        assert bench.state == (EcuState.SAFE, Cause.VEHICLE_FAULT, Manoeuvre.SLOW_DOWN)
        assert bench.sent["Reference"]["ReferenceState"] == ReferenceState.NONE


def test_a_sensor_less_is_degraded_and_goes_on() -> None:
    bench = formed(2)
    bench.sensors_gone = {"VehicleMotion"}
    bench.step()
    assert bench.state == (EcuState.DEGRADED, Cause.SENSOR_MISSING, Manoeuvre.PLATOON)
    bench.step(100)
    assert bench.state == (EcuState.DEGRADED, Cause.SENSOR_LOST, Manoeuvre.PLATOON)
    assert bench.speed == pytest.approx(20.0, abs=0.1)
    assert bench.sent["Reference"]["ReferenceState"] == ReferenceState.DEGRADED


def test_without_any_sensor_it_is_silent_about_where_it_is() -> None:
    bench = formed(2)
    bench.sensors_gone = {topic.message for topic in bench.ecu.inputs if topic.bus != "v2v"}
    bench.step(5)
    assert "V2VPosition_2" in bench.sent
    bench.step()
    assert bench.state[:2] == (EcuState.SAFE, Cause.OWN_MOTION_LOST)
    assert "V2VPosition_2" not in bench.sent
    assert bench.sent["Reference"]["ReferenceState"] == ReferenceState.NONE


def test_a_planner_that_starts_anew_joins_the_platoon_where_it_is() -> None:
    bench = Bench(2, first_cycle=500, others_slots=True)
    bench._drive.x = 20.0 * 5.0 - 40.0
    bench.step()
    assert bench.state == RUN
    assert bench.sent["V2VStatus_2"]["Slot"] == 2
    assert bench.sent["V2VStatus_2"]["LeaderX"] == pytest.approx(10.0 + 20.0 * 5.0, abs=1e-6)
    bench.step(300)
    assert 21.0 < bench.speed < 25.0


def test_it_says_when_its_vehicle_feels_more_than_is_comfortable() -> None:
    bench = Bench(1)
    bench.step(60)
    assert bench.sent["PlannerStatus"]["Limit"] == Limit.NONE
    limit = SCENARIO.planner.comfort.longitudinal_acceleration_mps2
    bench.feels(-limit - 0.01)
    assert bench.step()["PlannerStatus"]["Limit"] == Limit.COMFORT
    bench.feels(-limit + 0.01)
    # The jerk of the last half second is more than is comfortable as well.
    assert bench.step(49)["PlannerStatus"]["Limit"] == Limit.COMFORT
    assert bench.step(3)["PlannerStatus"]["Limit"] == Limit.NONE
    # Without the sensor nothing can be said, and nothing else changes.
    bench.sensors_gone = {"VehicleAcceleration"}
    sent = bench.step(60)["PlannerStatus"]
    assert (sent["Limit"], sent["State"], sent["Cause"]) == (Limit.NONE, EcuState.RUN, Cause.NONE)


def test_without_limits_of_comfort_it_says_nothing_of_them() -> None:
    bench = Bench(1)
    bench.ecu = PlannerEcu(1, load("formation", [*SMALL, *GRID, "planner.comfort.enabled=false"]))
    bench.feels(-9.0)
    assert bench.step(5)["PlannerStatus"]["Limit"] != Limit.COMFORT
