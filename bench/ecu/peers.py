"""What a vehicle knows about the others: their extrapolated motion, and whether they can be trusted."""

import math
from collections.abc import Mapping
from typing import NamedTuple

import cython

from bench.bus.quantities import broadcast
from bench.bus.reception import Health
from bench.bus.states import Cause, EcuState, Manoeuvre
from bench.bus.topic import Signals, Topic
from bench.control.planner import Motion
from bench.cycle import CYCLE_S
from bench.ecu.limits import limits_of

if cython.compiled:
    from cython.cimports.bench.ecu.limits import possible
else:
    from bench.ecu.limits import possible

RECOVERY_CYCLES = 20
"""Number of consecutive cycles with plausible broadcasts before a vehicle is trusted again."""

POSITION_M = 0.15
"""Distance (m) between reported and dead-reckoned position that exceeds rounding."""

COURSE_RAD = 0.05
"""The same for its course (rad) against its integrated yaw rate; larger than the build-up of side-slip."""

COASTING_MPS2 = 0.3
"""Assumed deceleration of a vehicle that is not heard: drag and rolling resistance."""

_PULL = 0.05
"""As in `bench.ecu.plausibility`."""

_STATES = {float(state): state for state in EcuState}
_CAUSES = {float(cause): cause for cause in Cause}
_MANOEUVRES = {float(manoeuvre): manoeuvre for manoeuvre in Manoeuvre}
"""By their values in a frame: an enumeration's own search takes longer than all else of a report."""


class Report(NamedTuple):
    """Content of a vehicle's `V2VStatus`.

    Attributes:
        state: worst state of its ECUs.
        cause: why it is not in RUN.
        slot: its slot from 1; 0 without a slot.
        leader_x: position of the foremost slot (m), extrapolated by the receiver with the platoon's speed.
        manoeuvre: its current manoeuvre.
    """

    state: EcuState
    cause: Cause
    slot: int
    leader_x: float
    manoeuvre: Manoeuvre


class PeerWatch:
    """One other vehicle.

    Attributes:
        motion: its current motion; None before the first broadcast. Without broadcasts it is extrapolated at constant
            velocity, and as slowing down once the vehicle is lost.
        braking: the deceleration (m/s^2) that is assumed then: coasting, unless set.
        crawl: the speed (m/s) to which it slows down.
        heard: whether its broadcast of the last cycle was received.
        cause: why it is not trusted: NONE, PEER_MISSING, PEER_LOST, PEER_IMPLAUSIBLE or PEER_UNSAFE.
        report: its last report; None before the first.
    """

    def __init__(self, number: int) -> None:
        """Watch vehicle `number`."""
        self.topics = broadcast(number)
        self.motion: Motion | None = None
        self.heard = False
        self.cause = Cause.NONE
        self.report: Report | None = None
        self.braking = COASTING_MPS2
        self.crawl = 0.0
        self._position_limits = limits_of("v2v.dbc", self.topics.position.message)
        self._motion_limits = limits_of("v2v.dbc", self.topics.motion.message)
        self._reckoned: tuple[float, float, float] | None = None
        self._agreed = RECOVERY_CYCLES
        self._lost = False

    def update(self, inputs: Mapping[Topic, Signals | None], health: Health, cycles: int = 1) -> None:
        """Process one cycle's broadcast, which was sent in the cycle before.

        Args:
            inputs: of the cycle; None for missing ones.
            health: their reception.
            cycles: since the last call; more than one if this ECU missed some.
        """
        if cycles != 1:
            self._reckoned = None
            if self.motion is not None:
                self.motion = self.motion.later((cycles - 1) * CYCLE_S)
        topics = self.topics
        position, motion = inputs[topics.position], inputs[topics.motion]
        self._listen(inputs[topics.status])
        lost = health.of(topics.position).lost or health.of(topics.motion).lost
        self.heard = position is not None and motion is not None
        plausible = True
        if position is not None and motion is not None:
            told = Motion(position["X"], position["Y"], motion["Speed"], motion["Course"], motion["YawRate"])
            plausible = self._is_plausible(told, position, motion)
            if plausible or self.motion is None:
                self.motion = told.later(CYCLE_S)
            else:
                self.motion = self._slowing(self.motion)
        elif self.motion is not None:
            self.motion = self._slowing(self.motion) if lost else self.motion.later(CYCLE_S)
            self._reckoned = None
        self._judge(plausible, lost)

    def assume(self, start: Motion, since_s: float) -> None:
        """Assume that a vehicle not heard yet has coasted for `since_s` seconds from its start position."""
        if self.motion is None:
            way = since_s * (start.speed - 0.5 * COASTING_MPS2 * since_s)
            x, y = start.X + way * math.cos(start.course), start.Y + way * math.sin(start.course)
            self.motion = Motion(x, y, max(start.speed - COASTING_MPS2 * since_s, 0.0), start.course, 0.0)

    def _listen(self, status: Signals | None) -> None:
        if status is not None:
            self.report = Report(
                _STATES[status["State"]],
                _CAUSES[status["Cause"]],
                int(status["Slot"]),
                status["LeaderX"],
                _MANOEUVRES[status["Manoeuvre"]],
            )

    def _judge(self, plausible: bool, lost: bool) -> None:
        if lost or not plausible:
            self._agreed = 0
            self._lost = lost
        elif self.heard:
            self._agreed += 1
        report = self.report
        if self._agreed < RECOVERY_CYCLES:
            self.cause = Cause.PEER_LOST if self._lost else Cause.PEER_IMPLAUSIBLE
        elif report is not None and (
            report.state is EcuState.SAFE or report.manoeuvre in (Manoeuvre.SLOW_DOWN, Manoeuvre.FALL_BACK)
        ):
            self.cause = Cause.PEER_UNSAFE
        else:
            self.cause = Cause.NONE if self.heard else Cause.PEER_MISSING

    def _is_plausible(self, told: Motion, position: Signals, motion: Signals) -> bool:
        in_range = possible(self._position_limits, position, ("X", "Y")) and possible(
            self._motion_limits, motion, ("YawRate",)
        )
        speed = self._motion_limits["Speed"]
        if not in_range or not speed.high > told.speed >= speed.low:
            self._reckoned = None
            return False
        if self._reckoned is None:
            self._reckoned = (told.X, told.Y, told.course)
            return True
        x, y, course = self._reckoned
        x += CYCLE_S * told.speed * math.cos(told.course)
        y += CYCLE_S * told.speed * math.sin(told.course)
        course += CYCLE_S * told.yaw_rate
        off_x, off_y = told.X - x, told.Y - y
        turned = math.remainder(told.course - course, 2.0 * math.pi)
        self._reckoned = (x + _PULL * off_x, y + _PULL * off_y, course + _PULL * turned)
        return math.hypot(off_x, off_y) <= POSITION_M and abs(turned) <= COURSE_RAD

    def _slowing(self, motion: Motion) -> Motion:
        later = motion.later(CYCLE_S)
        speed = max(motion.speed - self.braking * CYCLE_S, min(motion.speed, self.crawl))
        return Motion(later.X, later.Y, speed, motion.course, 0.0)
