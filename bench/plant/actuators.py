"""A vehicle's actuators: what they apply of what is commanded, and what they do when no command comes."""

from collections.abc import Mapping
from dataclasses import dataclass

from bench.bus.states import ActuatorState, CommandState
from bench.bus.topic import Signals

STEERING = "SteeringCommand"
TORQUES_FRONT = "TorqueCommandFront"
TORQUES_REAR = "TorqueCommandRear"
COMMANDS = (STEERING, TORQUES_FRONT, TORQUES_REAR)


@dataclass(frozen=True, slots=True)
class Applied:
    """What acts on the vehicle: road-wheel angle in rad, wheel torques in N m (front left, rear left, ...)."""

    steering_angle: float = 0.0
    torque_fl: float = 0.0
    torque_rl: float = 0.0
    torque_rr: float = 0.0
    torque_fr: float = 0.0


class Actuators:
    """Applies whole sets of commands: steering and torques of one cycle belong together.

    Without a whole set they hold what they have; after `hold_cycles` cycles of that they go to their safe state, wheels
    straight and no torque, until commands come again.

    Attributes:
        state: what they are doing.
        applied: what acts on the vehicle.
        held_cycles: cycles in a row without a whole set of commands.
    """

    def __init__(self, hold_cycles: int = 50) -> None:
        """Begin with nothing applied. 50 cycles (0.5 s) is our assumption for how long old commands may act."""
        self._hold_cycles = hold_cycles
        self.state = ActuatorState.INIT
        self.applied = Applied()
        self.held_cycles = 0

    def take(self, commands: Mapping[str, Signals | None]) -> None:
        """Take one cycle's command messages by name; None for one that did not come or came damaged."""
        steering, front, rear = (commands[name] for name in COMMANDS)
        if steering is None or front is None or rear is None or steering["CommandState"] == CommandState.NONE:
            self._hold()
            return
        self.held_cycles = 0
        self.state = ActuatorState.ACTIVE
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
            self.applied = Applied()
