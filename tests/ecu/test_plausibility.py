"""Every sensor against the others: nothing is blamed without a fault, and with one the right one is, and replaced."""

import math
from collections.abc import Callable

import pytest

from bench.bus.codec import DBC_DIR, Codec
from bench.bus.states import Cause
from bench.ecu.plausibility import (
    DRIFT,
    POSITION_M,
    RECOVERY_CYCLES,
    VELOCITY_X_MPS,
    VELOCITY_Y_MPS,
    WHEEL_MPS,
    YAW_RAD,
    YAW_RATE_RADPS,
    OwnMotion,
    OwnState,
)
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
    [
        ("VehicleMotion", "VelocityX", math.nan),
        ("VehicleMotion", "VelocityY", 32.0),
        ("VehicleMotion", "YawRate", 1.6),
        ("VehiclePosition", "X", 13000.0),
        ("VehiclePosition", "Y", -13000.0),
        ("VehicleAttitude", "Yaw", 16.0),
    ],
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


# Exact frames, and values at a limit and just beyond it.

VEHICLE = VehicleParameters()
T = 0.01


def at(
    x: float = 0.0,
    y: float = 0.0,
    yaw: float = 0.0,
    *,
    v_x: float = 0.0,
    v_y: float = 0.0,
    yaw_rate: float = 0.0,
    wheels: tuple[float, float, float, float] | float | None = None,
) -> Frames:
    """Sensor frames with these values; the wheels' are speeds (m/s) over ground of fl, fr, rl, rr, by default `v_x`."""
    over_ground = wheels if isinstance(wheels, tuple) else (v_x if wheels is None else wheels,) * 4
    fl, fr, rl, rr = (speed / VEHICLE.R_w for speed in over_ground)
    return {
        "VehiclePosition": {"X": x, "Y": y},
        "VehicleAttitude": {"Yaw": yaw, "Roll": 0.0},
        "VehicleMotion": {"VelocityX": v_x, "VelocityY": v_y, "YawRate": yaw_rate},
        "WheelSpeedsFront": {"WheelSpeedFL": fl, "WheelSpeedFR": fr},
        "WheelSpeedsRear": {"WheelSpeedRL": rl, "WheelSpeedRR": rr},
    }


def without(frames: Frames, *messages: str) -> Frames:
    return frames | dict.fromkeys(messages)


def after(*cycles: Frames, own: OwnMotion | None = None) -> tuple[OwnMotion, OwnState]:
    """The own motion after these cycles, and what it says in the last."""
    own = own or OwnMotion(VEHICLE)
    state = None
    for frames in cycles:
        state = own.update(frames)
    assert state is not None
    return own, state


def beyond(limit: float) -> float:
    """The next number away from zero."""
    return math.nextafter(limit, math.copysign(math.inf, limit))


