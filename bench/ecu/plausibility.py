"""What a vehicle knows of its own motion, with every sensor checked against what the others say.

Analytic redundancy on the vehicle's bus: sources for each component of the motion, of which two outvote one, and dead
reckoning for the pose, which no sensor measures twice. A value that jumps where its second source does not is wrong.

| signal | second source | third source |
|---|---|---|
| VelocityX | position from frame to frame | wheel speeds |
| VelocityY | position from frame to frame | steady cornering of the nominal vehicle |
| YawRate | yaw from frame to frame | its own last value; in the long run, see Yaw |
| X, Y | dead reckoning by the velocities | |
| Yaw | dead reckoning by the yaw rate | positions: which of both yaws has the vehicle moving the way it does |

What is found implausible is replaced by its other sources, and taken up again when it has agreed with them for
`RECOVERY_CYCLES`. As long as nothing is wrong, the measured values are used as they are.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

from bench.bus.quantities import ATTITUDE, MOTION, POSITION, SENSORS, WHEELS_FRONT, WHEELS_REAR
from bench.bus.states import Cause
from bench.bus.topic import Signals
from bench.cycle import CYCLE_S
from bench.ecu.limits import limits_of, possible, timeout_cycles
from platoon_fmu.parameters import VehicleParameters

RECOVERY_CYCLES = 20
"""Cycles in a row that a signal must agree with the others before it is believed again."""

VELOCITY_X_MPS = 0.3
"""Disagreement (m/s) that makes two sources of v_x two: seven times the quantisation of position differences."""

VELOCITY_Y_MPS = 0.3
YAW_RATE_RADPS = 0.03
WHEEL_MPS = 2.0
"""Slip of a wheel (m/s) that is no rolling any more."""

POSITION_M = 0.1
YAW_RAD = 0.006
"""Pose errors (m, rad) against dead reckoning that are no quantisation. With `_PULL`, a velocity that is wrong by less
than its own limit above makes less than these: so the pose is not blamed for what a velocity did."""

YAW_SMOOTHING = 0.3
"""Share of the newest cycle in what tells which of two yaws is wrong: positions are quantised."""

DRIFT = 0.01
"""How far dead reckoning may be off, as a share of the way gone since the last position that was believed."""

_PULL = 0.05
"""Share of its error that dead reckoning takes away in each cycle in which the measured pose is believed."""

_POSITION = ("X", "Y")
_MOTION = ("VelocityX", "VelocityY", "YawRate")


@dataclass(frozen=True, slots=True)
class OwnState:
    """The own motion as well as it is known.

    Attributes:
        x: position of the centre of mass along the road (m).
        y: position to the left (m).
        yaw: heading (rad).
        v_x: longitudinal velocity (m/s).
        v_y: lateral velocity (m/s).
        yaw_rate: rad/s.
    """

    x: float
    y: float
    yaw: float
    v_x: float
    v_y: float
    yaw_rate: float

    @property
    def course(self) -> float:
        """Direction of motion (rad), -pi to pi."""
        return math.remainder(self.yaw + math.atan2(self.v_y, self.v_x), 2.0 * math.pi)

    @property
    def speed(self) -> float:
        """Speed of the centre of mass (m/s)."""
        return math.hypot(self.v_x, self.v_y)


class _Velocity(NamedTuple):
    v_x: float
    v_y: float
    gamma: float


class _Pose(NamedTuple):
    x: float
    y: float
    yaw: float


class _Trust:
    """Whether a signal is believed: not from its first disagreement on, until it has agreed for long enough."""

    __slots__ = ("_agreed", "given")

    def __init__(self) -> None:
        self.given = True
        self._agreed = 0

    def note(self, *, agrees: bool) -> bool:
        """Take in one cycle's comparison; whether the signal is believed."""
        if not agrees:
            self.given, self._agreed = False, 0
        elif not self.given:
            self._agreed += 1
            self.given = self._agreed >= RECOVERY_CYCLES
        return self.given


