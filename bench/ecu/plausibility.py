"""The own motion, with plausibility checks of every sensor against the others.

Analytic redundancy on the vehicle's bus: several sources for each component of the motion, of which two outvote one,
and dead reckoning for the pose, which only one sensor measures. A value that jumps while its second source does not is
implausible.

| signal | second source | third source |
|---|---|---|
| VelocityX | position from frame to frame | wheel speeds |
| VelocityY | position from frame to frame | steady cornering of the nominal vehicle |
| YawRate | yaw from frame to frame | its own last value; in the long term, see Yaw |
| X, Y | dead reckoning by the velocities | |
| Yaw | dead reckoning by the yaw rate | positions: which of both yaws matches the direction of motion |

An implausible value is replaced by its other sources, and used again after it has agreed with them for
`RECOVERY_CYCLES`. If all values are plausible, they are used as measured.
"""

import math
from collections.abc import Mapping
from typing import NamedTuple

import cython

from bench.bus.quantities import ATTITUDE, MOTION, POSITION, SENSORS, WHEELS_FRONT, WHEELS_REAR
from bench.bus.states import Cause
from bench.bus.topic import Signals
from bench.cycle import CYCLE_S
from bench.ecu.limits import limits_of, timeout_cycles
from platoon_fmu.parameters import VehicleParameters

if cython.compiled:
    from cython.cimports.bench.ecu.limits import possible
    from cython.cimports.libc.math import cos, remainder, sin
else:
    from math import cos, remainder, sin

    from bench.ecu.limits import possible

RECOVERY_CYCLES = 20
"""Number of consecutive cycles in which a signal must agree with the others before it is trusted again."""

VELOCITY_X_MPS = 0.3
"""Difference (m/s) at which two sources of v_x disagree: seven times the quantisation of position differences."""

VELOCITY_Y_MPS = 0.3
YAW_RATE_RADPS = 0.03
WHEEL_MPS = 2.0
"""Slip (m/s) above which a wheel is not rolling."""

POSITION_M = 0.1
YAW_RAD = 0.006
"""Pose errors (m, rad) against dead reckoning that exceed quantisation. With `_PULL`, a velocity error below its own
limit above causes a smaller error than these, so that it is not attributed to the pose."""

YAW_SMOOTHING = 0.3
"""Weight of the newest cycle in the filter that decides which of two yaws is wrong: positions are quantised."""

DRIFT = 0.01
"""Error of dead reckoning, as a fraction of the distance travelled since the last trusted position."""

_PULL = 0.05
"""Fraction of its error that dead reckoning corrects in each cycle with a trusted measured pose."""

_POSITION = ("X", "Y")
_MOTION = ("VelocityX", "VelocityY", "YawRate")
_WHEELS = ("FL", "FR", "RL", "RR")


class OwnState(NamedTuple):
    """The best estimate of the own motion.

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


class _Velocity:
    def __init__(self, v_x: float, v_y: float, gamma: float) -> None:
        self.v_x = v_x
        self.v_y = v_y
        self.gamma = gamma


class _Pose:
    def __init__(self, x: float, y: float, yaw: float) -> None:
        self.x = x
        self.y = y
        self.yaw = yaw


class _Trust:
    """Trust in a signal: lost at its first disagreement, regained after `RECOVERY_CYCLES` of agreement."""

    def __init__(self) -> None:
        self.given = True
        self._agreed = 0

    def note(self, agrees: bool) -> bool:
        """Process one cycle's comparison and return whether the signal is trusted."""
        if not agrees:
            self.given, self._agreed = False, 0
        elif not self.given:
            self._agreed += 1
            self.given = self._agreed >= RECOVERY_CYCLES
        return self.given