@pytest.mark.parametrize(
    ("before", "value", "positions", "wheels", "believed"),
    [
        (0.0, VELOCITY_X_MPS, 0.0, 0.0, True),
        (0.0, -VELOCITY_X_MPS, 0.0, 0.0, True),
        (0.0, beyond(VELOCITY_X_MPS), 0.0, 0.0, False),
        (0.0, beyond(-VELOCITY_X_MPS), 0.0, 0.0, False),
        # Without a jump the wheels decide, and a value as near to them as the positions are is believed.
        (0.2, 0.4, 0.0, 0.4, True),
        (0.2, 0.4, 0.0, 0.2, True),
        (0.2, 0.4, 0.0, 0.19, False),
        (0.2, 0.4, 0.0, None, True),
        # A jump that no wheel outvotes: one where the positions stay at what was, and by more than the limit.
        (0.0, 0.7, 0.3, 0.7, False),
        (0.0, 0.7, 0.31, 0.7, True),
        (0.0, 0.3, -0.1, 0.3, True),
        (0.0, beyond(0.3), -0.1, 0.3, False),
        (0.0, 0.4, 0.0, None, False),
        (10.0, 10.7, 10.0, 10.7, False),
    ],
)
def test_v_x_is_believed_while_positions_agree_or_the_wheels_side_with_it(
    before: float, value: float, positions: float, wheels: float | None, believed: bool
) -> None:
    second = at(T * positions, v_x=value, wheels=wheels)
    if wheels is None:
        second = without(second, "WheelSpeedsFront", "WheelSpeedsRear")
    own, state = after(at(v_x=before), second)
    assert (own.cause is not Cause.SENSOR_IMPLAUSIBLE) is believed
    assert state.v_x == pytest.approx(value if believed else before if wheels is None else wheels, abs=1e-12)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_v_y_is_believed_up_to_its_limit_from_that_of_the_positions(sign: float) -> None:
    own, state = after(at(), at(v_y=sign * VELOCITY_Y_MPS))
    assert (own.cause, state.v_y) == (Cause.NONE, sign * VELOCITY_Y_MPS)
    own, state = after(at(), at(v_y=beyond(sign * VELOCITY_Y_MPS)))
    assert (own.cause, state.v_y) == (Cause.SENSOR_IMPLAUSIBLE, 0.0)
    # No jump: steady cornering outvotes it.
    own, state = after(at(), at(v_y=sign * 0.2), at(v_y=sign * 0.4))
    assert (own.cause, state.v_y) == (Cause.SENSOR_IMPLAUSIBLE, 0.0)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_yaw_rate_is_believed_up_to_its_limit_from_that_of_the_yaw(sign: float) -> None:
    own, state = after(at(), at(yaw_rate=sign * YAW_RATE_RADPS))
    assert (own.cause, state.yaw_rate) == (Cause.NONE, sign * YAW_RATE_RADPS)
    own, state = after(at(), at(yaw_rate=beyond(sign * YAW_RATE_RADPS)))
    assert (own.cause, state.yaw_rate) == (Cause.SENSOR_IMPLAUSIBLE, 0.0)
    # No jump, and farther from its last value than the yaw's is, or nearer.
    own, state = after(at(), at(yaw_rate=sign * 0.01), at(yaw_rate=sign * 0.035))
    assert (own.cause, state.yaw_rate) == (Cause.SENSOR_IMPLAUSIBLE, 0.0)
    own, state = after(at(), at(yaw_rate=sign * 0.025), at(yaw_rate=sign * 0.035))
    assert (own.cause, state.yaw_rate) == (Cause.NONE, sign * 0.035)


@pytest.mark.parametrize("yaw", [0.0, 0.7, -2.0])
@pytest.mark.parametrize("yaw_rate", [0.5, -0.5])
@pytest.mark.parametrize(("name", "limit"), [("v_x", VELOCITY_X_MPS), ("v_y", VELOCITY_Y_MPS)])
def test_positions_tell_the_velocity_along_and_across_a_vehicle_that_turns(
    yaw: float, yaw_rate: float, name: str, limit: float
) -> None:
    # From one cycle to the next it moves along the chord of its circle.
    chord = yaw + 0.5 * T * yaw_rate
    pose = (T * 20.0 * math.cos(chord), T * 20.0 * math.sin(chord), yaw + T * yaw_rate)
    for error, cause in (
        (limit - 1e-9, Cause.NONE),
        (1e-9 - limit, Cause.NONE),
        (limit + 1e-9, Cause.SENSOR_IMPLAUSIBLE),
        (-1e-9 - limit, Cause.SENSOR_IMPLAUSIBLE),
    ):
        velocity = {"v_x": 20.0, "v_y": 0.0}
        velocity[name] += error
        own, _ = after(at(yaw=yaw, v_x=20.0, yaw_rate=yaw_rate), at(*pose, **velocity, yaw_rate=yaw_rate, wheels=20.0))
        assert own.cause is cause, error


