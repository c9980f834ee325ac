"""Whether the own vehicle follows its reference: the planner's check of tracker, actuators, tyres and road."""

from bench.bus.states import ActuatorState, Cause, CommandState
from bench.bus.topic import Signals

YAW_RATE_RADPS = 0.15
"""Error (rad/s) of a vehicle that does not follow: a healthy one stays within 0.04 on any allowed tyres."""

SPEED_MPS = 0.8
"""The same for the speed (m/s): a healthy vehicle stays within 0.1."""

PERSISTENT_CYCLES = 5
"""Number of consecutive cycles with such an error: shorter ones occur in normal tracking."""

RECOVERY_CYCLES = 200
"""Number of consecutive cycles in which the vehicle must follow before it is trusted again."""

HELD_CYCLES = 3
"""Number of consecutive cycles without commands after which the tracker is lost."""


_STATES = {float(state): state for state in ActuatorState}
"""By their values in a frame."""


class Following:
    """Monitors the actuators' status and compares the motion with the reference.

    Attributes:
        cause: NONE, TRACKER_LOST or VEHICLE_FAULT.
    """

    def __init__(self) -> None:
        """Start without a reference."""
        self.cause = Cause.NONE
        self._asked: tuple[float, float] | None = None
        self._off = 0
        self._good = RECOVERY_CYCLES
        self._waiting = 0
        self._tracker_lost = False

    def update(self, status: Signals | None, v_x: float, yaw_rate: float) -> None:
        """Process one cycle's actuator status and own motion."""
        if status is not None:
            self._look(status)
        self._compare(v_x, yaw_rate)
        if self._tracker_lost:
            self.cause = Cause.TRACKER_LOST
        else:
            self.cause = Cause.VEHICLE_FAULT if self._faulty else Cause.NONE

    def ask(self, v_x: float, yaw_rate: float) -> None:
        """Store the reference of the next cycle (m/s, rad/s)."""
        self._asked = (v_x, yaw_rate)

    @property
    def _faulty(self) -> bool:
        return self._good < RECOVERY_CYCLES

    def _look(self, status: Signals) -> None:
        state = _STATES[status["ActuatorState"]]
        self._waiting = self._waiting + 1 if state is ActuatorState.INIT else 0
        held = state is ActuatorState.HOLD and status["HeldCycles"] >= HELD_CYCLES
        silent = state is ActuatorState.SAFE or held or self._waiting > HELD_CYCLES
        # If the vehicle does not follow, the planner sends no reference, which is why its tracker is in SAFE.
        gave_up = status["CommandState"] == CommandState.SAFE and not self._faulty
        self._tracker_lost = silent or gave_up

    def _compare(self, v_x: float, yaw_rate: float) -> None:
        if self._asked is None or self._tracker_lost:
            self._off = 0
            return
        off = abs(v_x - self._asked[0]) > SPEED_MPS or abs(yaw_rate - self._asked[1]) > YAW_RATE_RADPS
        self._off = self._off + 1 if off else 0
        self._good = 0 if self._off >= PERSISTENT_CYCLES else self._good + (not off)
