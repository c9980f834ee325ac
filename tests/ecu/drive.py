"""Sensor frames of a vehicle that drives, made from its motion: what an ECU takes in, and what faults do to it."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

from platoon_fmu.parameters import VehicleParameters

T = 0.01
VEHICLE = VehicleParameters()

Frames = dict[str, dict[str, float] | None]


@dataclass
class Drive:
    """A vehicle on its way: speed, yaw rate and lateral velocity are functions of time, the rest follows from them."""

    v_x: Callable[[float], float] = lambda _: 20.0
    yaw_rate: Callable[[float], float] = lambda t: 0.2 * math.sin(2.0 * t)
    x: float = 0.0
    y: float = 3.5
    yaw: float = 0.0
    cycle: int = 0
    steering: float = 0.0
    actuator_state: int = 1
    held: int = 0
    command_state: int = 1
    a_x: float = 0.0
    history: list[Frames] = field(default_factory=list)

    def v_y(self, t: float) -> float:
        v, gamma = self.v_x(t), self.yaw_rate(t)
        return gamma * (VEHICLE.l_r - VEHICLE.M * VEHICLE.l_f * v**2 / (2 * VEHICLE.L * VEHICLE.C_r))

    def frames(self) -> Frames:
        """This cycle's sensor frames, quantised as the DBC has it; then the vehicle drives on."""
        t = self.cycle * T
        v, gamma, v_y = self.v_x(t), self.yaw_rate(t), self.v_y(t)
        turn = 0.5 * VEHICLE.l_t * gamma
        left, right = (v - turn) / VEHICLE.R_w, (v + turn) / VEHICLE.R_w
        frames: Frames = {
            "VehiclePosition": {"X": _near(self.x, 4e-4), "Y": _near(self.y, 4e-4)},
            "VehicleAttitude": {"Yaw": _near(self.yaw, 2e-6), "Roll": 0.0},
            "VehicleMotion": {
                "VelocityX": _near(v, 5e-4),
                "VelocityY": _near(v_y, 5e-4),
                "YawRate": _near(gamma, 1.25e-5),
            },
            "VehicleAcceleration": {"AccelerationX": self.a_x, "AccelerationY": v * gamma},
            "WheelSpeedsFront": {"WheelSpeedFL": left, "WheelSpeedFR": right},
            "WheelSpeedsRear": {"WheelSpeedRL": left, "WheelSpeedRR": right},
            "ActuatorStatus": {
                "SteeringAngle": self.steering,
                "ActuatorState": self.actuator_state,
                "HeldCycles": self.held,
                "CommandState": self.command_state,
            },
        }
        for _ in range(10):
            middle = self.yaw + 0.05 * T * gamma
            self.x += 0.1 * T * (v * math.cos(middle) - v_y * math.sin(middle))
            self.y += 0.1 * T * (v * math.sin(middle) + v_y * math.cos(middle))
            t += 0.1 * T
            v, gamma, v_y = self.v_x(t), self.yaw_rate(t), self.v_y(t)
            self.yaw += 0.1 * T * self.yaw_rate(t - 0.05 * T)
        self.cycle += 1
        return frames


def _near(value: float, step: float) -> float:
    return round(value / step) * step