@pytest.mark.parametrize(
    ("name", "limit"), [("x", POSITION_M), ("x", -POSITION_M), ("y", POSITION_M), ("yaw", YAW_RAD), ("yaw", -YAW_RAD)]
)
def test_a_pose_is_believed_up_to_its_limit_from_dead_reckoning(name: str, limit: float) -> None:
    own, state = after(at(), at(**{name: limit}))
    assert (own.cause, getattr(state, name)) == (Cause.NONE, limit)
    own, state = after(at(), at(**{name: beyond(limit)}))
    assert (own.cause, getattr(state, name)) == (Cause.SENSOR_IMPLAUSIBLE, 0.0)


@pytest.mark.parametrize(("name", "limit"), [("x", POSITION_M), ("y", POSITION_M), ("yaw", YAW_RAD)])
def test_dead_reckoning_takes_a_twentieth_of_its_error_away_in_a_cycle(name: str, limit: float) -> None:
    first = at(**{name: limit})
    for excess, cause in ((-1e-9, Cause.NONE), (1e-9, Cause.SENSOR_IMPLAUSIBLE)):
        own, state = after(at(), first, at(**{name: 1.05 * limit + excess}))
        assert own.cause is cause
        assert getattr(state, name) == pytest.approx(1.05 * limit if cause is Cause.NONE else 0.05 * limit, abs=2e-9)


@pytest.mark.parametrize("v_x", [20.0, -4.0])
@pytest.mark.parametrize("name", ["x", "y"])
def test_the_limit_of_a_position_grows_with_the_way_gone_without_one(v_x: float, name: str) -> None:
    gone = T * abs(v_x) * 31
    for excess, cause in ((-1e-6, Cause.NONE), (1e-6, Cause.SENSOR_IMPLAUSIBLE)):
        blind = [without(at(v_x=v_x), "VehiclePosition")] * 30
        position = {"x": T * v_x * 32, "y": 0.0}
        position[name] += POSITION_M + DRIFT * gone + excess
        own, _ = after(at(v_x=v_x), at(T * v_x, v_x=v_x), *blind, at(**position, v_x=v_x))
        assert own.cause is cause


def test_the_limit_of_a_position_grows_until_both_its_coordinates_are_believed() -> None:
    off = [at(T * 20.0 * cycle + 5.0, v_x=20.0) for cycle in range(1, 11)]
    for excess, believed in ((-1e-6, True), (1e-6, False)):
        y = POSITION_M + DRIFT * 20.0 * T * 11 + excess
        _, state = after(at(v_x=20.0), *off, at(T * 20.0 * 11 + 5.0, y, v_x=20.0))
        assert (state.y == y) is believed


@pytest.mark.parametrize("yaw_rate", [0.0, 0.5, -0.5])
@pytest.mark.parametrize("wheel", range(4))
def test_a_wheel_rolls_up_to_its_limit_from_the_median_of_all(wheel: int, yaw_rate: float) -> None:
    turn = 0.5 * VEHICLE.l_t * yaw_rate
    margin = 1e-9 if yaw_rate else 0.0
    for slip, cause in (
        (WHEEL_MPS - margin, Cause.NONE),
        (margin - WHEEL_MPS, Cause.NONE),
        (WHEEL_MPS + 1e-9, Cause.SENSOR_IMPLAUSIBLE),
        (-1e-9 - WHEEL_MPS, Cause.SENSOR_IMPLAUSIBLE),
    ):
        wheels = [-turn, turn, -turn, turn]
        wheels[wheel] += slip
        fl, fr, rl, rr = wheels
        own, _ = after(at(yaw_rate=yaw_rate, wheels=(fl, fr, rl, rr)))
        assert own.cause is cause, slip


