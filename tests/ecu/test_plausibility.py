"""Every sensor against the others: nothing is blamed without a fault, and with one the right one is, and replaced."""

import math
from collections.abc import Callable

import pytest

from bench.bus.codec import DBC_DIR, Codec
from bench.bus.states import Cause
from bench.ecu.plausibility import RECOVERY_CYCLES, OwnMotion, OwnState
from platoon_fmu.parameters import VehicleParameters
from tests.ecu.drive import Drive, Frames

Change = Callable[[Frames, int], None]
SENSORS = ("VehiclePosition", "VehicleAttitude", "VehicleMotion", "WheelSpeedsFront", "WheelSpeedsRear")
LOST_CYCLES = Codec(DBC_DIR / "vehicle.dbc").timeout_cycles("VehicleMotion")
BEGIN = 50


class Trial:
    """A drive with something done to its frames from cycle `BEGIN` on."""

    def __init__(self, change: Change | None = None, cycles: int = 200, drive: Drive | None = None) -> None:
        self.drive = drive or Drive()
        self.own = OwnMotion(VehicleParameters())
        self.causes: list[Cause] = []
        self.states: list[OwnState | None] = []
        self.true: list[OwnState] = []
        for cycle in range(cycles):
            t = cycle * 0.01
            x, y, yaw = self.drive.x, self.drive.y, self.drive.yaw
            self.true.append(OwnState(x, y, yaw, self.drive.v_x(t), self.drive.v_y(t), self.drive.yaw_rate(t)))
            frames = self.drive.frames()
            if change is not None and cycle >= BEGIN:
                change(frames, cycle)
            self.states.append(self.own.update(frames))
            self.causes.append(self.own.cause)

    def detected_after(self) -> int | None:
        """Cycles from the fault's first frame to the cause, 0 for the very same."""
        found = [cycle for cycle, cause in enumerate(self.causes) if cause is not Cause.NONE]
        return found[0] - BEGIN if found else None

    def worst(self, name: str, first: int = BEGIN) -> float:
        pairs = zip(self.states[first:], self.true[first:], strict=True)
        return max(abs(getattr(state, name) - getattr(true, name)) for state, true in pairs)


def put(message: str, signal: str, value: Callable[[float, int], float]) -> Change:
    def change(frames: Frames, cycle: int) -> None:
        frame = frames[message]
        assert frame is not None
        frame[signal] = value(frame[signal], cycle)

    return change


def stuck(message: str, signal: str) -> Change:
    kept: list[float] = []

    def hold(value: float, _: int) -> float:
        kept.append(value)
        return kept[0]

    return put(message, signal, hold)


def drop(*messages: str) -> Change:
    return lambda frames, _: frames.update(dict.fromkeys(messages))


@pytest.mark.parametrize("v_x", [lambda _: 20.0, lambda t: 22.0 - 3.0 * t, lambda t: 5.0 + 3.0 * t])
def test_without_a_fault_nothing_is_blamed_and_everything_is_used_as_measured(v_x: Callable[[float], float]) -> None:
    trial = Trial(drive=Drive(v_x=v_x))
    assert set(trial.causes) == {Cause.NONE}
    for name, quantum in (("x", 4e-4), ("y", 4e-4), ("yaw", 2e-6), ("v_x", 5e-4), ("v_y", 5e-4), ("yaw_rate", 1.3e-5)):
        assert trial.worst(name, 0) <= 0.51 * quantum, name


BIASES = [
    ("VehiclePosition", "X", 0.5, "x", 0.15),
    ("VehiclePosition", "Y", -2.0, "y", 0.15),
    ("VehicleAttitude", "Yaw", 0.05, "yaw", 0.01),
    ("VehicleMotion", "VelocityX", 2.0, "v_x", 0.3),
    ("VehicleMotion", "VelocityY", 1.0, "v_y", 0.3),
    ("VehicleMotion", "YawRate", 0.2, "yaw_rate", 0.03),
    ("VehicleMotion", "YawRate", -0.05, "yaw_rate", 0.03),
]


