"""The semidefinite programme with changing numbers: right against cvxpy, and the same as one built afresh."""

import subprocess
import sys

import cvxpy
import numpy as np
import pytest

from bench.control.outcome import SolverStatus
from bench.control.semidefinite import Entry, SemidefiniteProgram

ACCURACY = {"tolerance": 1e-9, "max_iterations": 100}


def symmetric(random: np.random.Generator, size: int) -> np.ndarray:
    half = random.normal(size=(size, size))
    return half + half.T


class Problem:
    """`min c'x`, with F_0 + sum x_k F_k >= 0 in two blocks, bounded and strictly feasible by construction."""

    SIZES = (3, 4)

    def __init__(self, seed: int, variables: int = 4) -> None:
        random = np.random.default_rng(seed)
        self.n = variables
        # Both blocks hold strictly at x = 0, and c = sum <F_k, Z> for a Z > 0, which bounds the cost.
        self.constant = [np.eye(size) * random.uniform(1, 2) for size in self.SIZES]
        self.coefficient = [[symmetric(random, size) for _ in range(variables)] for size in self.SIZES]
        self.cost = np.array([sum(np.trace(F[k]) for F in self.coefficient) for k in range(variables)])

    def blocks(self) -> list[tuple[int, list[Entry]]]:
        everything = list(range(self.n))
        return [
            (
                size,
                [Entry(i, j, everything, [M[i, j] for M in F], F_0[i, j]) for j in range(size) for i in range(j + 1)],
            )
            for size, F_0, F in zip(self.SIZES, self.constant, self.coefficient, strict=True)
        ]

    def program(self) -> SemidefiniteProgram:
        return SemidefiniteProgram(self.cost, self.blocks(), **ACCURACY)

    def by_cvxpy(self) -> float:
        x = cvxpy.Variable(self.n)
        constraints = [
            F_0 + sum(x[k] * M for k, M in enumerate(F)) >> 0
            for F_0, F in zip(self.constant, self.coefficient, strict=True)
        ]
        problem = cvxpy.Problem(cvxpy.Minimize(self.cost @ x), constraints)
        problem.solve(solver=cvxpy.CLARABEL)
        assert problem.status == cvxpy.OPTIMAL
        return float(problem.value)

    def least_eigenvalue(self, x: np.ndarray) -> float:
        return min(
            float(np.linalg.eigvalsh(F_0 + np.tensordot(x, F, 1))[0])
            for F_0, F in zip(self.constant, self.coefficient, strict=True)
        )


@pytest.mark.parametrize("seed", range(10))
def test_optimum_is_the_one_cvxpy_finds(seed: int) -> None:
    problem = Problem(seed)
    solution = problem.program().solve()
    assert solution.status is SolverStatus.SOLVED
    assert problem.cost @ solution.x == pytest.approx(problem.by_cvxpy(), rel=1e-5, abs=1e-6)
    assert problem.least_eigenvalue(solution.x) > -1e-6


def test_smallest_eigenvalue_as_a_program() -> None:
    """max t with F - t I >= 0 is the smallest eigenvalue of F."""
    F = symmetric(np.random.default_rng(5), 5)
    entries = [
        Entry(i, j, [0] if i == j else [], [-1.0] if i == j else [], F[i, j]) for j in range(5) for i in range(j + 1)
    ]
    solution = SemidefiniteProgram(np.array([-1.0]), [(5, entries)], **ACCURACY).solve()
    assert solution.x[0] == pytest.approx(np.linalg.eigvalsh(F)[0], abs=1e-6)


@pytest.mark.parametrize("seed", range(5))
def test_rewriting_numbers_equals_building_afresh(seed: int) -> None:
    """From one problem's numbers to another's and back, every coefficient and constant."""
    one, other = Problem(seed), Problem(seed + 100)
    other.cost = one.cost
    program = one.program()
    first = program.solve()
    for numbers in (other, one):
        for block, (F_0, F) in enumerate(zip(numbers.constant, numbers.coefficient, strict=True)):
            places = [(i, j) for j in range(len(F_0)) for i in range(j + 1)]
            positions, scale = program.coefficient_positions(
                block, [(i, j, k) for i, j in places for k in range(one.n)]
            )
            program.set_coefficients(positions, scale * np.array([F[k][i, j] for i, j in places for k in range(one.n)]))
            positions, scale = program.constant_positions(block, places)
            program.set_constants(positions, scale * np.array([F_0[i, j] for i, j in places]))
        afresh = SemidefiniteProgram(one.cost, numbers.blocks(), **ACCURACY).solve()
        again = program.solve()
        assert again.status is afresh.status
        np.testing.assert_array_equal(again.x, afresh.x)
    np.testing.assert_array_equal(again.x, first.x)