@pytest.mark.parametrize(
    ("wheels", "v_x"),
    [
        ((10.0, 10.2, 10.6, 11.2), 10.4),  # between the middle two of four
        ((11.2, 10.6, 10.0, 10.2), 10.4),
        ((10.0, 10.2, 10.6, 15.0), 10.2),  # the middle one of the three that roll
        ((15.0, 10.6, 10.2, 10.0), 10.2),
        ((0.0, 10.0, 10.1, 20.0), 10.05),
        ((0.0, 0.0, 10.0, 10.0), 5.0),  # none can be told to roll
    ],
)
def test_without_motion_v_x_is_the_median_of_the_wheels_that_roll(
    wheels: tuple[float, float, float, float], v_x: float
) -> None:
    _, state = after(at(v_x=v_x), without(at(wheels=wheels), "VehicleMotion"))
    assert state.v_x == pytest.approx(v_x, abs=1e-12)


@pytest.mark.parametrize("yaw_rate", [0.5, -0.5])
@pytest.mark.parametrize("wheel", range(4))
def test_in_a_turn_each_wheel_tells_the_speed_of_the_middle(yaw_rate: float, wheel: int) -> None:
    turn = 0.5 * VEHICLE.l_t * yaw_rate
    wheels = [10.0 - turn, 10.0 + turn, 10.0 - turn, 10.0 + turn]
    wheels[wheel] += 5.0
    fl, fr, rl, rr = wheels
    own, state = after(at(v_x=10.0, yaw_rate=yaw_rate, wheels=(fl, fr, rl, rr)))
    assert own.cause is Cause.SENSOR_IMPLAUSIBLE
    # A speed that positions and, without the wheel that lies, all wheels contradict.
    own, state = after(
        at(T * 10.0, yaw=T * yaw_rate, v_x=11.0, yaw_rate=yaw_rate, wheels=(fl, fr, rl, rr)),
        own=own,
    )
    assert state.v_x == pytest.approx(10.0, abs=1e-9)


@pytest.mark.parametrize("yaw_rate", [0.4, -0.4])
def test_without_motion_and_yaw_the_yaw_rate_is_what_both_axles_tell(yaw_rate: float) -> None:
    turn = 0.5 * VEHICLE.l_t * yaw_rate
    gone = ("VehicleMotion", "VehicleAttitude")
    _, state = after(at(v_x=10.0), without(at(wheels=(10.0 - turn, 10.0 + turn, 10.0 - turn, 10.0 + turn)), *gone))
    assert state.yaw_rate == pytest.approx(yaw_rate)
    for one_axle in ((10.0 - turn, 10.0 + turn, 10.0, 10.0), (10.0, 10.0, 10.0 - turn, 10.0 + turn)):
        _, state = after(at(v_x=10.0), without(at(wheels=one_axle), *gone))
        assert state.yaw_rate == pytest.approx(0.5 * yaw_rate)
    for axle in ("WheelSpeedsFront", "WheelSpeedsRear"):
        _, state = after(at(v_x=10.0, yaw_rate=0.01), without(at(wheels=5.0), *gone, axle))
        assert (state.yaw_rate, state.v_x) == (0.01, 10.0)


def test_a_yaw_that_is_not_believed_does_not_tell_the_yaw_rate_either() -> None:
    spinning = [without(at(yaw=0.1 * cycle), "VehicleMotion") for cycle in range(1, 4)]
    own, state = after(at(), at(yaw=0.1), *spinning)
    assert own.cause is Cause.SENSOR_IMPLAUSIBLE
    assert state.yaw_rate == 0.0


def test_the_yaw_tells_the_yaw_rate_across_its_wrap_at_half_a_turn() -> None:
    frames = [at(yaw=math.remainder(3.13 + 0.005 * cycle, math.tau), yaw_rate=0.5) for cycle in range(10)]
    own = OwnMotion(VEHICLE)
    for cycle, each in enumerate(frames):
        state = own.update(without(each, "VehicleMotion") if cycle else each)
        assert state is not None
        assert state.yaw_rate == pytest.approx(0.5)
        # It goes on beyond half a turn.
        assert state.yaw == pytest.approx(3.13 + 0.005 * cycle)


