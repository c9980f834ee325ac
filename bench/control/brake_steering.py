"""Lane keeping by wheel torques alone, for a vehicle whose steering does not respond."""

import numpy as np
from numpy.typing import NDArray

from platoon_fmu.parameters import VehicleParameters
from platoon_fmu.wheels import WHEELS

YAW_GAIN = 6.0
"""Yaw acceleration per yaw-rate error (1/s)."""

YAW_INTEGRAL = 12.0
"""The same for its integral (1/s^2), which compensates the moment of the stuck wheels."""

SPEED_GAIN = 2.0
"""Acceleration per speed error (1/s)."""


class BrakeSteering:
    """Wheel forces for a speed and a yaw rate, with the yaw moment from the difference between left and right.

    It does not use the steering angle, so it also works if only the reported angle is wrong.

    Args:
        vehicle: nominal parameters.
        force_max: largest force of one wheel, N.
        step_s: cycle time T, s.
    """

    def __init__(self, vehicle: VehicleParameters, force_max: float, step_s: float) -> None:
        self._vehicle = vehicle
        self._force_max = force_max
        self._step_s = step_s
        self._integral = 0.0

    def reset(self) -> None:
        """Reset the integral."""
        self._integral = 0.0

    def forces(self, v_x: float, yaw_rate: float, v_ref: float, yaw_rate_ref: float) -> NDArray[np.float64]:
        """Return (4,) longitudinal forces F_x1 to F_x4 (N) of the wheels.

        Args:
            v_x: m/s.
            yaw_rate: rad/s.
            v_ref: desired speed in the next cycle, m/s.
            yaw_rate_ref: desired yaw rate in the next cycle, rad/s.
        """
        half = 0.5 * self._force_max
        each = 0.25 * self._vehicle.M * SPEED_GAIN * (v_ref - v_x)
        each = min(max(each, -half), half)
        room = self._force_max - abs(each)
        error = yaw_rate_ref - yaw_rate
        integral = self._integral + YAW_INTEGRAL * self._step_s * error
        moment = self._vehicle.I_z * (YAW_GAIN * error + integral)
        # Two wheels per side, each half a track width from the centre line.
        difference = moment / (2.0 * self._vehicle.l_t)
        if abs(difference) <= room:
            self._integral = integral
        difference = min(max(difference, -room), room)
        return np.array([each - wheel.side * difference for wheel in WHEELS])