@pytest.mark.parametrize(("message", "signal", "bias", "name", "left"), BIASES)
def test_a_bias_is_found_in_the_cycle_it_comes_in_and_is_not_used(
    message: str, signal: str, bias: float, name: str, left: float
) -> None:
    trial = Trial(put(message, signal, lambda value, _: value + bias))
    assert trial.detected_after() == 0
    assert trial.causes[-1] is Cause.SENSOR_IMPLAUSIBLE
    assert trial.worst(name) <= left
    for other, most in (("x", 0.15), ("y", 0.15), ("yaw", 0.01), ("v_x", 0.3), ("v_y", 0.3), ("yaw_rate", 0.03)):
        assert trial.worst(other) <= most, other


STUCK = [
    ("VehiclePosition", "X", 1),
    ("VehiclePosition", "Y", 20),
    ("VehicleAttitude", "Yaw", 12),
    ("VehicleMotion", "YawRate", 90),  # 70 cycles of it until it is wrong by more than quantisation and model
]


@pytest.mark.parametrize(("message", "signal", "within"), STUCK)
def test_a_value_that_does_not_move_while_the_vehicle_does_is_found(message: str, signal: str, within: int) -> None:
    found = Trial(stuck(message, signal)).detected_after()
    assert found is not None
    assert found <= within


def test_a_speed_that_stays_while_the_vehicle_brakes_is_found_once_it_is_wrong_by_enough() -> None:
    trial = Trial(stuck("VehicleMotion", "VelocityX"), drive=Drive(v_x=lambda t: 20.0 - 3.0 * t))
    found = trial.detected_after()
    assert found is not None
    assert found <= 14
    assert trial.worst("v_x") <= 0.45


@pytest.mark.parametrize(
    ("message", "signal", "value"),
    [("VehicleMotion", "VelocityX", math.nan), ("VehicleMotion", "YawRate", 1.6), ("VehiclePosition", "X", 13000.0)],
)
def test_what_cannot_be_is_not_used(message: str, signal: str, value: float) -> None:
    trial = Trial(put(message, signal, lambda _, __: value))
    assert trial.detected_after() == 0
    assert trial.worst("v_x") <= 0.3
    assert trial.worst("x") <= 0.15


@pytest.mark.parametrize("message", SENSORS)
def test_a_sensor_that_is_gone_is_replaced(message: str) -> None:
    trial = Trial(drop(message))
    assert trial.causes[BEGIN : BEGIN + LOST_CYCLES - 1] == [Cause.SENSOR_MISSING] * (LOST_CYCLES - 1)
    assert set(trial.causes[BEGIN + LOST_CYCLES - 1 :]) == {Cause.SENSOR_LOST}
    for name, most in (("x", 0.2), ("y", 0.2), ("yaw", 0.01), ("v_x", 0.1), ("v_y", 0.2), ("yaw_rate", 0.03)):
        assert trial.worst(name) <= most, name


def test_without_motion_and_attitude_the_wheels_tell_the_yaw_rate() -> None:
    trial = Trial(drop("VehicleMotion", "VehicleAttitude"))
    assert trial.worst("yaw_rate") <= 1e-3
    assert trial.worst("v_x") <= 0.01


@pytest.mark.parametrize("yaw", [0.0, 0.6, -2.0])
def test_from_a_known_start_the_first_cycle_finds_the_vehicle_there_without_any_sensor(yaw: float) -> None:
    own = OwnMotion(VehicleParameters())
    own.start_from(40.0, 3.5, yaw, 15.0)
    state = own.update(dict.fromkeys(SENSORS))
    assert state is not None
    assert (state.x, state.y, state.yaw) == pytest.approx((40.0, 3.5, yaw), abs=1e-9)
    assert (state.v_x, state.v_y, state.yaw_rate) == (15.0, 0.0, 0.0)