@pytest.mark.parametrize("yaw_rate", [0.5, -0.5])
def test_several_whole_turns_are_no_fault(yaw_rate: float) -> None:
    class Wrapped(Drive):
        def frames(self) -> Frames:
            frames = super().frames()
            attitude = frames["VehicleAttitude"]
            assert attitude is not None
            attitude["Yaw"] = math.remainder(attitude["Yaw"], math.tau)
            return frames

    trial = Trial(drive=Wrapped(v_x=lambda _: 5.0, yaw_rate=lambda _: yaw_rate), cycles=2000)
    assert set(trial.causes) == {Cause.NONE}
    assert trial.worst("yaw", 0) <= 1.1e-6


def test_v_y_of_a_sensor_that_lies_is_that_of_steady_cornering() -> None:
    trial = Trial(put("VehicleMotion", "VelocityY", lambda value, _: value + 1.0))
    assert trial.worst("v_y") <= 2e-4


@pytest.mark.parametrize(("v_x", "yaw_rate"), [(5.0, 0.8), (20.0, 0.3), (20.0, -0.3), (5.0, -0.8), (15.0, 0.0)])
@pytest.mark.parametrize("drift", [0.002, -0.002])
def test_of_yaw_and_yaw_rate_the_one_that_drifts_is_blamed(v_x: float, yaw_rate: float, drift: float) -> None:
    """Slowly, so that from one cycle to the next neither jumps: the positions tell which of both it is."""

    def drive() -> Drive:
        return Drive(v_x=lambda _: v_x, yaw_rate=lambda _: yaw_rate)

    def drifting(value: float, cycle: int) -> float:
        return value + drift * (cycle - BEGIN)

    rate = Trial(put("VehicleMotion", "YawRate", drifting), drive=drive(), cycles=110)
    assert rate.causes[-1] is Cause.SENSOR_IMPLAUSIBLE
    assert rate.worst("yaw") <= 1.1e-6
    assert rate.worst("yaw_rate") <= 0.07
    yaw = Trial(put("VehicleAttitude", "Yaw", drifting), drive=drive(), cycles=110)
    assert yaw.causes[-1] is Cause.SENSOR_IMPLAUSIBLE
    assert yaw.worst("yaw") <= 0.01
    assert yaw.worst("yaw_rate") <= 6.3e-6


def test_a_signal_is_believed_again_only_after_it_has_agreed_for_that_many_cycles_in_a_row() -> None:
    own, _ = after(at(), at(x=1.0))
    for _ in range(3):
        after(*[at()] * (RECOVERY_CYCLES - 1), own=own)
        assert own.cause is Cause.SENSOR_IMPLAUSIBLE
        after(at(x=1.0), own=own)
    after(*[at()] * RECOVERY_CYCLES, own=own)
    assert own.cause is Cause.NONE


def test_what_is_not_believed_must_agree_with_its_second_source_whatever_the_third_says() -> None:
    own, _ = after(at(), at(v_x=2.0, wheels=0.0))
    for cycle in range(1, 2 * RECOVERY_CYCLES):
        # The wheels spin with it, the vehicle stands.
        after(at(v_x=2.0), own=own)
        assert own.cause is Cause.SENSOR_IMPLAUSIBLE, cycle


