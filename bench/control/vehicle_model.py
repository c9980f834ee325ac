"""The control model: three states, linear tyres, and uncertain cornering stiffness.

Equations (16)-(20) and (24)-(26) of Zhuang, Xu, Yin (2020), corrected: the rear lateral force is
`C_r (l_r gamma - v_y) / v_x` (the paper's sign makes the car unstable), and the uncertainty enters only
through the lateral force of each axle, once with `lambda_f` and once with `lambda_r`.

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

NUMBERS = ("M", "I_z", "l_f", "l_r", "l_t", "Cf2", "Cr2", "C_a", "variation", "T")
"""Order of the vehicle parameters in the vector for the functions below: Cf2 and Cr2 are for both tyres of an axle,
T is the sampling time. A vector, because passing a named tuple takes several times as long."""

_T = NUMBERS.index("T")


@dataclass(frozen=True)
class LinearModel:
    """One step of (25) in deviations: `xi+ = (A + H Lambda N1) xi + (B + H Lambda N2) U`.

    `Lambda = diag(lambda_f, lambda_f, lambda_r)` with each lambda in [-1, 1]. The first column of H is the effect of
    the front axle's lateral force, the second of its drag when steered, the third of the rear axle's lateral force.
    The paper's H, N1 and N2 (26) lack the factor 2T and have spurious entries.

    Attributes:
        A: (3, 3), nominal.
        B: (3, m), nominal; columns per rad and per N for m = 5.
        H: (3, 3), effect of the uncertain forces on the state.
        N1: (3, 3), gain from the state to the uncertain forces.
        N2: (3, m), gain from the input to the uncertain forces.
    """

    A: Matrix
    B: Matrix
    H: Matrix
    N1: Matrix
    N2: Matrix

    def at(self, lambda_f: float, lambda_r: float) -> tuple[Matrix, Matrix]:
        """Return A (3, 3) and B (3, m) of a car with axle stiffness scaled by `1 + 0.4 lambda`, `lambda` in [-1, 1]."""
        spread = self.H * np.array([lambda_f, lambda_f, lambda_r])
        return self.A + spread @ self.N1, self.B + spread @ self.N2

    def with_inputs(self, allocation: Matrix) -> "LinearModel":
        """Return the same model with input u, where `U = allocation @ u`, allocation (5, m)."""
        return LinearModel(self.A, self.B @ allocation, self.H, self.N1, self.N2 @ allocation)


class VehicleModel:
    """The paper's vehicle as the controllers model it: nominal parameters, no load transfer, no slip.

    Args:
        vehicle: the nominal parameters (Table 1).
        step_s: sampling time T of the discrete model, s.

    Attributes:
        numbers: (10,) vehicle parameters for `derivative`, `step` and `linearise`, see `NUMBERS`.
    """

    def __init__(self, vehicle: VehicleParameters, step_s: float) -> None:
        self.vehicle = vehicle
        self.step_s = step_s
        p = vehicle
        self.numbers = np.array(
            [p.M, p.I_z, p.l_f, p.l_r, p.l_t, 2.0 * p.C_f, 2.0 * p.C_r, p.C_a, p.cornering_variation, step_s]
        )

    def derivative(self, xi: Vector, U: Vector) -> Vector:
        """Time derivative of the state, (16)-(18) with the rear tyre's sign corrected.

        Args:
            xi: (3,) state with v_x > 0.
            U: (5,) input.

        Returns:
            (3,) [m/s^2, m/s^2, rad/s^2], without rolling resistance.
        """
        return derivative(self.numbers, xi, U)

    def step(self, xi: Vector, U: Vector) -> Vector:
        """The state (3,) one step later by Euler's method, as (19)-(20) are discretised."""
        return step(self.numbers, xi, U)

    def linearise(self, xi: Vector, U: Vector) -> LinearModel:
        """A, B of (20) and dA, dB of (25)-(26) at a state (3,) with v_x > 0 and an input (5,)."""
        return LinearModel(*linearise(self.numbers, xi, U))

    def steady_lateral_velocity(self, v_x: float, gamma: float) -> float:
        """v_y (m/s) of steady cornering at v_x > 0 (m/s) and yaw rate gamma (rad/s), no drive force.

        From (16) with dv_y = dgamma = 0: the rear axle carries M l_f / L of the lateral acceleration.
        """
        p = self.vehicle
        return gamma * (p.l_r - p.M * p.l_f * v_x**2 / ((p.l_f + p.l_r) * 2.0 * p.C_r))


def derivative(numbers: Vector, xi: Vector, U: Vector) -> Vector:
    """See `VehicleModel.derivative`; `numbers` are the model's."""
    M, I_z, l_f, l_r, l_t, Cf2, Cr2, C_a, _, _ = numbers
    v_x, v_y, gamma = xi
    delta, F_x1, F_x2, F_x3, F_x4 = U
    F_yf = Cf2 * (delta - (v_y + l_f * gamma) / v_x)
    F_yr = Cr2 * (l_r * gamma - v_y) / v_x
    F_X = F_x1 + F_x2 + F_x3 + F_x4 - F_yf * delta
    F_Y = (F_x1 + F_x4) * delta + F_yf + F_yr
    M_z = 0.5 * l_t * (F_x4 - F_x1 + F_x3 - F_x2) + l_f * ((F_x1 + F_x4) * delta + F_yf) - l_r * F_yr
    return np.array([v_y * gamma + (F_X - C_a * v_x * v_x) / M, -v_x * gamma + F_Y / M, M_z / I_z])


def step(numbers: Vector, xi: Vector, U: Vector) -> Vector:
    """See `VehicleModel.step`; `numbers` are the model's."""
    moved: Vector = xi + numbers[_T] * derivative(numbers, xi, U)
    return moved


def linearise(numbers: Vector, xi: Vector, U: Vector) -> tuple[Matrix, Matrix, Matrix, Matrix, Matrix]:
    """A, B, H, N1, N2 of `VehicleModel.linearise`; `numbers` are the model's."""
    M, I_z, l_f, l_r, l_t, Cf2, Cr2, C_a, variation, T = numbers
    v, v_y, gamma = xi
    delta, F_x1, _, _, F_x4 = U
    q = v_y + l_f * gamma
    s = l_r * gamma - v_y
    F_yf = Cf2 * (delta - q / v)

    # Effect of each axle's lateral force on the state (columns of H), and of state and steering on that force.
    H = np.array([[-T * delta / M, -T * F_yf / M, 0.0], [T / M, 0.0, T / M], [T * l_f / I_z, 0.0, -T * l_r / I_z]])
    front, rear = Cf2 / v, Cr2 / v
    of_state = np.array([[front * q / v, -front, -front * l_f], [0.0, 0.0, 0.0], [-rear * s / v, -rear, rear * l_r]])
    of_steering = np.array([Cf2, 1.0, 0.0])

    rest = np.array([[1.0 - 2.0 * T * C_a * v / M, T * gamma, T * v_y], [-T * gamma, 1.0, -T * v], [0.0, 0.0, 1.0]])
    F_front = F_x1 + F_x4
    m, i, half = T / M, T / I_z, 0.5 * l_t
    B = np.array(
        [
            [0.0, m, m, m, m],
            [m * F_front, m * delta, 0.0, 0.0, m * delta],
            [i * l_f * F_front, i * (l_f * delta - half), -i * half, i * half, i * (half + l_f * delta)],
        ]
    )
    B[:, 0] += H @ of_steering
    N2 = np.zeros((STATES, INPUTS))
    N2[:, 0] = variation * of_steering
    return rest + H @ of_state, B, H, variation * of_state, N2
