"""The semidefinite program of the robust MPC, (51)-(54): its inequalities, and how a step's numbers get into them.

With P = tau W^-1, where W is the cost-to-go, and Y = K P, in scaled units with Q = I, R = rho I: minimise tau so that

    [[X1, rho Y'], [*, tau rho I]] >= 0,  [[X2, P], [*, tau I]] >= 0,          X1 + X2: the stage cost
    [[Z, (N1 P + N2 Y)'], [*, E]] >= 0,                                        Z: the uncertainty
    [[P - X1 - X2 - Z, (A P + B Y)'], [*, P - H E H']] >= 0,                   the decrease
    [[1, e_j'Y/u_j], [*, P]] >= 0 for each input j,  [[1, z'], [*, P]] >= 0.   the bounds and the start

This is (51)-(54) with three changes, none of which makes it more conservative: G = P, which loses nothing; the arrow
(63) split into a small block for each of its arms; and in place of epsilon a matrix E that commutes with Lambda, which
also covers lambda_f != lambda_r.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bench.control.semidefinite import Entry, SemidefiniteProgram, SolverStatus
from bench.control.vehicle_model import LinearModel

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]
Pair = tuple[int, int]

N = 3
_COST_UNIT = 300.0
"""The program counts tau in this unit, a usual cost of a deviation of one: so tau is near one as well."""
_UNCERTAINTY, _DECREASE, _START, _FIRST_BOUND = 2, 3, 4, 5
"""Blocks of the program; those of the stage cost, which never change, are 0 and 1."""
_TRIANGLE = [(i, j) for j in range(N) for i in range(j + 1)]


@dataclass(frozen=True)
class Answer:
    """What the solver found, unchecked, in scaled units.

    Attributes:
        P: (3, 3) ellipsoid `chi' P^-1 chi <= 1`.
        Y: (m, 3), `K P`.
        tau: cost of the deviation.
        status: how the solver ended.
        iterations: of the solver.
    """

    P: Matrix
    Y: Matrix
    tau: float
    status: SolverStatus
    iterations: int


class RobustProgram:
    """The program with its structure set up once; each solve writes its numbers into it.

    Args:
        m: number of inputs.
        input_weight: rho.
        independent: lambda_f and lambda_r vary on their own; else lambda_f = lambda_r as in the paper.
        bounded: with the input bounds.
        tolerance: of the solver.
        max_iterations: of the solver.
    """

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
        # E commutes with Lambda where it joins only what the same lambda scales.
        self._multiplier = [(i, j) for i, j in _TRIANGLE if not independent or (i == 2) == (j == 2)]
        v = self._variables = _Variables(m, self._multiplier)
        blocks = list(_blocks(v, input_weight, m if bounded else 0))
        cost = np.zeros(v.count)
        cost[v.tau] = 1.0
        self._program = program = SemidefiniteProgram(cost, blocks, tolerance=tolerance, max_iterations=max_iterations)
        step = [(row, N + column, variable) for row, column, variable in _transposed_step(v)]
        self._of_step = program.coefficient_positions(_DECREASE, step)
        self._of_uncertainty = program.coefficient_positions(_UNCERTAINTY, step)
        spread = [(N + i, N + j, v.E(*pair)) for i, j in _TRIANGLE for pair in self._multiplier]
        self._of_multiplier = program.coefficient_positions(_DECREASE, spread)
        self._of_start = program.constant_positions(_START, [(0, 1), (0, 2), (0, 3)])
        self._of_bounds = [
            program.coefficient_positions(_FIRST_BOUND + j, [(0, 1 + c, v.Y(j, c)) for c in range(N)])
            for j in range(m if bounded else 0)
        ]

    def solve(self, model: LinearModel, z: Vector, room: Vector) -> Answer:
        """Solve for one step.

        Args:
            model: of m inputs, in scaled units.
            z: (3,) deviation in scaled units, of length one.
            room: (m,) room u_j of each input in scaled units; not looked at without bounds.
        """
        self._set(model, z, room)
        solution = self._program.solve()
        v, x = self._variables, solution.x
        P = np.array([[x[v.P(i, j)] for j in range(N)] for i in range(N)])
        return Answer(P, x[v.all_Y].reshape(-1, N), float(x[v.tau]) * _COST_UNIT, solution.status, solution.iterations)

    def _set(self, model: LinearModel, z: Vector, room: Vector) -> None:
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
        program.set_constants(self._of_start[0], self._of_start[1] * z)
        for (positions, scale), bound in zip(self._of_bounds, room, strict=False):
            program.set_coefficients(positions, scale / bound)


class _Variables:
    """Which place in the program's vector of variables is what."""

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
    """Row, column and variable of each coefficient of `(F P + G Y)'`: F (3, 3) row by row, then G (3, m)."""
    for row in range(N):
        for column in range(N):
            for k in range(N):
                yield column, row, v.P(k, column)
    for row in range(N):
        for column in range(N):
            for k in range(v.m):
                yield column, row, v.Y(k, column)


def _blocks(v: _Variables, rho: float, bounds: int) -> Iterator[tuple[int, list[Entry]]]:
    """The blocks in their order, each its size and entries; what changes from step to step is 0 here."""
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