def test_nothing_is_known_or_wrong_before_the_first_cycle_and_without_a_start_the_vehicle_stands_then() -> None:
    own = OwnMotion(VEHICLE)
    assert (own.state, own.cause) == (None, Cause.NONE)
    _, state = after(without(at(1.0, 2.0, 3.0), "VehicleMotion", "WheelSpeedsFront", "WheelSpeedsRear"), own=own)
    assert state == OwnState(1.0, 2.0, 3.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("seen", [(), ("WheelSpeedsFront",), ("WheelSpeedsRear",)])
def test_without_motion_one_axle_is_as_little_as_none(seen: tuple[str, ...]) -> None:
    gone = without(at(), *({"VehicleMotion", "WheelSpeedsFront", "WheelSpeedsRear"} - {*seen}))
    own, _ = after(at(), *[gone] * LOST_CYCLES)
    assert own.update(gone) is None
    assert own.cause is Cause.OWN_MOTION_LOST
    # The motion is held for as long wherever it begins, and cycles in which this ECU was not there count.
    own = OwnMotion(VEHICLE)
    own.start_from(0.0, 0.0, 0.0, 0.0)
    after(*[gone] * LOST_CYCLES, own=own)
    assert own.update(gone) is None
    own, _ = after(at())
    assert own.update(gone, LOST_CYCLES) is not None
    own, _ = after(at())
    assert own.update(gone, LOST_CYCLES + 1) is None


def test_a_sensor_that_never_came_is_lost_after_its_timeout() -> None:
    own = OwnMotion(VEHICLE)
    for cycle in range(1, LOST_CYCLES + 1):
        after(without(at(), "VehicleMotion"), own=own)
        assert own.cause is (Cause.SENSOR_LOST if cycle == LOST_CYCLES else Cause.SENSOR_MISSING)
    after(without(at(1.0), "VehicleMotion"), own=own)
    assert own.cause is Cause.SENSOR_IMPLAUSIBLE  # the graver cause of two


@pytest.mark.parametrize("excess", [-1e-9, 1e-9])
def test_from_a_known_start_the_first_position_and_yaw_are_held_against_it(excess: float) -> None:
    for name, limit in (("x", POSITION_M), ("y", POSITION_M), ("yaw", YAW_RAD)):
        own = OwnMotion(VEHICLE)
        own.start_from(0.0, 0.0, 0.0, 0.0)
        _, state = after(at(**{name: limit + excess}), own=own)
        assert own.cause is (Cause.NONE if excess < 0.0 else Cause.SENSOR_IMPLAUSIBLE)
        assert getattr(state, name) == (limit + excess if excess < 0.0 else 0.0)


def test_yaw_and_yaw_rate_contradict_each_other_beyond_the_limit_of_the_yaw() -> None:
    for yaw, cause in ((YAW_RAD, Cause.NONE), (beyond(YAW_RAD), Cause.SENSOR_IMPLAUSIBLE)):
        own, state = after(at(v_x=20.0), at(T * 20.0 * math.cos(yaw), T * 20.0 * math.sin(yaw), yaw, v_x=20.0))
        assert own.cause is cause
        # The vehicle moves along the measured yaw, so it is the yaw rate that is wrong.
        assert state.yaw == yaw


def test_from_a_known_start_a_yaw_rate_that_is_wrong_from_the_first_frame_on_is_blamed() -> None:
    own = OwnMotion(VEHICLE)
    own.start_from(0.0, 0.0, 0.0, 20.0)
    for cycle in range(3):
        _, state = after(at(T * 20.0 * cycle, v_x=20.0, yaw_rate=1.0), own=own)
        assert state.yaw == 0.0
    assert own.cause is Cause.SENSOR_IMPLAUSIBLE
    assert state.yaw_rate == 0.0


def test_where_yaw_and_yaw_rate_contradict_each_other_no_single_position_decides() -> None:
    """A position may be off by some quanta: 2 mm are 0.2 m/s, more than either yaw makes."""

    def blamed(off: int | None) -> tuple[int, float]:
        def change(frames: Frames, cycle: int) -> None:
            put("VehicleMotion", "YawRate", lambda value, _: value + 0.002 * (cycle - BEGIN))(frames, cycle)
            if cycle == off:
                put("VehiclePosition", "Y", lambda value, _: value + 0.002)(frames, cycle)

        trial = Trial(change, drive=Drive(yaw_rate=lambda _: 0.0), cycles=110)
        return trial.detected_after() or 0, trial.worst("yaw")

    found, off = blamed(None)
    assert off <= 1.1e-6
    for cycle in range(BEGIN + found - 3, BEGIN + found + 1):
        assert blamed(cycle) == (found, off), cycle
