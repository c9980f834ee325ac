"""The robust model predictive controller: one semidefinite program a step, (50)-(62), and its certificate.

`chi+ = (A + H Lambda N1) chi + (B + H Lambda N2) theta`, `theta = K chi`: minimise tau, the worst cost
`sum chi'Q chi + theta'R theta` over all cornering stiffnesses. With P = tau W^-1 and Y = K P:

    [[X, Y'R, PQ], [*, tau R, 0], [*, *, tau Q]] >= 0,
    [[P - X, (A P + B Y)', (N1 P + N2 Y)'], [*, P - H E H', 0], [*, *, E]] >= 0,
    [[1, e_j'Y/u_j], [*, P]] >= 0,   [[1, chi'], [*, P]] >= 0.

This is (51)-(54) with three changes, none of which makes it more conservative: G = P, which loses nothing; the arrow
(63) split into a block for the cost and one for the decrease; and in place of epsilon a matrix E that commutes with
Lambda, which also covers lambda_f != lambda_r.

The solver is not believed: `certified_cost` checks the result itself, at every corner of the uncertainty, before it is
used, and the tau reported is the one it proves.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.control.semidefinite import Entry, SemidefiniteProgram, SolverStatus
from bench.control.vehicle_model import LinearModel

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
_DECREASE, _FIRST_BOUND = 1, 2
"""Blocks of the program: the cost is 0, then the decrease, the input bounds and the start."""
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
        independent: lambda_f and lambda_r vary on their own; else lambda_f = lambda_r as in the paper.
        tolerance: of the solver; what it leaves over is caught by the certificate.
        max_iterations: of the solver.
    """

    def __init__(
        self,
        state_scale: Vector,
        input_scale: Vector,
        input_weight: float,
        *,
        independent: bool,
        tolerance: float,
        max_iterations: int,
    ) -> None:
        self._state_scale = state_scale
        self._input_scale = input_scale
        self._rho = input_weight
        self._corners = [(1.0, 1.0), (-1.0, -1.0)]
        if independent:
            self._corners += [(1.0, -1.0), (-1.0, 1.0)]
        # E commutes with Lambda where it joins only what the same lambda scales.
        self._multiplier = [(i, j) for i, j in _TRIANGLE if not independent or (i == 2) == (j == 2)]
        m = input_scale.size
        self._program = program = _program(m, self._multiplier, input_weight, tolerance, max_iterations)
        self._of_step = program.coefficient_positions(_DECREASE, _step_entries(m, N))
        self._of_uncertainty = program.coefficient_positions(_DECREASE, _step_entries(m, 2 * N))
        multiplied = [(N + i, N + j, _E(m, k)) for i, j in _TRIANGLE for k in range(len(self._multiplier))]
        self._of_multiplier = program.coefficient_positions(_DECREASE, multiplied)
        self._of_bounds = [
            program.coefficient_positions(_FIRST_BOUND + j, [(0, 1 + c, _Y(j, c)) for c in range(N)]) for j in range(m)
        ]
        self._of_start = program.constant_positions(_FIRST_BOUND + m, [(0, 1), (0, 2), (0, 3)])

    def solve(self, model: LinearModel, chi: Vector, u_max: Vector) -> Gain:
        """The gain of this step.

        Args:
            model: of m inputs, physical units.
            chi: (3,) deviation from the target.
            u_max: (m,) room of each input about its target, positive.
        """
        x, u = self._state_scale, self._input_scale
        m = u.size
        scaled = LinearModel(
            model.A / x[:, None] * x, model.B / x[:, None] * u, model.H / x[:, None], model.N1 * x, model.N2 * u
        )
        # The program is homogeneous: in units of the deviation itself all its numbers are near one. A deviation too
        # small to matter is treated as a larger one in its direction, which a proof for the larger one covers.
        z = chi / x
        size = float(np.linalg.norm(z))
        z = z / size if size > 0.0 else np.eye(N)[0]
        size = max(size, _SMALLEST)
        room = np.minimum(u_max / u / size, _LARGEST_ROOM)
        self._set(scaled, z, room)

        solution = self._program.solve()
        v = solution.x
        P = np.array([[v[_P(i, j)] for j in range(N)] for i in range(N)])
        Y = v[6 : 6 + 3 * m].reshape(m, N)
        tau = float(v[_tau(m)]) * _COST_UNIT
        status = solution.status
        K = np.zeros((m, N))
        proven = None
        if status in (SolverStatus.SOLVED, SolverStatus.ALMOST_SOLVED):
            if np.isfinite(v).all() and np.linalg.det(P) > 0.0:
                K = np.linalg.solve(P, Y.T).T
                proven = certified_cost(K, P, self._rho, [scaled.at(*c) for c in self._corners], z, room)
            # The proof asks for a cost close to the solver's: far from it, the solve itself went wrong.
            if proven is not None and proven <= _LARGEST_COST_RATIO * tau:
                status, tau = SolverStatus.SOLVED, proven
            else:
                status = SolverStatus.CHECK_FAILED
        return Gain(K * u[:, None] / x, P * size**2, tau * size**2, status, solution.iterations)

    def _set(self, model: LinearModel, z: Vector, room: Vector) -> None:
        """Write this step's numbers, all in scaled units, into the program."""
        program = self._program
        # H and N share a factor at will; with columns and rows of one length E is near one.
        rows = np.linalg.norm(np.hstack([model.N1, model.N2]), axis=1)
        balance = np.sqrt(np.maximum(rows, 1e-12) / np.maximum(np.linalg.norm(model.H, axis=0), 1e-12))
        H = model.H * balance
        for (positions, scale), on_P, on_Y in (
            (self._of_step, model.A, model.B),
            (self._of_uncertainty, model.N1 / balance[:, None], model.N2 / balance[:, None]),
        ):
            numbers = np.concatenate([np.repeat(on_P, N, axis=0).ravel(), np.repeat(on_Y, N, axis=0).ravel()])
            program.set_coefficients(positions, scale * numbers)
        positions, scale = self._of_multiplier
        spread = [
            -H[i, k] * H[j, n] if k == n else -(H[i, k] * H[j, n] + H[i, n] * H[j, k])
            for i, j in _TRIANGLE
            for k, n in self._multiplier
        ]
        program.set_coefficients(positions, scale * np.array(spread))
        for (positions, scale), bound in zip(self._of_bounds, room, strict=True):
            program.set_coefficients(positions, scale / bound)
        program.set_constants(self._of_start[0], self._of_start[1] * z)


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
    A, B = np.stack([A for A, _ in models]), np.stack([B for _, B in models])
    step = inverse @ (A @ root + B @ gain)
    shrink = np.eye(N) - step.transpose(0, 2, 1) @ step
    if np.linalg.eigvalsh(shrink).min() <= 0.0:
        return None
    # The smallest tau with shrink >= stage / tau.
    factor = np.linalg.inv(np.linalg.cholesky(shrink))
    cost = float(np.linalg.eigvalsh(factor @ stage @ factor.transpose(0, 2, 1)).max())
    return cost * radius**2


