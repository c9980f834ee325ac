"""A vehicle's actuators: what they apply of what is commanded, and what they do when no command comes."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

from bench.bus.codec import DBC_DIR, Codec
from bench.bus.quantities import COMMANDS
from bench.bus.states import ActuatorState, CommandState
from bench.bus.topic import Signals
from bench.cycle import CYCLE_S

CENTRING_RADPS = 0.2
"""How fast the steering goes back to straight in the safe state: slow enough to upset no vehicle."""


@dataclass(frozen=True, slots=True)
class Applied:
    """What acts on the vehicle: road-wheel angle in rad, wheel torques in N m."""

    steering_angle: float = 0.0
    torque_fl: float = 0.0
    torque_rl: float = 0.0
    torque_rr: float = 0.0
    torque_fr: float = 0.0


class Actuators:
    """Applies whole sets of commands: steering and torques of one cycle belong together.

    Without a whole set they hold what they have; after `hold_cycles` cycles of that they go to their safe state, until
    commands come again: no torque at once, and the wheels back to straight at `CENTRING_RADPS`. The vehicle coasts.

    Attributes:
        state: what they are doing.
        applied: what acts on the vehicle.
        held_cycles: cycles in a row without a whole set of commands.
        command_state: of the commands that are applied; NONE while none are, or while they are held.
    """

    def __init__(self, hold_cycles: int | None = None) -> None:
        """Begin with nothing applied; hold for the shortest timeout that the DBC has for a command, if not told."""
        if hold_cycles is None:
            codec = Codec(DBC_DIR / "vehicle.dbc")
            hold_cycles = min(codec.timeout_cycles(name) for name in COMMANDS)
        self._hold_cycles = hold_cycles
        self.state = ActuatorState.INIT
        self.applied = Applied()
        self.held_cycles = 0
        self.command_state = CommandState.NONE

    def take(self, commands: Mapping[str, Signals | None]) -> None:
        """Take one cycle's command messages by name; None for one that did not come or came damaged."""
        steering, front, rear = (commands[name] for name in COMMANDS)
        if steering is None or front is None or rear is None or steering["CommandState"] == CommandState.NONE:
            self.command_state = CommandState.NONE
            self._hold()
            return
        self.held_cycles = 0
        self.state = ActuatorState.ACTIVE
        self.command_state = CommandState(int(steering["CommandState"]))
        self.applied = Applied(
            steering_angle=steering["SteeringAngle"],
            torque_fl=front["TorqueFL"],
            torque_rl=rear["TorqueRL"],
            torque_rr=rear["TorqueRR"],
            torque_fr=front["TorqueFR"],
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
            self.applied = replace(Applied(), steering_angle=angle - min(max(angle, -step), step))