def test_before_the_first_whole_pose_the_own_motion_is_unknown() -> None:
    own, frames = OwnMotion(VehicleParameters()), Drive().frames()
    for missing in ("VehiclePosition", "VehicleAttitude"):
        assert own.update({**frames, missing: None}) is None
        assert own.cause is Cause.OWN_MOTION_LOST
    state = own.update(frames)
    assert state is not None
    assert (state.x, state.y, state.yaw) == (0.0, pytest.approx(3.5), 0.0)
    assert own.cause is Cause.NONE


@pytest.mark.parametrize(
    ("yaw", "v_y", "course"),
    [(0.1, 0.0, 0.1), (0.0, 10.0, math.pi / 4), (math.pi - 0.1, 10.0, math.pi / 4 - math.pi - 0.1)],
)
def test_speed_and_course_are_those_of_the_centre_of_mass(yaw: float, v_y: float, course: float) -> None:
    state = OwnState(0.0, 0.0, yaw, 10.0, v_y, 0.0)
    assert state.speed == pytest.approx(math.sqrt(100.0 + v_y**2))
    assert state.course == pytest.approx(course)


def test_a_wheel_that_slips_or_lies_is_left_out() -> None:
    trial = Trial(put("WheelSpeedsRear", "WheelSpeedRL", lambda value, _: value + 20.0))
    assert trial.detected_after() == 0
    assert trial.worst("v_x") <= 1e-3


def test_without_any_sensor_the_motion_is_held_for_a_while_and_then_unknown() -> None:
    trial = Trial(drop(*SENSORS))
    assert all(state is not None for state in trial.states[: BEGIN + LOST_CYCLES])
    assert set(trial.states[BEGIN + LOST_CYCLES :]) == {None}
    assert set(trial.causes[BEGIN + LOST_CYCLES :]) == {Cause.OWN_MOTION_LOST}


def test_what_has_recovered_is_believed_again_after_a_while() -> None:
    def change(frames: Frames, cycle: int) -> None:
        if cycle < BEGIN + 30:
            put("VehiclePosition", "X", lambda value, _: value + 5.0)(frames, cycle)

    trial = Trial(change)
    last = max(cycle for cycle, cause in enumerate(trial.causes) if cause is not Cause.NONE)
    assert last == BEGIN + 30 + RECOVERY_CYCLES - 2
    assert trial.worst("x", last + 1) < 1e-3


def test_a_position_comes_back_after_a_long_absence() -> None:
    trial = Trial(lambda frames, c: drop("VehiclePosition")(frames, c) if c < 450 else None, cycles=500)
    assert trial.causes[449] is Cause.SENSOR_LOST
    assert set(trial.causes[451:]) == {Cause.NONE}


def test_cycles_that_the_ecu_was_not_there_for_are_no_fault() -> None:
    drive, own = Drive(), OwnMotion(VehicleParameters())
    last = -1
    for cycle in range(200):
        frames = drive.frames()
        if cycle % 7 in (3, 4) or 100 < cycle < 105:
            continue
        own.update(frames, cycle - last)
        last = cycle
        assert own.cause is Cause.NONE, cycle


def test_from_a_known_start_a_position_is_found_that_was_wrong_from_the_first_frame_on() -> None:
    drive, own = Drive(yaw_rate=lambda _: 0.1), OwnMotion(VehicleParameters())
    own.start_from(drive.x, drive.y, drive.yaw, 20.0)
    for _ in range(300):
        y = drive.y
        frames = drive.frames()
        put("VehiclePosition", "Y", lambda value, _: value + 2.0)(frames, 0)
        state = own.update(frames)
        assert own.cause is Cause.SENSOR_IMPLAUSIBLE
        assert state is not None
        assert state.y == pytest.approx(y, abs=0.2)
