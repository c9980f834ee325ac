"""A small semidefinite program with constant structure whose data change at every step.

`min c'x` subject to `F_k(x) >= 0` (positive semidefinite) for a few small symmetric blocks, each affine in x.
Clarabel is called directly: the structure is analysed once and each solve updates numbers in place, because building
the problem with a modelling layer takes longer than solving it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import clarabel
import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from bench.control.outcome import SolverStatus

Vector = NDArray[np.float64]
Indices = NDArray[np.intp]


_STATUS = {
    "Solved": SolverStatus.SOLVED,
    "AlmostSolved": SolverStatus.ALMOST_SOLVED,
    "MaxIterations": SolverStatus.MAX_ITERATIONS,
    "MaxTime": SolverStatus.MAX_ITERATIONS,
    "PrimalInfeasible": SolverStatus.INFEASIBLE,
    "AlmostPrimalInfeasible": SolverStatus.INFEASIBLE,
    "DualInfeasible": SolverStatus.INFEASIBLE,
    "AlmostDualInfeasible": SolverStatus.INFEASIBLE,
}


@dataclass(frozen=True)
class Entry:
    """Coefficients of one upper-triangle entry of a block: `constant + sum_n coefficients[n] x[variables[n]]`."""

    row: int
    column: int
    variables: Sequence[int] = ()
    coefficients: Sequence[float] = ()
    constant: float = 0.0


@dataclass(frozen=True)
class Solution:
    """The result of the solver.

    Attributes:
        status: outcome.
        x: the variables.
        iterations: interior-point iterations.
    """

    status: SolverStatus
    x: Vector
    iterations: int


class SemidefiniteProgram:
    """`min c'x` with every block positive semidefinite, solved repeatedly with new numbers.

    Args:
        cost: (n,) c.
        blocks: size and entries (upper triangle, `row <= column`) of each block. Every variable that an entry may ever
            contain must be listed, with coefficient 0 if it is initially 0.
        tolerance: feasibility and gap tolerance of the solver.
        max_iterations: limit on interior-point iterations.
    """

    def __init__(
        self,
        cost: Vector,
        blocks: Sequence[tuple[int, Sequence[Entry]]],
        *,
        tolerance: float,
        max_iterations: int,
    ) -> None:
        rows: list[int] = []
        columns: list[int] = []
        data: list[float] = []
        self._first_row: list[int] = []
        offset = sum(size * (size + 1) // 2 for size, _ in blocks)
        self._b = np.zeros(offset)
        cones = []
        offset = 0
        for size, entries in blocks:
            self._first_row.append(offset)
            cones.append(clarabel.PSDTriangleConeT(size))
            for entry in entries:
                row = offset + _triangle(entry.row, entry.column)
                scale = _scale(entry.row, entry.column)
                self._b[row] = scale * entry.constant
                for variable, coefficient in zip(entry.variables, entry.coefficients, strict=True):
                    rows.append(row)
                    columns.append(variable)
                    data.append(-scale * coefficient)
            offset += size * (size + 1) // 2
        shape = (offset, cost.size)
        # Data position of each (row, variable): a matrix of 1-based positions with the same structure.
        order = sparse.csc_matrix((np.arange(1, len(data) + 1), (rows, columns)), shape=shape)
        if order.nnz != len(data):
            raise ValueError("an entry lists the same variable twice")
        self._position = {
            (int(row), int(column)): place
            for place, (row, column) in enumerate(
                zip(order.indices, np.repeat(np.arange(cost.size), np.diff(order.indptr)), strict=True)
            )
        }
        self._data = np.array(data)[order.data - 1]
        matrix = sparse.csc_matrix((self._data, order.indices, order.indptr), shape=shape)
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        # Updating in place requires the structure as given: no presolve, no chordal decomposition.
        settings.presolve_enable = False
        settings.chordal_decomposition_enable = False
        settings.equilibrate_enable = False
        settings.iterative_refinement_enable = False
        settings.max_threads = 1
        settings.direct_solve_method = "qdldl"
        settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tolerance
        settings.max_iter = max_iterations
        self._solver = clarabel.DefaultSolver(
            sparse.csc_matrix((cost.size, cost.size)), cost, matrix, self._b, cones, settings
        )

    def coefficient_positions(self, block: int, entries: Sequence[tuple[int, int, int]]) -> tuple[Indices, Vector]:
        """Return index (for `set_coefficients`) and scale of the coefficient at each (row, column, variable)."""
        index = [
            self._position[self._first_row[block] + _triangle(row, column), variable]
            for row, column, variable in entries
        ]
        return np.array(index, dtype=np.intp), np.array([-_scale(row, column) for row, column, _ in entries])

    def constant_positions(self, block: int, entries: Sequence[tuple[int, int]]) -> tuple[Indices, Vector]:
        """Return index (for `set_constants`) and scale of the constant at each (row, column)."""
        index = [self._first_row[block] + _triangle(row, column) for row, column in entries]
        return np.array(index, dtype=np.intp), np.array([_scale(row, column) for row, column in entries])

    def set_coefficients(self, positions: Indices, values: Vector) -> None:
        """Rewrite coefficients (already multiplied by their scale) for the next solve."""
        self._data[positions] = values

    def set_constants(self, positions: Indices, values: Vector) -> None:
        """Rewrite constants (already multiplied by their scale) for the next solve."""
        self._b[positions] = values

    def solve(self) -> Solution:
        """Solve with the numbers set so far."""
        self._solver.update(A=self._data, b=self._b)
        solution = self._solver.solve()
        status = _STATUS.get(str(solution.status), SolverStatus.NUMERICAL_ERROR)
        return Solution(status, np.array(solution.x), int(solution.iterations))


def _triangle(row: int, column: int) -> int:
    """Return the index of an upper-triangle entry in column-stacked order."""
    if row > column:
        raise ValueError(f"entry ({row}, {column}) is below the diagonal")
    return column * (column + 1) // 2 + row


def _scale(row: int, column: int) -> float:
    """Off-diagonal entries count twice in the inner product of symmetric matrices."""
    return 1.0 if row == column else float(np.sqrt(2.0))
