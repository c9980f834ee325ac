"""The paper's robust MPC as it is written, in cvxpy, to try an inequality of your own on the bench.

platoon run formation --ecu tracker=bench/examples/lmi_tracker.py:LmiTracker

Everything else is the built-in tracker, which solves the same inequalities by faster means; the bench's own tests and
its benchmark take the optimum from here. Edit `matrix_inequalities`: whatever comes out of it, the bench certifies the
gain before it is used, and otherwise uses the previous one and reports that (`GainSource`).
"""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar

import cvxpy as cp
import numpy as np
from numpy.typing import NDArray

from bench.control.outcome import GainSource, SolverStatus
from bench.control.program import Answer, Program
from bench.control.settings import TrackerSettings
from bench.control.vehicle_model import LinearModel
from bench.ecu.tracker import TrackerEcu

Vector = NDArray[np.float64]

STATES, INPUTS, FORCES = 3, 3, 3
"""xi = [v_x, v_y, gamma], u = [steering, total force, yaw moment], and the uncertain forces that Lambda scales."""

TAU_UNIT = 300.0
"""Unit of tau, a typical cost: in this unit tau is near one, where the solver is at its most accurate."""


class RobustMpc:
    """(50)-(54): the gain K = F G^-1 with the least bound tau of the worst-case cost, in scaled units.

    Args:
        input_weight: rho of R = rho I, against Q = I.
        independent: lambda_f and lambda_r vary independently; otherwise lambda_f = lambda_r as in the paper.
        printed: use eps I as printed, instead of a matrix E that commutes with Lambda and so is as sound.
        solver: name of the solver in cvxpy.
        options: of the solver.
    """

    source = GainSource.SDP

    def __init__(
        self,
        input_weight: float,
        *,
        independent: bool = True,
        printed: bool = False,
        solver: str = cp.CLARABEL,
        options: Mapping[str, Any] | None = None,
    ) -> None:
        self._solver = {"solver": solver, **(options or {})}
        # What changes from step to step: the model, the deviation chi and the input bounds.
        self.A = cp.Parameter((STATES, STATES))
        self.B = cp.Parameter((STATES, INPUTS))
        self.N1 = cp.Parameter((FORCES, STATES))
        self.N2 = cp.Parameter((FORCES, INPUTS))
        self.HH = cp.Parameter((STATES * STATES, FORCES * FORCES))  # kron(H, H): cvxpy takes no product of parameters.
        self.chi = cp.Parameter((STATES, 1))
        self.per_bound = cp.Parameter(INPUTS)  # 1 / u_j

        self.P = cp.Variable((STATES, STATES), symmetric=True)
        self.G = cp.Variable((STATES, STATES))
        self.F = cp.Variable((INPUTS, STATES))
        self.tau = cp.Variable()
        self.Q = np.eye(STATES)
        self.R = input_weight * np.eye(INPUTS)
        self.E = cp.Variable() * np.eye(FORCES) if printed else commuting(independent)
        self.problem = cp.Problem(cp.Minimize(self.tau), self.matrix_inequalities())

    def matrix_inequalities(self) -> list[cp.Constraint]:
        """Return (51), (52) and the input bounds (54)."""
        A, B, N1, N2, chi = self.A, self.B, self.N1, self.N2, self.chi
        P, G, F, E, Q, R = self.P, self.G, self.F, self.E, self.Q, self.R
        tau = TAU_UNIT * self.tau
        next_state = A @ G + B @ F
        forces = N1 @ G + N2 @ F
        spread = cp.reshape(self.HH @ cp.vec(E, order="F"), (STATES, STATES), order="F")  # H E H'
        o33, one = np.zeros((3, 3)), np.ones((1, 1))

        # (51): the cost-to-go decreases by the stage cost at least, whatever Lambda is. Missing from print, from (63).
        decrease = cp.bmat(
            [
                [-(G + G.T - P), F.T @ R, next_state.T, G.T @ Q, forces.T],
                [R @ F, -tau * R, o33, o33, o33],
                [next_state, o33, -P + spread, o33, o33],
                [Q @ G, o33, o33, -tau * Q, o33],
                [forces, o33, o33, o33, -E],
            ]
        )
        # (52): chi lies in the ellipsoid of P.
        start = cp.bmat([[one, chi.T], [chi, P]])
        # (54): in it no input leaves its bound: [u_j^2, e_j'F; *, G + G' - P] >= 0, in units of u_j.
        rows = [self.per_bound[j] * F[j : j + 1, :] for j in range(INPUTS)]
        bounds = [cp.bmat([[one, row], [row.T, G + G.T - P]]) for row in rows]
        return [decrease << 0, start >> 0, *(bound >> 0 for bound in bounds)]

    def solve(self, model: LinearModel, z: Vector, room: Vector) -> Answer:
        """Solve for one step.

        Args:
            model: A (3, 3), B (3, 3), H (3, 3), N1 (3, 3), N2 (3, 3) in scaled units.
            z: (3,) deviation from the target.
            room: (3,) bound u_j of each input.
        """
        # H and N share a factor at will, on which the printed form depends: with columns and rows of one length its
        # numbers are moderate, and its bound is about its least.
        rows = np.linalg.norm(np.hstack([model.N1, model.N2]), axis=1)
        share = np.sqrt(np.maximum(rows, 1e-12) / np.maximum(np.linalg.norm(model.H, axis=0), 1e-12))
        H = model.H * share
        self.A.value, self.B.value, self.HH.value = model.A, model.B, np.kron(H, H)
        self.N1.value, self.N2.value = model.N1 / share[:, None], model.N2 / share[:, None]
        self.chi.value, self.per_bound.value = z[:, None], 1.0 / room
        try:
            # Without what the last solve left behind, the result depends on this step alone.
            self.problem.solve(warm_start=False, **self._solver)
        except cp.SolverError:
            return self._no_answer(SolverStatus.NUMERICAL_ERROR)
        return self._answer()

    def _answer(self) -> Answer:
        status = STATUS.get(self.problem.status, SolverStatus.NUMERICAL_ERROR)
        if status not in (SolverStatus.SOLVED, SolverStatus.ALMOST_SOLVED):
            return self._no_answer(status)
        P, F, G = self.P.value, self.F.value, self.G.value
        K = np.linalg.solve(G.T, F.T).T
        return Answer(P, K @ P, TAU_UNIT * float(self.tau.value), status, self._iterations)

    def _no_answer(self, status: SolverStatus) -> Answer:
        none = np.zeros((INPUTS, STATES))
        return Answer(np.zeros((STATES, STATES)), none, 0.0, status, self._iterations)

    @property
    def _iterations(self) -> int:
        statistics = self.problem.solver_stats
        return int(statistics.num_iters or 0) if statistics is not None else 0