def _P(i: int, j: int) -> int:
    i, j = min(i, j), max(i, j)
    return j * (j + 1) // 2 + i


def _Y(row: int, column: int) -> int:
    return 6 + N * row + column


def _X(m: int, i: int, j: int) -> int:
    return 6 + N * m + _P(i, j)


def _tau(m: int) -> int:
    return 12 + N * m


def _E(m: int, place: int) -> int:
    return _tau(m) + 1 + place


def _step_entries(m: int, below: int) -> list[tuple[int, int, int]]:
    """Entries of `(F P + G Y)'` with its columns from `below` on, F (3, 3) first and then G (3, m), row by row."""
    entries = [(c, below + r, _P(k, c)) for r in range(N) for c in range(N) for k in range(N)]
    entries += [(c, below + r, _Y(k, c)) for r in range(N) for c in range(N) for k in range(m)]
    return entries


def _program(
    m: int, multiplier: Sequence[tuple[int, int]], rho: float, tolerance: float, max_iterations: int
) -> SemidefiniteProgram:
    """The program's structure; what changes from step to step is 0 here."""
    tau = _tau(m)
    shrink = 1.0 / np.sqrt(_COST_UNIT)
    P_block = [Entry(1 + i, 1 + j, [_P(i, j)], [1.0]) for i, j in _TRIANGLE]

    cost_block = [Entry(i, j, [_X(m, i, j)], [1.0]) for i, j in _TRIANGLE]
    for row in range(m):
        cost_block += [Entry(column, N + row, [_Y(row, column)], [rho * shrink]) for column in range(N)]
        cost_block.append(Entry(N + row, N + row, [tau], [rho]))
    for row in range(N):
        cost_block += [Entry(column, N + m + row, [_P(column, row)], [shrink]) for column in range(N)]
        cost_block.append(Entry(N + m + row, N + m + row, [tau], [1.0]))

    multipliers = [_E(m, k) for k in range(len(multiplier))]
    decrease = [Entry(i, j, [_P(i, j), _X(m, i, j)], [1.0, -1.0]) for i, j in _TRIANGLE]
    decrease += [Entry(N + i, N + j, [_P(i, j), *multipliers], [1.0] + [0.0] * len(multipliers)) for i, j in _TRIANGLE]
    decrease += [Entry(2 * N + i, 2 * N + j, [e], [1.0]) for (i, j), e in zip(multiplier, multipliers, strict=True)]
    for below in (N, 2 * N):
        for row in range(N):
            for column in range(N):
                variables = [_P(k, column) for k in range(N)] + [_Y(k, column) for k in range(m)]
                decrease.append(Entry(column, below + row, variables, [0.0] * (N + m)))

    blocks = [(2 * N + m, cost_block), (3 * N, decrease)]
    for row in range(m):
        bound = [Entry(0, 0, constant=1.0)]
        bound += [Entry(0, 1 + column, [_Y(row, column)], [1.0]) for column in range(N)]
        blocks.append((1 + N, bound + P_block))
    start = [Entry(0, 0, constant=1.0)] + [Entry(0, 1 + column) for column in range(N)]
    blocks.append((1 + N, start + P_block))

    cost = np.zeros(_E(m, len(multiplier)))
    cost[tau] = 1.0
    return SemidefiniteProgram(cost, blocks, tolerance=tolerance, max_iterations=max_iterations)
