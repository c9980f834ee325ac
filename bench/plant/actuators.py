"""A vehicle's actuators: how they apply commands, and what they do without commands."""

from collections.abc import Mapping
from typing import NamedTuple

from bench.bus.codec import DBC_DIR, Codec
from bench.bus.quantities import COMMANDS, STEERING, TORQUES_FRONT, TORQUES_REAR
from bench.bus.states import ActuatorState, CommandState
from bench.bus.topic import Signals
from bench.cycle import CYCLE_S

CENTRING_RADPS = 0.2
"""Rate at which the steering returns to straight in the safe state, slow enough not to upset a vehicle."""


class Applied(NamedTuple):
    """What acts on the vehicle: road-wheel angle in rad, wheel torques in N m."""

    steering_angle: float = 0.0
    torque_fl: float = 0.0
    torque_rl: float = 0.0
    torque_rr: float = 0.0
    torque_fr: float = 0.0


class Actuators:
    """Applies complete sets of commands: the steering and torques of one cycle.

    Without a complete set they hold their values; after `hold_cycles` such cycles they go to their safe state until
    commands arrive again: zero torque at once, and the wheels return to straight at `CENTRING_RADPS`. The vehicle
    coasts.

    Attributes:
        state: their current mode.
        applied: what acts on the vehicle.
        held_cycles: consecutive cycles without a complete set of commands.
        command_state: of the applied commands; NONE if there are none or they are held.
    """

    def __init__(self, hold_cycles: int | None = None) -> None:
        """Start with nothing applied; the default of `hold_cycles` is the DBC's shortest timeout of a command."""
        if hold_cycles is None:
            codec = Codec(DBC_DIR / "vehicle.dbc")
            hold_cycles = min(codec.timeout_cycles(name) for name in COMMANDS)
        self._hold_cycles = hold_cycles
        self.state = ActuatorState.INIT
        self.applied = Applied()
        self.held_cycles = 0
        self.command_state = CommandState.NONE

    def take(self, commands: Mapping[str, Signals | None]) -> None:
        """Take one cycle's command messages by name; None for one that is missing or damaged."""
        steering, front, rear = commands[STEERING], commands[TORQUES_FRONT], commands[TORQUES_REAR]
        if steering is None or front is None or rear is None or steering["CommandState"] == CommandState.NONE:
            self.command_state = CommandState.NONE
            self._hold()
            return
        self.held_cycles = 0
        self.state = ActuatorState.ACTIVE
        self.command_state = CommandState(int(steering["CommandState"]))
        self.applied = Applied(
            steering["SteeringAngle"], front["TorqueFL"], rear["TorqueRL"], rear["TorqueRR"], front["TorqueFR"]
        )

    def _hold(self) -> None:
        if self.state is ActuatorState.INIT:
            return
        self.held_cycles += 1
        self.state = ActuatorState.HOLD
        if self.held_cycles > self._hold_cycles:
            self.state = ActuatorState.SAFE
            step = CENTRING_RADPS * CYCLE_S
            angle = self.applied.steering_angle
            self.applied = Applied(steering_angle=angle - min(max(angle, -step), step))
