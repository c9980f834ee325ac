"""A small semidefinite program with constant structure whose data change at every step.

`min c'x` subject to `F_k(x) >= 0` (positive semidefinite) for a few small symmetric blocks, each affine in x.
Clarabel is called directly: the structure is analysed once and each solve updates numbers in place, because building
the problem with a modelling layer takes longer than solving it.
"""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.machinery import PathFinder
from importlib.util import find_spec, module_from_spec
from pathlib import Path

import clarabel
import numpy as np
from numpy.typing import NDArray

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


class _Columns:
    """A sparse matrix column by column, with what Clarabel reads of scipy's, whose import takes 0.2 s.

    Args:
        data: (n,) coefficients.
        rows: (n,) their rows, ascending within a column.
        counts: number of coefficients in each column.
        height: number of rows.
    """

    has_canonical_format = True

    def __init__(self, data: Vector, rows: Indices, counts: Indices, height: int) -> None:
        self.data = data
        self.indices = rows
        self.indptr = np.concatenate([[0], np.cumsum(counts)])
        self.shape = (height, len(counts))


def _load_lapack() -> None:
    """Load the part of scipy in which Clarabel finds LAPACK, but not the package around it, which takes 0.2 s."""
    found = find_spec("scipy")
    if "scipy.linalg" in sys.modules or found is None or found.origin is None:
        return
    for name in ("scipy.linalg.cython_blas", "scipy.linalg.cython_lapack"):
        spec = PathFinder.find_spec(name, [str(Path(found.origin).parent / "linalg")])
        # Without it, Clarabel imports the whole package.
        if name in sys.modules or spec is None or spec.loader is None:
            continue
        sys.modules[name] = module = module_from_spec(spec)
        spec.loader.exec_module(module)


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
        order = np.lexsort((rows, columns))
        places = [(rows[at], columns[at]) for at in order]
        self._position = {place: number for number, place in enumerate(places)}
        if len(self._position) != len(places):
            raise ValueError("an entry lists the same variable twice")
        self._data = np.array(data)[order]
        counts = np.bincount(columns, minlength=cost.size)
        matrix = _Columns(self._data, np.array(rows)[order], counts, offset)
        none = _Columns(np.zeros(0), np.zeros(0, dtype=np.intp), np.zeros(cost.size, dtype=np.intp), cost.size)
        _load_lapack()
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
        self._solver = clarabel.DefaultSolver(none, cost, matrix, self._b, cones, settings)

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
