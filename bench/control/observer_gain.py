"""The observer's gain, from the linear matrix inequality (40) with a true decay rate.

`lambda_e` as printed is not a rate: scaling P, G and K makes every value feasible. With error dynamics
`e+ = (A_obs + L C_obs) e` and a rate rho in (0, 1),

    [[rho^2 P, (G A_obs + K C_obs)'], [*, G + G' - P]] > 0,   L = G^-1 K,

at every vertex of the speed range makes `e'Pe` decrease at least by the factor rho^2 per step, with one L for all
speeds.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bench.control.observer import augmented
from bench.control.outcome import SolverStatus
from bench.control.semidefinite import Entry, SemidefiniteProgram

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


def design_gain(models: Sequence[Matrix], step_s: float, rate: float) -> Matrix:
    """Return L (6, 3) with which every model's estimation error decreases by the factor `rate` per step.

    Of all feasible gains the one with the smallest `|K|` for `P >= I` is used: it amplifies noise least.

    Args:
        models: A (3, 3) at the vertices of the speed range.
        step_s: sampling time T, s.
        rate: rho in (0, 1).

    Raises:
        ValueError: no gain reaches the rate, or the gain found fails verification.
    """
    n = models[0].shape[0]
    # Scaled to the change in one step, the disturbance is as large as the state, which keeps the solver accurate.
    scale = np.concatenate([np.ones(n), np.full(n, 1.0 / step_s)])
    scaled = [augmented(A, step_s) / scale[:, None] * scale for A in models]
    unknowns = _Unknowns(n)
    blocks = [_decay_block(unknowns, A_obs, rate) for A_obs in scaled]
    blocks += [_floor_block(unknowns), _size_block(unknowns)]
    cost = np.zeros(unknowns.bound + 1)
    cost[unknowns.bound] = 1.0
    solution = SemidefiniteProgram(cost, blocks, tolerance=1e-8, max_iterations=200).solve()
    if solution.status not in (SolverStatus.SOLVED, SolverStatus.ALMOST_SOLVED):
        raise ValueError(f"no observer gain with decay rate {rate}: {solution.status.name}; raise observer_rate")
    P, G, K = unknowns.matrices(solution.x)
    L: Matrix = np.linalg.solve(G, K) * scale[:, None]
    worst = max(_growth(A, L, P / np.outer(scale, scale), step_s) for A in models)
    if not worst <= rate + 1e-4:
        raise ValueError(f"observer gain decays by {worst:.4f} a step instead of {rate}; raise observer_rate")
    return L


def _growth(A: Matrix, L: Matrix, P: Matrix, step_s: float) -> float:
    """Return the largest factor by which `sqrt(e'Pe)` grows in one step."""
    closed = augmented(A, step_s)
    closed[:, : L.shape[1]] += L
    root = np.linalg.cholesky(P)
    return float(np.linalg.norm(root.T @ closed @ np.linalg.inv(root.T), 2))


Block = tuple[int, list[Entry]]


class _Unknowns:
    """Numbers the unknowns of the design: symmetric P (N, N), G (N, N), K (N, n) and the bound of |K|, N = 2n."""

    def __init__(self, n: int) -> None:
        self.n = n
        self.N = N = 2 * n
        self._first_G = N * (N + 1) // 2
        self._first_K = self._first_G + N * N
        self.bound = self._first_K + N * n

    def P(self, i: int, j: int) -> int:
        i, j = min(i, j), max(i, j)
        return j * (j + 1) // 2 + i

    def G(self, i: int, j: int) -> int:
        return self._first_G + self.N * i + j

    def K(self, i: int, j: int) -> int:
        return self._first_K + self.n * i + j

    def matrices(self, x: Vector) -> tuple[Matrix, Matrix, Matrix]:
        """P, G and K of a solution."""
        N = self.N
        P = np.array([[x[self.P(i, j)] for j in range(N)] for i in range(N)])
        return P, x[self._first_G : self._first_K].reshape(N, N), x[self._first_K : self.bound].reshape(N, self.n)


def _decay_block(unknowns: _Unknowns, A_obs: Matrix, rate: float) -> Block:
    """`[[rho^2 P, (G A_obs + K C_obs)'], [*, G + G' - P]]`."""
    n, N, P, G, K = unknowns.n, unknowns.N, unknowns.P, unknowns.G, unknowns.K
    entries = []
    for i, j in _triangle(N):
        entries.append(Entry(i, j, [P(i, j)], [rate**2]))
        if i == j:
            entries.append(Entry(N + i, N + i, [G(i, i), P(i, i)], [2.0, -1.0]))
        else:
            entries.append(Entry(N + i, N + j, [G(i, j), G(j, i), P(i, j)], [1.0, 1.0, -1.0]))
    for row in range(N):
        for column in range(N):
            variables = [G(row, k) for k in range(N)]
            coefficients = A_obs[:, column].tolist()
            if column < n:
                variables.append(K(row, column))
                coefficients.append(1.0)
            entries.append(Entry(column, N + row, variables, coefficients))
    return 2 * N, entries


def _floor_block(unknowns: _Unknowns) -> Block:
    """`P - I`."""
    entries = [Entry(i, j, [unknowns.P(i, j)], [1.0], -1.0 if i == j else 0.0) for i, j in _triangle(unknowns.N)]
    return unknowns.N, entries


def _size_block(unknowns: _Unknowns) -> Block:
    """`[[b I, K'], [*, b I]]`: the bound b is at least |K|."""
    n, N = unknowns.n, unknowns.N
    entries = [Entry(i, i, [unknowns.bound], [1.0]) for i in range(n + N)]
    entries += [Entry(j, n + i, [unknowns.K(i, j)], [1.0]) for i in range(N) for j in range(n)]
    return n + N, entries


def _triangle(size: int) -> list[tuple[int, int]]:
    """The upper triangle of a symmetric matrix."""
    return [(i, j) for j in range(size) for i in range(j + 1)]