class OwnMotion:
    """Brings the own motion up to each cycle.

    Attributes:
        state: the own motion; None before the first pose and while nothing tells how the vehicle moves.
        cause: what is wrong with the sensors in this cycle.
    """

    def __init__(self, vehicle: VehicleParameters) -> None:
        """Know the vehicle's nominal parameters."""
        self.state: OwnState | None = None
        self.cause = Cause.NONE
        self._vehicle = vehicle
        self._trust = {name: _Trust() for name in (*_POSITION, "Yaw", *_MOTION, "FL", "FR", "RL", "RR")}
        self._limits = {name: limits_of("vehicle.dbc", name) for name in (POSITION, ATTITUDE, MOTION)}
        self._pose: _Pose | None = None
        self._reckoned = _Pose(0.0, 0.0, 0.0)
        self._measured_position: tuple[float, float] | None = None
        self._measured_yaw: float | None = None
        self._moved: tuple[float, float] | None = None
        self._slip_errors = [0.0, 0.0]
        self._velocity = _Velocity(0.0, 0.0, 0.0)
        self._timeouts = {name: timeout_cycles("vehicle.dbc", name) for name in SENSORS}
        self._missing = dict.fromkeys(SENSORS, 0)
        self._blind = 0
        self._way = 0.0

    def start_from(self, x: float, y: float, yaw: float, speed: float) -> None:
        """Know where the vehicle is in the first cycle, before any sensor has told (m, m, rad, m/s)."""
        back = CYCLE_S * speed
        self._pose = self._reckoned = _Pose(x - back * math.cos(yaw), y - back * math.sin(yaw), yaw)
        self._velocity = _Velocity(speed, 0.0, 0.0)

    def update(self, frames: Mapping[str, Signals | None], cycles: int = 1) -> OwnState | None:
        """Take in one cycle's sensor frames; the own motion in that cycle.

        Args:
            frames: those of `SENSORS` by name, None for each that is missing; others are left aside.
            cycles: since the last call: more than one where this ECU was not there for some.
        """
        if cycles != 1:
            self._measured_position = self._measured_yaw = None
        position, position_fine = self._in_range(frames, POSITION, _POSITION)
        attitude, attitude_fine = self._in_range(frames, ATTITUDE, ("Yaw",))
        motion, motion_fine = self._in_range(frames, MOTION, _MOTION)
        front, rear = frames[WHEELS_FRONT], frames[WHEELS_REAR]
        velocity = self._velocities(position, attitude, motion, front, rear)
        seen = motion is not None or (front is not None and rear is not None)
        self._blind = 0 if seen else self._blind + cycles
        self._reckon(velocity, position, attitude, cycles * CYCLE_S)
        self._velocity = velocity
        self._measured_position = None if position is None else (position["X"], position["Y"])
        self._measured_yaw = None if attitude is None else attitude["Yaw"]
        # As long as its timeout a velocity may be held when nothing at all tells it.
        known = self._pose is not None and self._blind <= self._timeouts[MOTION]
        self.state = OwnState(*self._pose, *velocity) if self._pose is not None and known else None
        self._missing = {name: count + 1 if frames[name] is None else 0 for name, count in self._missing.items()}
        self.cause = self._cause(known, in_range=position_fine and attitude_fine and motion_fine)
        return self.state

    def _in_range(
        self, frames: Mapping[str, Signals | None], name: str, signals: tuple[str, ...]
    ) -> tuple[Signals | None, bool]:
        """A frame, None where it is missing or its signals cannot be; and whether they can."""
        fine = possible(self._limits[name], frames[name], signals)
        return frames[name] if fine else None, fine

    def _velocities(
        self,
        position: Signals | None,
        attitude: Signals | None,
        motion: Signals | None,
        front: Signals | None,
        rear: Signals | None,
    ) -> _Velocity:
        """As measured where they are believed, else from their other sources."""
        gamma = self._yaw_rate(attitude, motion, front, rear)
        along, across = self._from_positions(position)
        v_x = self._longitudinal(motion, along, self._wheel_speed(gamma, front, rear))
        steady = gamma * (
            self._vehicle.l_r
            - self._vehicle.M * self._vehicle.l_f * v_x**2 / (2.0 * self._vehicle.L * self._vehicle.C_r)
        )
        v_y = self._voted("VelocityY", motion, across, steady, VELOCITY_Y_MPS, self._velocity.v_y)
        return _Velocity(v_x, steady if v_y is None else v_y, gamma)

    def _yaw_rate(
        self, attitude: Signals | None, motion: Signals | None, front: Signals | None, rear: Signals | None
    ) -> float:
        turned = None
        if attitude is not None and self._measured_yaw is not None:
            turned = math.remainder(attitude["Yaw"] - self._measured_yaw, 2.0 * math.pi) / CYCLE_S
        before = self._velocity.gamma
        gamma = self._voted("YawRate", motion, turned, before, YAW_RATE_RADPS, before)
        if gamma is not None:
            return gamma
        if turned is not None and self._trust["Yaw"].given:
            return turned
        if front is not None and rear is not None:
            right, left = front["WheelSpeedFR"] + rear["WheelSpeedRR"], front["WheelSpeedFL"] + rear["WheelSpeedRL"]
            return 0.5 * (right - left) * self._vehicle.R_w / self._vehicle.l_t
        return before

    def _longitudinal(self, motion: Signals | None, along: float | None, rolling: float | None) -> float:
        v_x = self._voted("VelocityX", motion, along, rolling, VELOCITY_X_MPS, self._velocity.v_x)
        if v_x is not None:
            return v_x
        return self._velocity.v_x if rolling is None else rolling

    def _voted(
        self,
        name: str,
        motion: Signals | None,
        second: float | None,
        third: float | None,
        limit: float,
        before: float,
    ) -> float | None:
        """The measured value, None where it is missing or not believed."""
        if motion is None:
            return None
        value, trust = motion[name], self._trust[name]
        agrees = second is None or abs(value - second) <= limit
        if second is not None and not agrees and trust.given:
            jumped = abs(value - before) > limit >= abs(second - before)
            outvoted = third is not None and abs(value - third) > abs(second - third)
            agrees = not (jumped or outvoted)
        return value if trust.note(agrees=agrees) else None

    def _from_positions(self, position: Signals | None) -> tuple[float | None, float | None]:
        """Velocity along and across the vehicle (m/s) since the last cycle's position."""
        before = self._measured_position
        self._moved = None
        if position is None or before is None or self._pose is None:
            return None, None
        dx, dy = (position["X"] - before[0]) / CYCLE_S, (position["Y"] - before[1]) / CYCLE_S
        self._moved = (dx, dy)
        yaw = self._pose.yaw + 0.5 * CYCLE_S * self._velocity.gamma
        c, s = math.cos(yaw), math.sin(yaw)
        return c * dx + s * dy, c * dy - s * dx

    def _wheel_speed(self, gamma: float, front: Signals | None, rear: Signals | None) -> float | None:
        """v_x (m/s) from the wheels that roll: the median of those believed."""
        if front is None or rear is None:
            return None
        turn = 0.5 * self._vehicle.l_t * gamma
        speeds = {
            "FL": front["WheelSpeedFL"] * self._vehicle.R_w + turn,
            "FR": front["WheelSpeedFR"] * self._vehicle.R_w - turn,
            "RL": rear["WheelSpeedRL"] * self._vehicle.R_w + turn,
            "RR": rear["WheelSpeedRR"] * self._vehicle.R_w - turn,
        }
        middle = _median(list(speeds.values()))
        rolling = [v for name, v in speeds.items() if self._trust[name].note(agrees=abs(v - middle) <= WHEEL_MPS)]
        return _median(rolling) if rolling else middle

    def _reckon(
        self,
        velocity: _Velocity,
        position: Signals | None,
        attitude: Signals | None,
        elapsed_s: float,
    ) -> None:
        """Go on with dead reckoning, and compare the measured pose with it."""
        if self._pose is None:
            if position is not None and attitude is not None:
                self._pose = _Pose(position["X"], position["Y"], attitude["Yaw"])
                self._reckoned = self._pose
            return
        v_x, v_y, gamma = velocity
        x, y, yaw = self._reckoned
        yaw_now = yaw + elapsed_s * 0.5 * (self._velocity.gamma + gamma)
        middle = 0.5 * (yaw + yaw_now)
        along, across = 0.5 * (self._velocity.v_x + v_x), 0.5 * (self._velocity.v_y + v_y)
        x += elapsed_s * (along * math.cos(middle) - across * math.sin(middle))
        y += elapsed_s * (along * math.sin(middle) + across * math.cos(middle))
        self._way += elapsed_s * abs(along)
        yaw_seen = None
        if attitude is not None:
            turns = round((yaw_now - attitude["Yaw"]) / (2.0 * math.pi))
            yaw_seen = attitude["Yaw"] + 2.0 * math.pi * turns
        if yaw_seen is not None and self._yaw_rate_is_wrong(yaw_now, yaw_seen, v_y):
            self._trust["YawRate"].note(agrees=False)
            yaw_now = yaw_seen
        yaw_now, yaw_used, _ = self._compare("Yaw", yaw_now, yaw_seen, YAW_RAD)
        reach = POSITION_M + DRIFT * self._way
        x, x_used, x_good = self._compare("X", x, None if position is None else position["X"], reach)
        y, y_used, y_good = self._compare("Y", y, None if position is None else position["Y"], reach)
        if x_good and y_good:
            self._way = 0.0
        self._reckoned = _Pose(x, y, yaw_now)
        self._pose = _Pose(x_used, y_used, yaw_used)

    def _yaw_rate_is_wrong(self, reckoned: float, seen: float, v_y: float) -> bool:
        """Whether yaw (rad) and yaw rate contradict each other and the positions side with the yaw."""
        if self._moved is not None:
            dx, dy = self._moved
            back = 0.5 * CYCLE_S * self._velocity.gamma
            for index, yaw in enumerate((seen - back, reckoned - back)):
                error = math.cos(yaw) * dy - math.sin(yaw) * dx - v_y
                self._slip_errors[index] += YAW_SMOOTHING * (abs(error) - self._slip_errors[index])
        contradict = abs(seen - reckoned) > YAW_RAD and self._trust["Yaw"].given
        return contradict and self._slip_errors[0] < self._slip_errors[1]

    def _compare(self, name: str, reckoned: float, seen: float | None, limit: float) -> tuple[float, float, bool]:
        """Dead reckoning drawn to what was seen, the value to use, and whether that is what was seen."""
        if seen is None or not self._trust[name].note(agrees=abs(seen - reckoned) <= limit):
            return reckoned, reckoned, False
        return reckoned + _PULL * (seen - reckoned), seen, True

    def _cause(self, known: bool, *, in_range: bool) -> Cause:
        if not known:
            return Cause.OWN_MOTION_LOST
        if not in_range or not all(trust.given for trust in self._trust.values()):
            return Cause.SENSOR_IMPLAUSIBLE
        if any(count >= self._timeouts[name] for name, count in self._missing.items()):
            return Cause.SENSOR_LOST
        return Cause.SENSOR_MISSING if any(self._missing.values()) else Cause.NONE


def _median(values: Sequence[float]) -> float:
    ordered = sorted(values)
    half = len(ordered) // 2
    return ordered[half] if len(ordered) % 2 else 0.5 * (ordered[half - 1] + ordered[half])
