"""The quantities exchanged by plant and controllers, in SI units and ISO 8855 axes, with their signal names.

The messages are those of `dbc/vehicle.dbc` and `dbc/v2v.dbc`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from bench.bus.reception import Health, ReceptionState
from bench.bus.states import CommandState, ReferenceState
from bench.bus.topic import Signals, Topic
from bench.names import V2V
from platoon_fmu.wheels import FL, FR, RL, RR, WHEEL_NAMES

POSITION, ATTITUDE, MOTION, REFERENCE = "VehiclePosition", "VehicleAttitude", "VehicleMotion", "Reference"
ACCELERATION = "VehicleAcceleration"
WHEELS_FRONT, WHEELS_REAR, ACTUATORS = "WheelSpeedsFront", "WheelSpeedsRear", "ActuatorStatus"
STEERING, TORQUES_FRONT, TORQUES_REAR = "SteeringCommand", "TorqueCommandFront", "TorqueCommandRear"
COMMANDS = (STEERING, TORQUES_FRONT, TORQUES_REAR)

RECEPTIONS = {
    POSITION: "PositionReception",
    ATTITUDE: "AttitudeReception",
    MOTION: "MotionReception",
    WHEELS_FRONT: "WheelsFrontReception",
    WHEELS_REAR: "WheelsRearReception",
    ACTUATORS: "ActuatorReception",
    REFERENCE: "ReferenceReception",
}
"""The signals of an ECU's bus health with the reception state of its inputs."""

_STATES = tuple(map(float, sorted(ReceptionState)))
"""The reception states as a signal's values."""

COMMAND_RECEPTIONS = {
    STEERING: "SteeringReception",
    TORQUES_FRONT: "TorqueFrontReception",
    TORQUES_REAR: "TorqueRearReception",
}
"""The signals of the plant's bus health with the reception state of commands."""

SENSORS = (POSITION, ATTITUDE, MOTION, WHEELS_FRONT, WHEELS_REAR)
"""The messages with the vehicle's own motion."""


class Broadcast(NamedTuple):
    """The topics that a vehicle broadcasts to the others."""

    position: Topic
    motion: Topic
    status: Topic


@cache
def broadcast(vehicle: int) -> Broadcast:
    """The broadcast of vehicle number `vehicle`."""
    return Broadcast(*(Topic(V2V, f"V2V{kind}_{vehicle}") for kind in ("Position", "Motion", "Status")))


def bus_health(health: Health) -> dict[str, float]:
    """Return the signals of an ECU's bus health message for its own reception."""
    signals: dict[str, float] = {"FramesLost": health.frames_lost, "E2EErrors": health.e2e_errors}
    for topic, reception in health.inputs.items():
        signal = RECEPTIONS.get(topic.message)
        if signal is not None:
            signals[signal] = _STATES[reception.state]
    return signals


@dataclass(frozen=True, slots=True)
class Motion:
    """A vehicle's motion, in its own axes (x forward, y to the left).

    Attributes:
        v_x: longitudinal velocity of the centre of mass (m/s).
        v_y: lateral velocity (m/s).
        yaw_rate: positive to the left (rad/s).
    """

    v_x: float
    v_y: float
    yaw_rate: float

    @classmethod
    def read(cls, motion: Signals) -> Self:
        """Read a `VehicleMotion`."""
        return cls(motion["VelocityX"], motion["VelocityY"], motion["YawRate"])


@dataclass(frozen=True, slots=True)
class Pose:
    """A vehicle's pose, in the road frame (X along the road, Y to the left).

    Attributes:
        x: position of the centre of mass along the road (m).
        y: across it (m).
        yaw: heading, 0 along the road, positive to the left (rad).
    """

    x: float
    y: float
    yaw: float

    @classmethod
    def read(cls, position: Signals, attitude: Signals) -> Self:
        """Read a `VehiclePosition` and a `VehicleAttitude`."""
        return cls(position["X"], position["Y"], attitude["Yaw"])


@dataclass(frozen=True, slots=True)
class Peer:
    """Position and motion of another vehicle in the cycle before, from its broadcast.

    Attributes:
        x: position of the centre of mass along the road (m).
        y: across it (m).
        speed: of the centre of mass (m/s).
        course: direction of the velocity, 0 along the road, positive to the left (rad).
        yaw_rate: positive to the left (rad/s).
    """

    x: float
    y: float
    speed: float
    course: float
    yaw_rate: float

    @classmethod
    def read(cls, position: Signals, motion: Signals) -> Self:
        """Read a `V2VPosition_i` and a `V2VMotion_i`."""
        return cls(position["X"], position["Y"], motion["Speed"], motion["Course"], motion["YawRate"])

    def messages(self, vehicle: int) -> dict[str, Signals]:
        """Return the broadcast of vehicle number `vehicle`."""
        topics = broadcast(vehicle)
        return {
            topics.position.message: {"X": self.x, "Y": self.y},
            topics.motion.message: {"Speed": self.speed, "Course": self.course, "YawRate": self.yaw_rate},
        }


@dataclass(frozen=True, slots=True)
class Reference:
    """A planner's reference to the tracker for the next cycle.

    Attributes:
        v_x: longitudinal velocity (m/s).
        yaw_rate: positive to the left (rad/s).
    """

    v_x: float
    yaw_rate: float = 0.0

    @classmethod
    def read(cls, reference: Signals) -> Self:
        """Read a `Reference`."""
        return cls(reference["VelocityX"], reference["YawRate"])

    def messages(self, state: ReferenceState) -> dict[str, Signals]:
        """Return the message, with reference state `state`."""
        return {REFERENCE: {"VelocityX": self.v_x, "YawRate": self.yaw_rate, "ReferenceState": state}}


@dataclass(frozen=True, slots=True)
class Command:
    """A tracker's command to the actuators for this cycle.

    Attributes:
        steering_angle: of the front wheels, positive to the left (rad).
        torque_fl: on the front left wheel, positive drives forward (N m).
        torque_fr: on the front right wheel (N m).
        torque_rl: on the rear left wheel (N m).
        torque_rr: on the rear right wheel (N m).
    """

    steering_angle: float = 0.0
    torque_fl: float = 0.0
    torque_fr: float = 0.0
    torque_rl: float = 0.0
    torque_rr: float = 0.0

    @classmethod
    def evenly(cls, wheel_torque: float, steering_angle: float = 0.0) -> Self:
        """Return a command with the same torque (N m) on every wheel."""
        return cls.of_wheels(steering_angle, (wheel_torque,) * len(WHEEL_NAMES))

    @classmethod
    def of_wheels(cls, steering_angle: float, torques: Sequence[float] | NDArray[np.float64]) -> Self:
        """Return a command with torques (4,) in N m, in the order of `platoon_fmu.wheels`."""
        each = [float(torque) for torque in torques]
        if len(each) != len(WHEEL_NAMES):
            raise ValueError(f"{len(each)} torques; allowed: {len(WHEEL_NAMES)}, one for each wheel")
        return cls(steering_angle, each[FL], each[FR], each[RL], each[RR])

    def messages(self, state: CommandState) -> Mapping[str, Signals]:
        """Return the three messages, with command state `state`."""
        return {
            STEERING: {"SteeringAngle": self.steering_angle, "CommandState": state},
            TORQUES_FRONT: {"TorqueFL": self.torque_fl, "TorqueFR": self.torque_fr},
            TORQUES_REAR: {"TorqueRL": self.torque_rl, "TorqueRR": self.torque_rr},
        }
