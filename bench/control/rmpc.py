"""The robust model predictive controller: one semidefinite program a step, (50)-(62), and its certificate.

`chi+ = (A + dA) chi + (B + dB) theta`, `theta = K chi`: minimise tau, the worst cost `sum chi'Q chi + theta'R theta`
over all cornering stiffnesses. With P = tau W^-1 and Y = K P:

    [[X, Y'R, PQ], [*, tau R, 0], [*, *, tau Q]] >= 0,   [[P - X, (A_i P + B_i Y)'], [*, P]] >= 0 at every vertex i,
    [[1, e_j'Y/u_j], [*, P]] >= 0,   [[1, chi'], [*, P]] >= 0.

This is (51)-(54) with G = P, which loses nothing, the arrow (63) split into one small block for the cost and one
for the decrease, and the vertices of (lambda_f, lambda_r) in place of N_1, N_2, H and epsilon: never more
conservative than the printed form, and it covers lambda_f != lambda_r.

The solver is not believed: `certified_cost` checks the result itself before it is used.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.control.semidefinite import Entry, SemidefiniteProgram, SolverStatus

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]

N = 3
_SMALLEST = 0.01
"""Deviations below this (scaled units) are treated as this large."""
_LARGEST_ROOM = 10.0
"""Input room is cut to this many times the deviation (scaled units): more is hardly used and costs accuracy."""
_COST_UNIT = 300.0
"""The program counts tau in this unit, a usual cost of a deviation of one: so tau is near one as well."""
_LARGEST_COST_RATIO = 1.5
_SMALLEST_AXIS = 1e-9
_TRIANGLE = [(i, j) for j in range(N) for i in range(j + 1)]


@dataclass(frozen=True)
class Gain:
    """A state feedback with the ellipsoid that proves it.

    Attributes:
        K: (m, 3) gain of `theta = K chi`, in physical units.
        P: (3, 3) ellipsoid `chi' P^-1 chi <= 1`, in scaled units.
        tau: bound of the worst cost from chi, scaled units.
        status: how the solver ended, or CHECK_FAILED where the certificate refused its answer.
        iterations: of the solver.
    """

    K: Matrix
    P: Matrix
    tau: float
    status: SolverStatus
    iterations: int

    @property
    def usable(self) -> bool:
        """The certificate holds."""
        return self.status is SolverStatus.SOLVED


class RobustController:
    """Solves the semidefinite program of one step and certifies its answer.

    Args:
        state_scale: (3,) unit of each state in the program (m/s, m/s, rad/s).
        input_scale: (m,) unit of each input in the program.
        input_weight: R = input_weight I in scaled units, against Q = I.
        vertices: number of vertices of the uncertainty.
        tolerance: of the solver; what it leaves over is caught by the certificate.
        max_iterations: of the solver.
    """

    def __init__(
        self,
        state_scale: Vector,
        input_scale: Vector,
        input_weight: float,
        vertices: int,
        tolerance: float,
        max_iterations: int,
    ) -> None:
        self._state_scale = state_scale
        self._input_scale = input_scale
        self._rho = input_weight
        self._vertices = vertices
        m = input_scale.size
        self._program = _program(m, vertices, input_weight, tolerance, max_iterations)
        decrease = [(c, N + r, _P(k, c)) for r in range(N) for c in range(N) for k in range(N)]
        decrease += [(c, N + r, _Y(k, c)) for r in range(N) for c in range(N) for k in range(m)]
        self._decrease = [self._program.coefficient_positions(1 + i, decrease) for i in range(vertices)]
        self._bounds = [
            self._program.coefficient_positions(1 + vertices + j, [(0, 1 + c, _Y(j, c)) for c in range(N)])
            for j in range(m)
        ]
        self._start = self._program.constant_positions(1 + vertices + m, [(0, 1), (0, 2), (0, 3)])

    def solve(self, models: Sequence[tuple[Matrix, Matrix]], chi: Vector, u_max: Vector) -> Gain:
        """The gain of this step.

        Args:
            models: A (3, 3) and B (3, m) at each vertex, physical units.
            chi: (3,) deviation from the target.
            u_max: (m,) room of each input about its target, positive.
        """
        x, u = self._state_scale, self._input_scale
        m = u.size
        scaled = [(A / x[:, None] * x, B / x[:, None] * u) for A, B in models]
        # The program is homogeneous: in units of the deviation itself all its numbers are near one. A deviation too
        # small to matter is treated as a larger one in its direction, which a proof for the larger one covers.
        z = chi / x
        size = float(np.linalg.norm(z))
        z = z / size if size > 0.0 else np.eye(N)[0]
        size = max(size, _SMALLEST)
        room = np.minimum(u_max / u / size, _LARGEST_ROOM)
        for (A, B), (positions, scale) in zip(scaled, self._decrease, strict=True):
            numbers = np.concatenate([np.repeat(A, N, axis=0).ravel(), np.repeat(B, N, axis=0).ravel()])
            self._program.set_coefficients(positions, scale * numbers)
        for (positions, scale), bound in zip(self._bounds, room, strict=True):
            self._program.set_coefficients(positions, scale / bound)
        self._program.set_constants(self._start[0], self._start[1] * z)

        solution = self._program.solve()
        v = solution.x
        P = np.array([[v[_P(i, j)] for j in range(N)] for i in range(N)])
        Y = v[6 : 6 + 3 * m].reshape(m, N)
        tau = float(v[-1]) * _COST_UNIT
        status = solution.status
        K = np.zeros((m, N))
        proven = None
        if status in (SolverStatus.SOLVED, SolverStatus.ALMOST_SOLVED):
            if np.isfinite(v).all() and np.linalg.det(P) > 0.0:
                K = np.linalg.solve(P, Y.T).T
                proven = certified_cost(K, P, self._rho, scaled, z, room)
            # The proof asks for a cost close to the solver's: far from it, the solve itself went wrong.
            if proven is not None and proven <= _LARGEST_COST_RATIO * tau:
                status, tau = SolverStatus.SOLVED, proven
            else:
                status = SolverStatus.CHECK_FAILED
        return Gain(K * u[:, None] / x, P * size**2, tau * size**2, status, solution.iterations)


def certified_cost(
    K: Matrix, P: Matrix, rho: float, models: Sequence[tuple[Matrix, Matrix]], z: Vector, room: Vector
) -> float | None:
    """The worst cost from z that (K, P) proves, whoever found them, or None where they prove nothing.

    Proven is (68) at every vertex, hence between them: the cost-to-go `W = tau P^-1` falls at least by the stage
    cost at each step. So the ellipsoid through z is never left, and no state of it asks for more than the room of
    any input (to 0.1 %, which the caller's clipping then takes off).

    Args:
        K: (m, 3) gain.
        P: (3, 3) ellipsoid.
        rho: input weight, R = rho I, Q = I.
        models: A (3, 3), B (3, m) at each vertex.
        z: (3,) deviation.
        room: (m,) input room.
    """
    values, axes = np.linalg.eigh(P)
    if not (np.isfinite(K).all() and values[0] > _SMALLEST_AXIS):
        return None
    # In the coordinates in which the ellipsoid is the unit ball, every condition is about a norm.
    root = axes * np.sqrt(values)
    inverse = (axes / np.sqrt(values)).T
    gain = K @ root
    radius = float(np.linalg.norm(inverse @ z))
    if (radius * np.linalg.norm(gain, axis=1) > 1.001 * room).any():
        return None
    stage = root.T @ root + rho * gain.T @ gain
    cost = 0.0
    for A, B in models:
        step = inverse @ (A @ root + B @ gain)
        shrink = np.eye(N) - step.T @ step
        if np.linalg.eigvalsh(shrink)[0] <= 0.0:
            return None
        # The smallest tau with shrink >= stage / tau.
        factor = np.linalg.inv(np.linalg.cholesky(shrink))
        cost = max(cost, float(np.linalg.eigvalsh(factor @ stage @ factor.T)[-1]))
    return cost * radius**2


def _P(i: int, j: int) -> int:
    i, j = min(i, j), max(i, j)
    return j * (j + 1) // 2 + i


def _Y(row: int, column: int) -> int:
    return 6 + N * row + column


def _program(m: int, vertices: int, rho: float, tolerance: float, max_iterations: int) -> SemidefiniteProgram:
    """The program's structure; what changes from step to step is 0 here."""
    first_X = 6 + N * m
    tau = first_X + 6
    shrink = 1.0 / np.sqrt(_COST_UNIT)
    P_block = [Entry(1 + i, 1 + j, [_P(i, j)], [1.0]) for i, j in _TRIANGLE]

    cost_block = [Entry(i, j, [first_X + _P(i, j)], [1.0]) for i, j in _TRIANGLE]
    for row in range(m):
        cost_block += [Entry(column, N + row, [_Y(row, column)], [rho * shrink]) for column in range(N)]
        cost_block.append(Entry(N + row, N + row, [tau], [rho]))
    for row in range(N):
        cost_block += [Entry(column, N + m + row, [_P(column, row)], [shrink]) for column in range(N)]
        cost_block.append(Entry(N + m + row, N + m + row, [tau], [1.0]))

    decrease = [Entry(i, j, [_P(i, j), first_X + _P(i, j)], [1.0, -1.0]) for i, j in _TRIANGLE]
    decrease += [Entry(N + i, N + j, [_P(i, j)], [1.0]) for i, j in _TRIANGLE]
    for row in range(N):
        for column in range(N):
            variables = [_P(k, column) for k in range(N)] + [_Y(k, column) for k in range(m)]
            decrease.append(Entry(column, N + row, variables, [0.0] * (N + m)))

    blocks = [(2 * N + m, cost_block)] + [(2 * N, decrease)] * vertices
    for row in range(m):
        bound = [Entry(0, 0, constant=1.0)]
        bound += [Entry(0, 1 + column, [_Y(row, column)], [1.0]) for column in range(N)]
        blocks.append((1 + N, bound + P_block))
    start = [Entry(0, 0, constant=1.0)] + [Entry(0, 1 + column) for column in range(N)]
    blocks.append((1 + N, start + P_block))

    cost = np.zeros(tau + 1)
    cost[tau] = 1.0
    return SemidefiniteProgram(cost, blocks, tolerance=tolerance, max_iterations=max_iterations)
