"""Control allocation: three virtual inputs (steering, total drive force, yaw moment) replace the five real ones.

The wheels share the total force evenly, and left and right wheels differ by the yaw moment, so that
`U = ALLOCATION @ u` turns `u = [delta, F, M]` (rad, N, N m) into the paper's `U = [delta, F_x1 .. F_x4]`. Every
equation of the paper holds for u with `B @ ALLOCATION` in place of B, and the semidefinite program is smaller.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from platoon_fmu.parameters import VehicleParameters
from platoon_fmu.wheels import FL, FR, RL, RR, WHEELS

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

VIRTUAL_INPUTS = 3


@dataclass(frozen=True)
class Allocation:
    """Maps virtual inputs to real ones and the real limits to virtual ones.

    Attributes:
        matrix: (5, 3), `U = matrix @ u`.
        limit: (3,) largest |u| of each virtual input for which any combination keeps every wheel within its
            force limit (rad, N, N m).
    """

    matrix: Matrix
    limit: Vector


def allocate(vehicle: VehicleParameters, steering_max: float, force_max: float, moment_share: float) -> Allocation:
    """Return the allocation for a vehicle.

    Args:
        vehicle: its track `l_t` is the lever of the yaw moment.
        steering_max: largest |delta|, rad.
        force_max: largest |F_xi| of one wheel, N.
        moment_share: fraction of `force_max`, in (0, 1), reserved for the yaw moment.
    """
    per_moment = 0.5 / vehicle.l_t
    matrix = np.array([[1.0, 0.0, 0.0], *([0.0, 0.25, -wheel.side * per_moment] for wheel in WHEELS)])
    limit = np.array([steering_max, 4.0 * force_max * (1.0 - moment_share), force_max * moment_share / per_moment])
    return Allocation(matrix, limit)


def virtual_input(vehicle: VehicleParameters, steering: float, forces: Vector) -> Vector:
    """Return the virtual input u (3,) equivalent to a steering angle (rad) and four wheel forces (4,) (N)."""
    left, right = forces[FL] + forces[RL], forces[RR] + forces[FR]
    return np.array([steering, left + right, 0.5 * vehicle.l_t * (right - left)])
