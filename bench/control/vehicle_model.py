"""The control model: three states, linear tyres, and what cornering stiffness does to it.

Equations (16)-(20) and (24)-(26) of Zhuang, Xu, Yin (2020), corrected: the rear lateral force is
`C_r (l_r gamma - v_y) / v_x` (the paper's sign makes the car unstable), and the uncertainty enters through
the lateral force of each axle alone, once with `lambda_f` and once with `lambda_r`.

State `xi = [v_x, v_y, gamma]` (m/s, m/s, rad/s) and input `U = [delta, F_x1, F_x2, F_x3, F_x4]` (rad, N), in
ISO 8855 vehicle axes, wheels in the paper's order: 1 front left, 2 rear left, 3 rear right, 4 front right.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from platoon_fmu.parameters import VehicleParameters

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

STATES = 3
INPUTS = 5


@dataclass(frozen=True)
class LinearModel:
    """One step of (25): `xi+ = (A + dA) xi + (B + dB) U`, in deviations from the reference.

    Attributes:
        A: (3, 3), nominal.
        B: (3, 5), nominal; columns per rad and per N.
        dA_f: (3, 3), change of A for `lambda_f = 1`.
        dB_f: (3, 5), change of B for `lambda_f = 1`.
        dA_r: (3, 3), change of A for `lambda_r = 1` (the rear axle is not steered: B does not change).
    """

    A: Matrix
    B: Matrix
    dA_f: Matrix
    dB_f: Matrix
    dA_r: Matrix

    def at(self, lambda_f: float, lambda_r: float) -> tuple[Matrix, Matrix]:
        """A (3, 3) and B (3, 5) of a car whose axles are `1 + 0.4 lambda` times as stiff, `lambda` in [-1, 1]."""
        return self.A + lambda_f * self.dA_f + lambda_r * self.dA_r, self.B + lambda_f * self.dB_f


class VehicleModel:
    """The paper's vehicle as the controllers know it: nominal parameters, no load transfer, no slip.

    Args:
        vehicle: the nominal parameters (Table 1).
        step_s: sampling time T of the discrete model, s.
    """

    def __init__(self, vehicle: VehicleParameters, step_s: float) -> None:
        self.vehicle = vehicle
        self.step_s = step_s
        self._Cf2 = 2.0 * vehicle.C_f
        self._Cr2 = 2.0 * vehicle.C_r
        self._C_a = vehicle.C_a

    def derivative(self, xi: Vector, U: Vector) -> Vector:
        """Time derivative of the state, (16)-(18) with the rear tyre's sign corrected.

        Args:
            xi: (3,) state with v_x > 0.
            U: (5,) input.

        Returns:
            (3,) [m/s^2, m/s^2, rad/s^2], without rolling resistance.
        """
        p = self.vehicle
        v_x, v_y, gamma = xi.tolist()
        delta, F_x1, F_x2, F_x3, F_x4 = U.tolist()
        F_yf = self._Cf2 * (delta - (v_y + p.l_f * gamma) / v_x)
        F_yr = self._Cr2 * (p.l_r * gamma - v_y) / v_x
        F_X = F_x1 + F_x2 + F_x3 + F_x4 - F_yf * delta
        F_Y = (F_x1 + F_x4) * delta + F_yf + F_yr
        M_z = 0.5 * p.l_t * (F_x4 - F_x1 + F_x3 - F_x2) + p.l_f * ((F_x1 + F_x4) * delta + F_yf) - p.l_r * F_yr
        return np.array(
            [
                v_y * gamma + (F_X - self._C_a * v_x * v_x) / p.M,
                -v_x * gamma + F_Y / p.M,
                M_z / p.I_z,
            ]
        )

    def step(self, xi: Vector, U: Vector) -> Vector:
        """The state (3,) one step later by Euler's method, as (19)-(20) are discretised."""
        return xi + self.step_s * self.derivative(xi, U)

    def linearise(self, xi: Vector, U: Vector) -> LinearModel:
        """A, B of (20) and dA, dB of (25)-(26) at a state (3,) with v_x > 0 and an input (5,)."""
        p, T = self.vehicle, self.step_s
        v, v_y, gamma = xi.tolist()
        delta, F_x1, _, _, F_x4 = U.tolist()
        M, I_z, l_f, l_r, l_t = p.M, p.I_z, p.l_f, p.l_r, p.l_t
        q = v_y + l_f * gamma
        s = l_r * gamma - v_y
        F_yf = self._Cf2 * (delta - q / v)

        # How each axle's lateral force moves the state, and how the state and the steering move that force.
        front = np.array([-delta / M, 1.0 / M, l_f / I_z])
        rear = np.array([0.0, 1.0 / M, -l_r / I_z])
        front_of_state = self._Cf2 * np.array([q / v**2, -1.0 / v, -l_f / v])
        rear_of_state = self._Cr2 * np.array([-s / v**2, -1.0 / v, l_r / v])
        steering_drag = np.array([-F_yf / M, 0.0, 0.0])

        A_front = T * np.outer(front, front_of_state)
        A_rear = T * np.outer(rear, rear_of_state)
        b_front = T * (front * self._Cf2 + steering_drag)

        A = np.array(
            [
                [-2.0 * self._C_a * v / M, gamma, v_y],
                [-gamma, 0.0, -v],
                [0.0, 0.0, 0.0],
            ]
        )
        A = np.eye(STATES) + T * A + A_front + A_rear

        half = 0.5 * l_t
        B = np.empty((STATES, INPUTS))
        F_front = F_x1 + F_x4
        B[:, 0] = b_front + T * np.array([0.0, F_front / M, l_f * F_front / I_z])
        B[0, 1:] = T / M
        B[1, 1:] = T * np.array([delta / M, 0.0, 0.0, delta / M])
        B[2, 1:] = T / I_z * np.array([l_f * delta - half, -half, half, half + l_f * delta])

        spread = p.cornering_variation
        dB_f = np.zeros((STATES, INPUTS))
        dB_f[:, 0] = spread * b_front
        return LinearModel(A, B, spread * A_front, dB_f, spread * A_rear)

    def steady_lateral_velocity(self, v_x: float, gamma: float) -> float:
        """v_y (m/s) of steady cornering at v_x > 0 (m/s) and yaw rate gamma (rad/s), no drive force.

        From (16) with dv_y = dgamma = 0: the rear axle carries M l_f / L of the lateral acceleration.
        """
        p = self.vehicle
        return gamma * (p.l_r - p.M * p.l_f * v_x**2 / ((p.l_f + p.l_r) * self._Cr2))
