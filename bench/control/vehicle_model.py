# cython: boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""The control model: three states, linear tyres, and uncertain cornering stiffness.

Equations (16)-(20) and (24)-(26) of Zhuang, Xu, Yin (2020), corrected: the rear lateral force is
`C_r (l_r gamma - v_y) / v_x` (the paper's sign makes the car unstable), and the uncertainty enters only
through the lateral force of each axle, once with `lambda_f` and once with `lambda_r`.

State `xi = [v_x, v_y, gamma]` (m/s, m/s, rad/s) and input `U = [delta, F_x1, F_x2, F_x3, F_x4]` (rad, N), in
ISO 8855 vehicle axes, wheels in the paper's order: 1 front left, 2 rear left, 3 rear right, 4 front right.
"""

from typing import NamedTuple

import cython
import numpy as np
from numpy.typing import NDArray

from platoon_fmu.parameters import VehicleParameters

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

STATES = 3
INPUTS = 5

NUMBERS = ("M", "I_z", "l_f", "l_r", "l_t", "Cf2", "Cr2", "C_a", "variation", "T")
"""Order of the vehicle parameters in the vector for the functions below: Cf2 and Cr2 are for both tyres of an axle,
T is the sampling time."""


class LinearModel(NamedTuple):
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
        return LinearModel(self.A, _product(self.B, allocation), self.H, self.N1, _product(self.N2, allocation))


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
        out = np.empty(STATES)
        derivative(out, self.numbers, xi, U)
        return out

    def step(self, xi: Vector, U: Vector) -> Vector:
        """The state (3,) one step later by Euler's method, as (19)-(20) are discretised."""
        out = np.empty(STATES)
        step(out, self.numbers, xi, U)
        return out

    def linearise(self, xi: Vector, U: Vector) -> LinearModel:
        """A, B of (20) and dA, dB of (25)-(26) at a state (3,) with v_x > 0 and an input (5,)."""
        square, wide = np.empty((3, STATES, STATES)), np.empty((2, STATES, INPUTS))
        A_H_N1: cython.double[:, :, ::1] = square
        B_N2: cython.double[:, :, ::1] = wide
        linearise(A_H_N1[0], B_N2[0], A_H_N1[1], A_H_N1[2], B_N2[1], self.numbers, xi, U)
        return LinearModel(square[0], wide[0], square[1], square[2], wide[1])

    def steady_lateral_velocity(self, v_x: float, gamma: float) -> float:
        """v_y (m/s) of steady cornering at v_x > 0 (m/s) and yaw rate gamma (rad/s), no drive force.

        From (16) with dv_y = dgamma = 0: the rear axle carries M l_f / L of the lateral acceleration.
        """
        return float(steady_lateral_velocity(self.numbers, v_x, gamma))


def _product(a: Matrix, b: Matrix) -> Matrix:
    out = np.empty((a.shape[0], b.shape[1]))
    multiply(out, a, b)
    return out


@cython.ccall
@cython.nogil
@cython.exceptval(check=False)
def steady_lateral_velocity(numbers: cython.double[::1], v_x: cython.double, gamma: cython.double) -> cython.double:
    """Return `VehicleModel.steady_lateral_velocity`; `numbers` are the model's."""
    M: cython.double = numbers[0]
    l_f: cython.double = numbers[2]
    l_r: cython.double = numbers[3]
    return gamma * (l_r - M * l_f * (v_x * v_x) / ((l_f + l_r) * numbers[6]))


@cython.ccall
@cython.nogil
@cython.exceptval(check=False)
def multiply(out: cython.double[:, ::1], a: cython.double[:, ::1], b: cython.double[:, ::1]) -> cython.void:
    """Set `out = a b`, for a and b of any size."""
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    k: cython.Py_ssize_t
    for i in range(a.shape[0]):
        for j in range(b.shape[1]):
            out[i, j] = 0.0
            for k in range(b.shape[0]):
                out[i, j] += a[i, k] * b[k, j]


@cython.ccall
@cython.nogil
@cython.exceptval(check=False)
def derivative(
    out: cython.double[::1], numbers: cython.double[::1], xi: cython.double[::1], U: cython.double[::1]
) -> cython.void:
    """Set `out` to `VehicleModel.derivative`; `numbers` are the model's."""
    M: cython.double = numbers[0]
    I_z: cython.double = numbers[1]
    l_f: cython.double = numbers[2]
    l_r: cython.double = numbers[3]
    l_t: cython.double = numbers[4]
    C_a: cython.double = numbers[7]
    v_x: cython.double = xi[0]
    v_y: cython.double = xi[1]
    gamma: cython.double = xi[2]
    delta: cython.double = U[0]
    F_yf: cython.double = numbers[5] * (delta - (v_y + l_f * gamma) / v_x)
    F_yr: cython.double = numbers[6] * (l_r * gamma - v_y) / v_x
    F_X: cython.double = U[1] + U[2] + U[3] + U[4] - F_yf * delta
    F_Y: cython.double = (U[1] + U[4]) * delta + F_yf + F_yr
    M_z: cython.double = 0.5 * l_t * (U[4] - U[1] + U[3] - U[2]) + l_f * ((U[1] + U[4]) * delta + F_yf) - l_r * F_yr
    out[0] = v_y * gamma + (F_X - C_a * v_x * v_x) / M
    out[1] = -v_x * gamma + F_Y / M
    out[2] = M_z / I_z


@cython.ccall
@cython.nogil
@cython.exceptval(check=False)
def step(
    out: cython.double[::1], numbers: cython.double[::1], xi: cython.double[::1], U: cython.double[::1]
) -> cython.void:
    """Set `out` to `VehicleModel.step`; `numbers` are the model's."""
    i: cython.Py_ssize_t
    derivative(out, numbers, xi, U)
    for i in range(3):
        out[i] = xi[i] + numbers[9] * out[i]


@cython.ccall
@cython.nogil
@cython.exceptval(check=False)
def linearise(
    A: cython.double[:, ::1],
    B: cython.double[:, ::1],
    H: cython.double[:, ::1],
    N1: cython.double[:, ::1],
    N2: cython.double[:, ::1],
    numbers: cython.double[::1],
    xi: cython.double[::1],
    U: cython.double[::1],
) -> cython.void:
    """Set A, B, H, N1, N2 to those of `VehicleModel.linearise`; `numbers` are the model's."""
    M: cython.double = numbers[0]
    I_z: cython.double = numbers[1]
    l_f: cython.double = numbers[2]
    l_r: cython.double = numbers[3]
    C_a: cython.double = numbers[7]
    variation: cython.double = numbers[8]
    T: cython.double = numbers[9]
    v: cython.double = xi[0]
    v_y: cython.double = xi[1]
    gamma: cython.double = xi[2]
    delta: cython.double = U[0]
    q: cython.double = v_y + l_f * gamma
    s: cython.double = l_r * gamma - v_y
    F_yf: cython.double = numbers[5] * (delta - q / v)
    front: cython.double = numbers[5] / v
    rear: cython.double = numbers[6] / v
    m: cython.double = T / M
    z: cython.double = T / I_z
    half: cython.double = 0.5 * numbers[4]
    F_front: cython.double = U[1] + U[4]
    i: cython.Py_ssize_t
    j: cython.Py_ssize_t
    k: cython.Py_ssize_t

    # Effect of each axle's lateral force on the state (columns of H), and of state and steering on that force.
    H[0, 0], H[0, 1], H[0, 2] = -m * delta, -m * F_yf, 0.0
    H[1, 0], H[1, 1], H[1, 2] = m, 0.0, m
    H[2, 0], H[2, 1], H[2, 2] = z * l_f, 0.0, -z * l_r
    N1[0, 0], N1[0, 1], N1[0, 2] = front * q / v, -front, -front * l_f
    N1[1, 0], N1[1, 1], N1[1, 2] = 0.0, 0.0, 0.0
    N1[2, 0], N1[2, 1], N1[2, 2] = -rear * s / v, -rear, rear * l_r
    for i in range(3):
        for j in range(5):
            N2[i, j] = 0.0
    N2[0, 0], N2[1, 0] = numbers[5], 1.0

    # The rest of the model, and those forces at the nominal stiffness.
    A[0, 0], A[0, 1], A[0, 2] = 1.0 - 2.0 * m * C_a * v, T * gamma, T * v_y
    A[1, 0], A[1, 1], A[1, 2] = -T * gamma, 1.0, -T * v
    A[2, 0], A[2, 1], A[2, 2] = 0.0, 0.0, 1.0
    B[0, 0], B[0, 1], B[0, 2], B[0, 3], B[0, 4] = 0.0, m, m, m, m
    B[1, 0], B[1, 1], B[1, 2], B[1, 3], B[1, 4] = m * F_front, m * delta, 0.0, 0.0, m * delta
    B[2, 0], B[2, 1], B[2, 2] = z * l_f * F_front, z * (l_f * delta - half), -z * half
    B[2, 3], B[2, 4] = z * half, z * (half + l_f * delta)
    for i in range(3):
        for k in range(3):
            B[i, 0] += H[i, k] * N2[k, 0]
            for j in range(3):
                A[i, j] += H[i, k] * N1[k, j]

    for i in range(3):
        N2[i, 0] *= variation
        for j in range(3):
            N1[i, j] *= variation
