"""Where a step of the tracker may find itself, and what a gain then costs."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench.control.allocation import allocate
from bench.control.programs import programs
from bench.control.rmpc import Gain, RobustController
from bench.control.robust_program import RobustProgram
from bench.control.vehicle_model import LinearModel, VehicleModel
from platoon_fmu.parameters import VehicleParameters

T = 0.01
MODEL = VehicleModel(VehicleParameters(), T)
ALLOCATION = allocate(VehicleParameters(), 0.5, 3000.0, 0.25)
STATE = np.array([1.0, 5.0, 0.2])
INPUT = np.array([0.1, 2000.0, 1000.0])
EQUAL = [(1.0, 1.0), (-1.0, -1.0)]
"""The paper's lambda_f = lambda_r."""
INDEPENDENT = [*EQUAL, (1.0, -1.0), (-1.0, 1.0)]
POINTS = range(12)

Models = Sequence[tuple[np.ndarray, np.ndarray]]


def controller(
    independent: bool = True, weight: float = 1.0, tolerance: float = 1e-6, iterations: int = 40
) -> RobustController:
    tried = programs(3, weight, independent=independent, tolerance=tolerance, max_iterations=iterations)
    return RobustController(STATE, INPUT, weight, tried, independent=independent)


def semidefinite_controller(tolerance: float = 1e-6, iterations: int = 40) -> RobustController:
    """With the semidefinite program alone."""
    program = RobustProgram(3, 1.0, independent=True, bounded=True, tolerance=tolerance, max_iterations=iterations)
    return RobustController(STATE, INPUT, 1.0, [program], independent=True)


@dataclass(frozen=True)
class OperatingPoint:
    """Where a step of the tracker may find itself."""

    linear: LinearModel
    chi: np.ndarray
    room: np.ndarray

    def vertex(self, lambda_f: float, lambda_r: float) -> tuple[np.ndarray, np.ndarray]:
        return self.linear.at(lambda_f, lambda_r)

    def models(self, corners: Sequence[tuple[float, float]]) -> Models:
        return [self.vertex(*corner) for corner in corners]

    def scaled(self, corners: Sequence[tuple[float, float]]) -> Models:
        return [scaled(A, B) for A, B in self.models(corners)]

    def scaled_linear(self) -> LinearModel:
        """The model in the units of the programme."""
        model = self.linear
        A, B = scaled(model.A, model.B)
        return LinearModel(A, B, model.H / STATE[:, None], model.N1 * STATE, model.N2 * INPUT)


def scaled(A: np.ndarray, B: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A model in the units of the programme."""
    return A / STATE[:, None] * STATE, B / STATE[:, None] * INPUT


def operating_point(seed: int) -> OperatingPoint:
    random = np.random.default_rng(seed)
    v = random.uniform(8, 40)
    gamma = random.uniform(-0.6, 0.6) * 0.85 * 7.84 / v
    xi = np.array([v, MODEL.steady_lateral_velocity(v, gamma), gamma])
    U = ALLOCATION.matrix @ (random.uniform(-0.1, 0.1, 3) * ALLOCATION.limit)
    direction = random.normal(size=3)
    chi = random.uniform(0.05, 1.0) * direction / np.linalg.norm(direction) * STATE
    room = random.uniform(0.3, 1.0, 3) * ALLOCATION.limit
    return OperatingPoint(MODEL.linearise(xi, U).with_inputs(ALLOCATION.matrix), chi, room)


def accumulate(point: OperatingPoint, gain: Gain, lambdas: np.ndarray) -> tuple[float, np.ndarray]:
    """Cost (scaled units, R = I) and largest inputs along a sequence of stiffnesses."""
    chi = point.chi
    cost, largest = 0.0, np.zeros(3)
    for lambda_f, lambda_r in lambdas:
        A, B = point.vertex(lambda_f, lambda_r)
        u = gain.K @ chi
        cost += float(((chi / STATE) ** 2).sum() + ((u / INPUT) ** 2).sum())
        largest = np.maximum(largest, np.abs(u))
        chi = A @ chi + B @ u
    return cost, largest
