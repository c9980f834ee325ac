"""The semidefinite program of the robust MPC, (51)-(54): its inequalities, and the numbers of each step.

With P = tau W^-1, where W is the cost-to-go, and Y = K P, in scaled units with Q = I, R = rho I: minimise tau so that

    [[X1, rho Y'], [*, tau rho I]] >= 0,  [[X2, P], [*, tau I]] >= 0,          X1 + X2: the stage cost
    [[Z, (N1 P + N2 Y)'], [*, E]] >= 0,                                        Z: the uncertainty
    [[P - X1 - X2 - Z, (A P + B Y)'], [*, P - H E H']] >= 0,                   the decrease
    [[1, e_j'Y/u_j], [*, P]] >= 0 for each input j,  [[1, z'], [*, P]] >= 0.   the bounds and the start

This is (51)-(54) with three changes, none of which makes it more conservative: G = P, without loss; the arrow
(63) is split into one small block per arm; and a matrix E that commutes with Lambda replaces epsilon, which also covers
lambda_f != lambda_r.
"""

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from bench.control.outcome import GainSource
from bench.control.program import Answer
from bench.control.semidefinite import Entry, SemidefiniteProgram
from bench.control.vehicle_model import LinearModel

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Pair = tuple[int, int]

N = 3
_COST_UNIT = 300.0
"""Unit of tau in the program, a typical cost of a unit deviation, so that tau is near one as well."""
_UNCERTAINTY, _DECREASE, _START, _FIRST_BOUND = 2, 3, 4, 5
"""Indices of the blocks; blocks 0 and 1, of the stage cost, never change."""
_TRIANGLE = tuple((i, j) for j in range(N) for i in range(j + 1))


class RobustProgram:
    """The program: the structure is set up once; each solve writes its numbers into it.

    Args:
        m: number of inputs.
        input_weight: rho.
        independent: lambda_f and lambda_r vary independently; otherwise lambda_f = lambda_r as in the paper.
        bounded: whether the input bounds are included.
        tolerance: of the solver; the certificate covers its error.
        max_iterations: of the solver.
    """

    source = GainSource.SDP

    def __init__(
        self,
        m: int,
        input_weight: float,
        *,
        independent: bool,
        bounded: bool,
        tolerance: float,
        max_iterations: int,
    ) -> None:
        # E commutes with Lambda if it couples only components scaled by the same lambda.
        self._multiplier = [(i, j) for i, j in _TRIANGLE if not independent or (i == 2) == (j == 2)]
        v = self._variables = _Variables(m, self._multiplier)
        blocks = list(_blocks(v, input_weight, m if bounded else 0))
        cost = np.zeros(v.count)
        cost[v.tau] = 1.0
        self._program = program = SemidefiniteProgram(cost, blocks, tolerance=tolerance, max_iterations=max_iterations)
        step = [(row, N + column, variable) for row, column, variable in _transposed_step(v)]
        of_step = program.coefficient_positions(_DECREASE, step)
        of_uncertainty = program.coefficient_positions(_UNCERTAINTY, step)
        spread = [(N + i, N + j, v.E(*pair)) for i, j in _TRIANGLE for pair in self._multiplier]
        of_multiplier = program.coefficient_positions(_DECREASE, spread)
        # In the order of `_numbers`.
        positions, scales = zip(of_step, of_uncertainty, of_multiplier, strict=True)
        self._of_model = np.concatenate(positions), np.concatenate(scales)
        self._pairs = np.array(self._multiplier)
        self._of_P = np.array([[v.P(i, j) for j in range(N)] for i in range(N)])
        self._of_start = program.constant_positions(_START, [(0, 1), (0, 2), (0, 3)])
        self._of_bounds = [
            program.coefficient_positions(_FIRST_BOUND + j, [(0, 1 + c, v.Y(j, c)) for c in range(N)])
            for j in range(m if bounded else 0)
        ]

    def solve(self, model: LinearModel, z: Vector, room: Vector) -> Answer:
        """Solve for one step.

        Args:
            model: model with m inputs, in scaled units.
            z: (3,) deviation in scaled units, of length one.
            room: (m,) room u_j of each input in scaled units; ignored without bounds.
        """
        self._set(model, z, room)
        solution = self._program.solve()
        v, x = self._variables, solution.x
        tau = float(x[v.tau]) * _COST_UNIT
        return Answer(x[self._of_P], x[v.all_Y].reshape(-1, N), tau, solution.status, solution.iterations)

    def _set(self, model: LinearModel, z: Vector, room: Vector) -> None:
        program = self._program
        positions, scale = self._of_model
        numbers = _numbers(model.A, model.B, model.H, model.N1, model.N2, self._pairs)
        program.set_coefficients(positions, scale * numbers)
        program.set_constants(self._of_start[0], self._of_start[1] * z)
        for (positions, scale), bound in zip(self._of_bounds, room, strict=False):
            program.set_coefficients(positions, scale / bound)


