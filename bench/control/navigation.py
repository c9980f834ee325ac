# cython: boundscheck=False, cdivision=True
"""The gamma-agent: what a vehicle's flocking law navigates to. It moves to the slot as a car can.

Olfati-Saber's gamma-agent is a dynamic agent (q_r, p_r). Here it starts from the vehicle itself and has limited
acceleration and jerk: across the road it follows one `LaneChange`, along the road a braking curve. So the vehicle
hardly ever has an error for its gains to correct, and a change of the gains makes no kink in the reference.
"""

from dataclasses import dataclass

import cython

from bench.control.lane_change import lane_change

if cython.compiled:
    from cython.cimports.bench.control.lane_change import LaneChange
    from cython.cimports.bench.control.ramp import Ramp
    from cython.cimports.libc.math import copysign, sqrt
else:
    from math import copysign, sqrt

    from bench.control.lane_change import LaneChange
    from bench.control.ramp import Ramp

BRAKING_SHARE = 0.6
"""Fraction of the largest acceleration for the braking curve; the remainder is for following it."""

CLOSING_RATE = 0.8
"""Largest rate (1/s) at which a small position error is closed."""

SPEED_RATE = 2.0
"""Largest rate (1/s) at which the speed approaches that of the braking curve."""

PER_BUILD_UP = 1.2
"""The speed's rate times the time in which the largest acceleration builds up with the largest jerk, at most: a motion
with less jerk needs more foresight."""

LEAD_BUILD_UP_S = 0.8
"""Time (s) after the start of a lane change, and before its end, in which the lead grows from nothing and falls to it:
the acceleration has no step."""


@dataclass(frozen=True)
class MotionLimits:
    """Limits of a motion.

    Attributes:
        lateral: acceleration, m/s^2.
        lateral_jerk: m/s^3.
        longitudinal: acceleration and braking, m/s^2.
        longitudinal_jerk: averaged over half a second, m/s^3.
    """

    lateral: float
    lateral_jerk: float
    longitudinal: float
    longitudinal_jerk: float


@cython.cclass
class NavigationTarget:
    """The gamma-agent of one vehicle: a point S that moves to the vehicle's slot.

    Attributes:
        x: position along the road, m.
        y: position to the left, m.
        v_x: velocity along the road, m/s.
        v_y: velocity to the left, m/s.
        a_x: acceleration along the road, m/s^2.
        a_y: acceleration to the left, m/s^2.
        changing: whether it has begun to change to the platoon's lane; before, it stays at its place across the road.
        changing_s: time since then, s.

    Args:
        limits: of the motion.
        step_s: T, s.
        lead_s: time by which the lateral acceleration is ahead of the motion, because a vehicle's course follows its
            yaw with such a lag, s.
    """

    def __init__(self, limits: MotionLimits, step_s: float, lead_s: float = 0.0) -> None:
        self.limits = limits
        self._lead_s = lead_s
        self._longitudinal = limits.longitudinal
        self._speed_rate = min(SPEED_RATE, PER_BUILD_UP * limits.longitudinal_jerk / limits.longitudinal)
        self._closing_rate = CLOSING_RATE * self._speed_rate / SPEED_RATE
        self._ramp = Ramp(limits.longitudinal_jerk, step_s)
        self._step_s = step_s
        self._change = LaneChange(0.0, 0.0, 0.0, 0.0, 1.0)
        self.start(0.0, 0.0, 0.0, 0.0, 0.0)

    def start(self, x: float, y: float, v_x: float, v_y: float, a_x: float) -> None:
        """Start anew in its own lane from a point (m, m), its velocity (m/s, m/s) and acceleration a_x (m/s^2)."""
        self.x, self.y = x, y
        self.v_x, self.v_y = v_x, v_y
        self.a_x, self.a_y = a_x, 0.0
        self._ramp.reset(a_x)
        self.changing = False
        self.changing_s = 0.0

    def change_to(self, y: float) -> None:
        """Begin the lane change to a place across the road (m)."""
        self._change = lane_change(self.y, self.v_y, self.a_y, y, self.limits.lateral, self.limits.lateral_jerk)
        self.changing = True
        self.changing_s = 0.0

    @cython.ccall
    def wanted(self, error: cython.double, speed: cython.double) -> cython.double:
        """Return the acceleration (m/s^2) that leads to the slot.

        The speed wanted falls with the square root of a large error, so that it can be braked with a constant share of
        the acceleration, and in proportion to a small one.

        Args:
            error: position of the slot minus the own, m.
            speed: own velocity minus that of the slot, m/s.
        """
        share: cython.double = BRAKING_SHARE * self._longitudinal
        least: cython.double = share / self._closing_rate
        root: cython.double = sqrt(least * least + 2.0 * share * abs(error))
        curve: cython.double = copysign(root - least, error)
        a: cython.double = -share / root * speed + self._speed_rate * (curve - speed)
        return min(max(a, -self._longitudinal), self._longitudinal)

    @cython.ccall
    def advance(
        self, slot_x: cython.double, slot_speed: cython.double, least: cython.double, most: cython.double
    ) -> cython.void:
        """Move one step towards a slot.

        Args:
            slot_x: its position, m.
            slot_speed: its velocity, m/s.
            least: least acceleration that lets those behind brake comfortably, m/s^2.
            most: largest acceleration that keeps clear of those ahead, m/s^2; braking harder than the limit is
                immediate.
        """
        step_s: cython.double = self._step_s
        self.x += step_s * (self.v_x + 0.5 * step_s * self.a_x)
        self.v_x += step_s * self.a_x
        if most < -self._longitudinal:
            self._ramp.put(most)
        else:
            self._ramp.towards(min(max(self.wanted(slot_x - self.x, self.v_x - slot_speed), least), most))
        self.a_x = self._ramp.value
        self._across()

    @cython.ccall
    def fall_back(self, x: cython.double, v_x: cython.double, a_x: cython.double) -> cython.void:
        """Move one step across the road only; along it, be at the vehicle: point (m), velocity (m/s), acceleration."""
        self.x, self.v_x, self.a_x = x, v_x, a_x
        self._ramp.put(a_x)
        self._across()

    @cython.cfunc
    def _across(self) -> cython.void:
        step_s: cython.double = self._step_s
        if self.changing:
            self.changing_s += step_s
            self.y, self.v_y, self.a_y = self._change.at(self.changing_s)
            left_s: cython.double = max(self._change.duration_s - self.changing_s, 0.0)
            share: cython.double = min(1.0, self.changing_s / LEAD_BUILD_UP_S, left_s / LEAD_BUILD_UP_S)
            _, _, self.a_y = self._change.at(self.changing_s + share * self._lead_s)
        else:
            self.y += step_s * self.v_y
            self.v_y -= step_s * SPEED_RATE * self.v_y

    @cython.ccall
    def ahead(
        self, time_s: cython.double
    ) -> tuple[cython.double, cython.double, cython.double, cython.double, cython.double, cython.double]:
        """Return x, y (m), v_x, v_y (m/s), a_x, a_y (m/s^2) `time_s` from now, with a constant a_x."""
        y: cython.double = self.y
        v_y: cython.double = self.v_y
        a_y: cython.double = self.a_y
        if self.changing:
            y, v_y, a_y = self._change.at(self.changing_s + time_s)
        return (
            self.x + time_s * (self.v_x + 0.5 * time_s * self.a_x),
            y,
            self.v_x + time_s * self.a_x,
            v_y,
            self.a_x,
            a_y,
        )