STATUS = {
    cp.OPTIMAL: SolverStatus.SOLVED,
    cp.OPTIMAL_INACCURATE: SolverStatus.ALMOST_SOLVED,
    cp.USER_LIMIT: SolverStatus.MAX_ITERATIONS,
    cp.INFEASIBLE: SolverStatus.INFEASIBLE,
    cp.INFEASIBLE_INACCURATE: SolverStatus.INFEASIBLE,
}


def commuting(independent: bool) -> cp.Expression:
    """Return a symmetric matrix variable that commutes with every Lambda = diag(lambda_f, lambda_f, lambda_r)."""
    E = cp.Variable((FORCES, FORCES), symmetric=True)
    pattern = np.array([[1, 1, 0], [1, 1, 0], [0, 0, 1]]) if independent else np.ones((FORCES, FORCES))
    return cp.multiply(pattern, E)


class LmiTracker(TrackerEcu):
    """The built-in tracker with the paper's inequalities in place of its own programs."""

    printed: ClassVar[bool] = False

    @classmethod
    def solvers(cls, settings: TrackerSettings) -> Sequence[Program]:
        """Return the robust MPC in cvxpy."""
        return [RobustMpc(settings.input_weight, independent=settings.independent_axles, printed=cls.printed)]


class PrintedLmiTracker(LmiTracker):
    """The same with eps I, as printed: more conservative, see docs/rmpc-benchmark.md."""

    printed = True