def _numbers(A: Matrix, B: Matrix, H: Matrix, N1: Matrix, N2: Matrix, pairs: NDArray[np.intp]) -> Vector:
    """Return a model's coefficients: of the step, of the uncertainty, and of E in `-H E H'` for its `pairs`."""
    # H and N can be scaled against each other; with columns and rows of equal length, E is near one.
    row = np.sqrt((N1**2).sum(axis=1) + (N2**2).sum(axis=1))
    share = np.sqrt(np.maximum(row, 1e-12) / np.maximum(np.sqrt((H**2).sum(axis=0)), 1e-12))
    H = H * share
    parts = [np.repeat(matrix, N, axis=0).ravel() for matrix in (A, B, N1 / share[:, None], N2 / share[:, None])]
    mixed = (H[i, k] * H[j, n] + (H[i, n] * H[j, k] if k != n else 0.0) for i, j in _TRIANGLE for k, n in pairs)
    return np.concatenate([*parts, -np.fromiter(mixed, dtype=np.float64)])


class _Variables:
    """Indices into the program's vector of variables."""

    def __init__(self, m: int, multiplier: Sequence[Pair]) -> None:
        self.m = m
        self.multiplier = multiplier
        self.all_Y = slice(6, 6 + N * m)
        self._first_part = 6 + N * m
        self.tau = self._first_part + 3 * 6
        self._E = {pair: self.tau + 1 + place for place, pair in enumerate(multiplier)}
        self.count = self.tau + 1 + len(multiplier)

    def P(self, i: int, j: int) -> int:
        return _triangle(i, j)

    def Y(self, row: int, column: int) -> int:
        return 6 + N * row + column

    def part(self, number: int, i: int, j: int) -> int:
        """X1, X2, Z for number 0, 1, 2."""
        return self._first_part + 6 * number + _triangle(i, j)

    def E(self, i: int, j: int) -> int:
        return self._E[i, j]


def _triangle(i: int, j: int) -> int:
    i, j = min(i, j), max(i, j)
    return j * (j + 1) // 2 + i


def _transposed_step(v: _Variables) -> Iterator[tuple[int, int, int]]:
    """Yield row, column and variable of each coefficient of `(F P + G Y)'`: F (3, 3) row by row, then G (3, m)."""
    for row in range(N):
        for column in range(N):
            for k in range(N):
                yield column, row, v.P(k, column)
    for row in range(N):
        for column in range(N):
            for k in range(v.m):
                yield column, row, v.Y(k, column)


def _blocks(v: _Variables, rho: float, bounds: int) -> Iterator[tuple[int, list[Entry]]]:
    """Yield size and entries of each block in order; coefficients that change from step to step are 0 here."""
    shrink = 1.0 / np.sqrt(_COST_UNIT)
    yield (
        N + v.m,
        [
            *(Entry(i, j, [v.part(0, i, j)], [1.0]) for i, j in _TRIANGLE),
            *(Entry(column, N + row, [v.Y(row, column)], [rho * shrink]) for row in range(v.m) for column in range(N)),
            *(Entry(N + row, N + row, [v.tau], [rho]) for row in range(v.m)),
        ],
    )
    yield (
        2 * N,
        [
            *(Entry(i, j, [v.part(1, i, j)], [1.0]) for i, j in _TRIANGLE),
            *(Entry(column, N + row, [v.P(column, row)], [shrink]) for row in range(N) for column in range(N)),
            *(Entry(N + row, N + row, [v.tau], [1.0]) for row in range(N)),
        ],
    )
    step: dict[Pair, list[int]] = {}
    for row, column, variable in _transposed_step(v):
        step.setdefault((row, N + column), []).append(variable)
    arm = [Entry(row, column, variables, [0.0] * len(variables)) for (row, column), variables in step.items()]
    multipliers = [v.E(*pair) for pair in v.multiplier]
    yield (
        2 * N,
        [
            *(Entry(i, j, [v.part(2, i, j)], [1.0]) for i, j in _TRIANGLE),
            *arm,
            *(Entry(N + i, N + j, [v.E(i, j)], [1.0]) for i, j in v.multiplier),
        ],
    )
    yield (
        2 * N,
        [
            *(
                Entry(i, j, [v.P(i, j), *(v.part(k, i, j) for k in range(3))], [1.0, -1.0, -1.0, -1.0])
                for i, j in _TRIANGLE
            ),
            *arm,
            *(Entry(N + i, N + j, [v.P(i, j), *multipliers], [1.0] + [0.0] * len(multipliers)) for i, j in _TRIANGLE),
        ],
    )
    P = [Entry(1 + i, 1 + j, [v.P(i, j)], [1.0]) for i, j in _TRIANGLE]
    yield 1 + N, [Entry(0, 0, constant=1.0), *(Entry(0, 1 + column) for column in range(N)), *P]
    for row in range(bounds):
        bound = (Entry(0, 1 + column, [v.Y(row, column)], [1.0]) for column in range(N))
        yield 1 + N, [Entry(0, 0, constant=1.0), *bound, *P]