class OwnMotion:
    """Estimates the own motion in each cycle.

    Attributes:
        state: the own motion; None before the first pose and while the velocity is unknown.
        cause: the sensor fault in this cycle.
    """

    def __init__(self, vehicle: VehicleParameters) -> None:
        """Create the estimator for a vehicle with these nominal parameters."""
        self.state: OwnState | None = None
        self.cause = Cause.NONE
        self._l_r = vehicle.l_r
        self._M_l_f = vehicle.M * vehicle.l_f
        self._L_C_r = 2.0 * vehicle.L * vehicle.C_r
        self._R_w = vehicle.R_w
        self._l_t = vehicle.l_t
        self._trust = {name: _Trust() for name in (*_POSITION, "Yaw", *_MOTION, *_WHEELS)}
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
        self._complete = True
        self._blind = 0
        self._way = 0.0

    def start_from(self, x: float, y: float, yaw: float, speed: float) -> None:
        """Set the pose and speed in the first cycle, before any sensor frame (m, m, rad, m/s)."""
        back = CYCLE_S * speed
        self._pose = self._reckoned = _Pose(x - back * math.cos(yaw), y - back * math.sin(yaw), yaw)
        self._velocity = _Velocity(speed, 0.0, 0.0)

    def update(self, frames: Mapping[str, Signals | None], cycles: int = 1) -> OwnState | None:
        """Process one cycle's sensor frames and return the own motion in that cycle.

        Args:
            frames: those of `SENSORS` by name, None for missing ones; others are ignored.
            cycles: since the last call; more than one if this ECU missed some.
        """
        if cycles != 1:
            self._measured_position = self._measured_yaw = None
        position, position_fine = self._in_range(frames, POSITION, _POSITION)
        attitude, attitude_fine = self._in_range(frames, ATTITUDE, ("Yaw",))
        motion, motion_fine = self._in_range(frames, MOTION, _MOTION)
        front, rear = frames[WHEELS_FRONT], frames[WHEELS_REAR]
        velocity: _Velocity = self._velocities(position, attitude, motion, front, rear)
        seen = motion is not None or (front is not None and rear is not None)
        self._blind = 0 if seen else self._blind + cycles
        self._reckon(velocity, position, attitude, cycles * CYCLE_S)
        self._velocity = velocity
        self._measured_position = None if position is None else (position["X"], position["Y"])
        self._measured_yaw = None if attitude is None else attitude["Yaw"]
        # Without any source, a velocity may be held for its timeout.
        known = self._pose is not None and self._blind <= self._timeouts[MOTION]
        self.state = None
        if self._pose is not None and known:
            pose: _Pose = self._pose
            self.state = OwnState(pose.x, pose.y, pose.yaw, velocity.v_x, velocity.v_y, velocity.gamma)
        self._complete = True
        for name in SENSORS:
            if frames[name] is not None:
                self._missing[name] = 0
            else:
                self._missing[name] += 1
                self._complete = False
        self.cause = self._cause(known, position_fine and attitude_fine and motion_fine)
        return self.state

    def _in_range(
        self, frames: Mapping[str, Signals | None], name: str, signals: tuple[str, ...]
    ) -> tuple[Signals | None, bool]:
        """Return a frame, None if it is missing or out of range; and whether it is not out of range."""
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
        """Return velocities: as measured if trusted, otherwise from their other sources."""
        gamma: cython.double = self._yaw_rate(attitude, motion, front, rear)
        along, across = self._from_positions(position)
        v_x: cython.double = self._longitudinal(motion, along, self._wheel_speed(gamma, front, rear))
        steady: cython.double = gamma * (self._l_r - self._M_l_f * (v_x * v_x) / self._L_C_r)
        v_y = self._voted("VelocityY", motion, across, steady, VELOCITY_Y_MPS, self._velocity.v_y)
        return _Velocity(v_x, steady if v_y is None else v_y, gamma)

    def _yaw_rate(
        self, attitude: Signals | None, motion: Signals | None, front: Signals | None, rear: Signals | None
    ) -> float:
        turned: float | None = None
        if attitude is not None and self._measured_yaw is not None:
            turned = remainder(attitude["Yaw"] - self._measured_yaw, 2.0 * math.pi) / CYCLE_S
        before = self._velocity.gamma
        gamma = self._voted("YawRate", motion, turned, before, YAW_RATE_RADPS, before)
        if gamma is not None:
            return gamma
        if turned is not None and self._trust["Yaw"].given:
            return turned
        if front is not None and rear is not None:
            right, left = front["WheelSpeedFR"] + rear["WheelSpeedRR"], front["WheelSpeedFL"] + rear["WheelSpeedRL"]
            return 0.5 * (right - left) * self._R_w / self._l_t
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
        limit: cython.double,
        before: cython.double,
    ) -> float | None:
        """Return the measured value; None if it is missing or not trusted."""
        if motion is None:
            return None
        value: cython.double = motion[name]
        trust: _Trust = self._trust[name]
        if second is None:
            return value if trust.note(True) else None
        other: cython.double = second
        agrees: cython.bint = abs(value - other) <= limit
        if not agrees and trust.given:
            jumped = abs(value - before) > limit >= abs(other - before)
            outvoted = third is not None and abs(value - third) > abs(other - third)
            agrees = not (jumped or outvoted)
        return value if trust.note(agrees) else None

    def _from_positions(self, position: Signals | None) -> tuple[float | None, float | None]:
        """Return the velocity along and across the vehicle (m/s) since the last cycle's position."""
        before = self._measured_position
        self._moved = None
        if position is None or before is None or self._pose is None:
            return None, None
        step_s: cython.double = CYCLE_S
        dx: cython.double = (position["X"] - before[0]) / step_s
        dy: cython.double = (position["Y"] - before[1]) / step_s
        self._moved = (dx, dy)
        yaw: cython.double = self._pose.yaw + 0.5 * step_s * self._velocity.gamma
        c: cython.double = cos(yaw)
        s: cython.double = sin(yaw)
        return c * dx + s * dy, c * dy - s * dx

    def _wheel_speed(self, gamma: cython.double, front: Signals | None, rear: Signals | None) -> float | None:
        """Return v_x (m/s) from the rolling wheels: the median of the trusted ones."""
        if front is None or rear is None:
            return None
        turn: cython.double = 0.5 * self._l_t * gamma
        radius: cython.double = self._R_w
        speeds = [
            front["WheelSpeedFL"] * radius + turn,
            front["WheelSpeedFR"] * radius - turn,
            rear["WheelSpeedRL"] * radius + turn,
            rear["WheelSpeedRR"] * radius - turn,
        ]
        middle = _median(speeds)
        rolling = []
        for name, v in zip(_WHEELS, speeds, strict=True):
            trust: _Trust = self._trust[name]
            if trust.note(abs(v - middle) <= WHEEL_MPS):
                rolling.append(v)
        return _median(rolling) if rolling else middle

    def _reckon(
        self,
        velocity: _Velocity,
        position: Signals | None,
        attitude: Signals | None,
        elapsed_s: cython.double,
    ) -> None:
        """Update dead reckoning, and compare the measured pose with it."""
        if self._pose is None:
            if position is not None and attitude is not None:
                self._pose = _Pose(position["X"], position["Y"], attitude["Yaw"])
                self._reckoned = self._pose
            return
        x: cython.double = self._reckoned.x
        y: cython.double = self._reckoned.y
        yaw: cython.double = self._reckoned.yaw
        yaw_now: cython.double = yaw + elapsed_s * 0.5 * (self._velocity.gamma + velocity.gamma)
        middle: cython.double = 0.5 * (yaw + yaw_now)
        along: cython.double = 0.5 * (self._velocity.v_x + velocity.v_x)
        across: cython.double = 0.5 * (self._velocity.v_y + velocity.v_y)
        x += elapsed_s * (along * cos(middle) - across * sin(middle))
        y += elapsed_s * (along * sin(middle) + across * cos(middle))
        self._way += elapsed_s * abs(along)
        yaw_seen = None
        if attitude is not None:
            turns = round((yaw_now - attitude["Yaw"]) / (2.0 * math.pi))
            yaw_seen = attitude["Yaw"] + 2.0 * math.pi * turns
        if yaw_seen is not None and self._yaw_rate_is_wrong(yaw_now, yaw_seen, velocity.v_y):
            self._trust["YawRate"].note(False)
            yaw_now = yaw_seen
        yaw_now, yaw_used, _ = self._compare("Yaw", yaw_now, yaw_seen, YAW_RAD)
        reach = POSITION_M + DRIFT * self._way
        x, x_used, x_good = self._compare("X", x, None if position is None else position["X"], reach)
        y, y_used, y_good = self._compare("Y", y, None if position is None else position["Y"], reach)
        if x_good and y_good:
            self._way = 0.0
        self._reckoned = _Pose(x, y, yaw_now)
        self._pose = _Pose(x_used, y_used, yaw_used)

    def _yaw_rate_is_wrong(self, reckoned: cython.double, seen: cython.double, v_y: cython.double) -> cython.bint:
        """Whether yaw (rad) and yaw rate contradict each other and the positions confirm the yaw."""
        if self._moved is not None:
            dx, dy = self._moved
            back = 0.5 * CYCLE_S * self._velocity.gamma
            for index, yaw in enumerate((seen - back, reckoned - back)):
                error = cos(yaw) * dy - sin(yaw) * dx - v_y
                self._slip_errors[index] += YAW_SMOOTHING * (abs(error) - self._slip_errors[index])
        contradict = abs(seen - reckoned) > YAW_RAD and self._trust["Yaw"].given
        return contradict and self._slip_errors[0] < self._slip_errors[1]

    def _compare(
        self, name: str, reckoned: cython.double, seen: float | None, limit: cython.double
    ) -> tuple[float, float, bool]:
        """Return the corrected dead reckoning, the value to use, and whether that is the measured one."""
        trust: _Trust = self._trust[name]
        if seen is None:
            return reckoned, reckoned, False
        value: cython.double = seen
        if not trust.note(abs(value - reckoned) <= limit):
            return reckoned, reckoned, False
        return reckoned + _PULL * (value - reckoned), seen, True

    def _cause(self, known: cython.bint, in_range: cython.bint) -> Cause:
        if not known:
            return Cause.OWN_MOTION_LOST
        trusted = in_range
        for each in self._trust.values():
            trust: _Trust = each
            trusted = trusted and trust.given
        if not trusted:
            return Cause.SENSOR_IMPLAUSIBLE
        if self._complete:
            return Cause.NONE
        lost = any(count >= self._timeouts[name] for name, count in self._missing.items())
        return Cause.SENSOR_LOST if lost else Cause.SENSOR_MISSING


def _median(values: list[float]) -> float:
    ordered = sorted(values)
    half = len(ordered) // 2
    return ordered[half] if len(ordered) % 2 else 0.5 * (ordered[half - 1] + ordered[half])
