"""The lumped-disturbance observer, (37)-(42).

`xibar+ = A xibar + B ubar + T d`, `d+ = d`: d gathers everything the nominal model does not know (cornering
stiffness, wind, slope, rolling resistance, linearisation) as an acceleration [m/s^2, m/s^2, rad/s^2]; hence E = T I.
As the paper does, all of `[v_x, v_y, gamma]` is taken as measured (C = I).

The gain comes from (40) with a true decay rate: as printed `lambda_e` is none, since scaling P, G and K makes every
value feasible. With error dynamics `e+ = (A_obs + L C_obs) e` and a rate rho in (0, 1),

    [[rho^2 P, (G A_obs + K C_obs)'], [*, G + G' - P]] > 0,   L = G^-1 K,

at every vertex of the speed range gives `e'Pe` falling by at least rho^2 each step, with one L for all speeds.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from bench.control.semidefinite import Entry, SemidefiniteProgram, SolverStatus

Vector = NDArray[np.float64]
Matrix = NDArray[np.float64]


def augmented(A: Matrix, step_s: float) -> Matrix:
    """A_obs (6, 6) of (38) for a model A (3, 3)."""
    n = A.shape[0]
    return np.block([[A, step_s * np.eye(n)], [np.zeros((n, n)), np.eye(n)]])


class DisturbanceObserver:
    """Estimates the deviation state and the disturbance from measured states, (39).

    Args:
        gain: L (6, 3) of `design_gain`.
        step_s: sampling time T, s.
    """

    def __init__(self, gain: Matrix, step_s: float) -> None:
        self._gain = gain
        self._step_s = step_s
        self._state: Vector | None = None
        self._error: Vector = np.zeros(gain.shape[1])
        self._previous: Vector = np.zeros(gain.shape[1])
        self.disturbance: Vector = np.zeros(gain.shape[1])

    def correct(self, xi: Vector) -> Vector:
        """Take in a measured state (3,) and return the disturbance estimate (3,), an acceleration.

        The first measurement starts the observer: the state is taken as measured and the disturbance as zero.
        """
        if self._state is None:
            self._state = xi
        self._error = self._state - xi
        self._previous = self.disturbance
        self.disturbance = self._previous + self._gain[xi.size :] @ self._error
        return self.disturbance

    def predict(self, A: Matrix, B: Matrix, xi_ref: Vector, u_dev: Vector, drift: Vector) -> None:
        """Predict the next state from the input that was really applied; `correct` must have been called.

        Args:
            A: (3, 3) model at this step.
            B: (3, m) model at this step.
            xi_ref: (3,) this step's reference state.
            u_dev: (m,) applied input less the reference input.
            drift: (3,) where the reference input alone takes the reference state.
        """
        if self._state is None:
            raise ValueError("the observer predicts only after its first measurement")
        self._state = (
            drift
            + A @ (self._state - xi_ref)
            + B @ u_dev
            + self._step_s * self._previous
            + self._gain[: xi_ref.size] @ self._error
        )


def design_gain(models: Sequence[Matrix], step_s: float, rate: float) -> Matrix:
    """L (6, 3) that makes every model's estimation error fall by `rate` a step.

    Among all feasible gains the one of the smallest `|K|` for `P >= I` is taken: it amplifies noise least.

    Args:
        models: A (3, 3) at the vertices of the speed range.
        step_s: sampling time T, s.
        rate: rho in (0, 1).

    Raises:
        ValueError: no gain reaches the rate, or the one found does not pass its check.
    """
    n = models[0].shape[0]
    N = 2 * n
    # In units of one step's change the disturbance is as large as the state, which keeps the solver accurate.
    scale = np.concatenate([np.ones(n), np.full(n, 1.0 / step_s)])
    scaled = [augmented(A, step_s) / scale[:, None] * scale for A in models]
    P = _Symmetric(N, 0)
    first_G = P.end
    first_K = first_G + N * N
    bound = first_K + N * n

    def G(row: int, column: int) -> int:
        return first_G + N * row + column

    def K(row: int, column: int) -> int:
        return first_K + n * row + column

    blocks: list[tuple[int, list[Entry]]] = []
    for A_obs in scaled:
        entries = []
        for j in range(N):
            for i in range(j + 1):
                entries.append(Entry(i, j, [P(i, j)], [rate**2]))
                transposed = [G(i, j), G(j, i)] if i != j else [G(i, i)]
                entries.append(
                    Entry(N + i, N + j, [*transposed, P(i, j)], [1.0 if i != j else 2.0] * len(transposed) + [-1.0])
                )
        for row in range(N):  # (G A_obs + K C_obs)[row, column] stands at [column, N + row]
            for column in range(N):
                variables = [G(row, k) for k in range(N)]
                coefficients = [float(A_obs[k, column]) for k in range(N)]
                if column < n:
                    variables.append(K(row, column))
                    coefficients.append(1.0)
                entries.append(Entry(column, N + row, variables, coefficients))
        blocks.append((2 * N, entries))
    blocks.append((N, [Entry(i, j, [P(i, j)], [1.0], -1.0 if i == j else 0.0) for j in range(N) for i in range(j + 1)]))
    blocks.append(
        (
            n + N,
            [Entry(i, i, [bound], [1.0]) for i in range(n + N)]
            + [Entry(j, n + i, [K(i, j)], [1.0]) for i in range(N) for j in range(n)],
        )
    )
    cost = np.zeros(bound + 1)
    cost[bound] = 1.0
    solution = SemidefiniteProgram(cost, blocks, tolerance=1e-8, max_iterations=200).solve()
    if solution.status not in (SolverStatus.SOLVED, SolverStatus.ALMOST_SOLVED):
        raise ValueError(f"no observer gain with decay rate {rate}: {solution.status.name}; raise observer_rate")
    G_value = solution.x[first_G:first_K].reshape(N, N)
    K_value = solution.x[first_K:bound].reshape(N, n)
    L: Matrix = np.linalg.solve(G_value, K_value) * scale[:, None]
    P_value = P.matrix(solution.x) / np.outer(scale, scale)
    worst = max(_growth(A, L, P_value, step_s) for A in models)
    if not worst <= rate + 1e-4:
        raise ValueError(f"observer gain decays by {worst:.4f} a step instead of {rate}; raise observer_rate")
    return L


def _growth(A: Matrix, L: Matrix, P: Matrix, step_s: float) -> float:
    """The factor by which `sqrt(e'Pe)` grows in one step at most."""
    closed = augmented(A, step_s)
    closed[:, : L.shape[1]] += L
    root = np.linalg.cholesky(P)
    return float(np.linalg.norm(root.T @ closed @ np.linalg.inv(root.T), 2))


class _Symmetric:
    """Numbers the free entries of a symmetric matrix variable from `first` on."""

    def __init__(self, size: int, first: int) -> None:
        self.size = size
        self.first = first
        self.end = first + size * (size + 1) // 2

    def __call__(self, i: int, j: int) -> int:
        i, j = min(i, j), max(i, j)
        return self.first + j * (j + 1) // 2 + i

    def matrix(self, x: Vector) -> Matrix:
        return np.array([[x[self(i, j)] for j in range(self.size)] for i in range(self.size)])