def diagonal(*entries: tuple[float, float]) -> list[tuple[int, list[Entry]]]:
    """One block with a_k + b_k x on its diagonal."""
    return [(len(entries), [Entry(k, k, [0], [b], a) for k, (a, b) in enumerate(entries)])]


def test_infeasible_is_said() -> None:
    """x >= 1 and x <= -1."""
    program = SemidefiniteProgram(np.ones(1), diagonal((-1.0, 1.0), (-1.0, -1.0)), **ACCURACY)
    assert program.solve().status is SolverStatus.INFEASIBLE


def test_unbounded_is_not_called_solved() -> None:
    program = SemidefiniteProgram(-np.ones(1), diagonal((0.0, 1.0)), **ACCURACY)
    assert program.solve().status is SolverStatus.INFEASIBLE


def test_too_few_iterations_are_said() -> None:
    solution = SemidefiniteProgram(Problem(1).cost, Problem(1).blocks(), tolerance=1e-9, max_iterations=2).solve()
    assert solution.status is SolverStatus.MAX_ITERATIONS
    assert solution.iterations == 2


def test_not_a_number_is_not_called_solved() -> None:
    program = SemidefiniteProgram(np.ones(1), diagonal((1.0, 1.0)), **ACCURACY)
    positions, scale = program.constant_positions(0, [(0, 0)])
    program.set_constants(positions, scale * np.array([np.nan]))
    assert program.solve().status not in (SolverStatus.SOLVED, SolverStatus.ALMOST_SOLVED)


def test_the_same_variable_twice_in_an_entry_is_refused() -> None:
    with pytest.raises(ValueError, match="same variable twice"):
        SemidefiniteProgram(np.ones(1), [(1, [Entry(0, 0, [0, 0], [1.0, 2.0])])], **ACCURACY)


def test_the_same_entry_twice_is_refused() -> None:
    with pytest.raises(ValueError, match="same variable twice"):
        SemidefiniteProgram(np.ones(1), [(1, [Entry(0, 0, [0], [1.0]), Entry(0, 0, [0], [1.0])])], **ACCURACY)


def test_entries_below_the_diagonal_are_refused() -> None:
    with pytest.raises(ValueError, match=r"entry \(1, 0\) is below the diagonal"):
        SemidefiniteProgram(np.ones(1), [(2, [Entry(1, 0, [0], [1.0])])], **ACCURACY)


def test_variables_and_coefficients_must_match() -> None:
    with pytest.raises(ValueError, match="zip"):
        SemidefiniteProgram(np.ones(1), [(1, [Entry(0, 0, [0], [])])], **ACCURACY)


def test_coefficients_that_were_not_listed_cannot_be_set() -> None:
    program = SemidefiniteProgram(np.ones(2), [(2, [Entry(0, 0, [0], [1.0]), Entry(1, 1, [1], [1.0])])], **ACCURACY)
    with pytest.raises(KeyError):
        program.coefficient_positions(0, [(0, 0, 1)])


def test_of_scipy_only_lapack_is_loaded() -> None:
    """Its packages would stop a tracker for 0.2 s when a bound first binds; they can still be imported afterwards."""
    code = (
        "import sys, numpy as np\nSCIPY = 'scipy.linalg', 'scipy.sparse'\n"
        "from bench.control.semidefinite import Entry, SemidefiniteProgram\n"
        "block = (2, [Entry(0, 0, [0], [1.0]), Entry(0, 1, constant=1.0), Entry(1, 1, [0], [1.0])])\n"
        "solution = SemidefiniteProgram(np.ones(1), [block], tolerance=1e-9, max_iterations=50).solve()\n"
        "print(round(float(solution.x[0]), 6), [name for name in SCIPY if name in sys.modules])\n"
        "import scipy.linalg, scipy.sparse\n"
        "from scipy.linalg import cython_lapack\n"
        "print(scipy.linalg.solve_discrete_are(0.5 * np.eye(1), np.eye(1), np.eye(1), np.eye(1)).shape)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == ["1.0 []", "(1, 1)"]
