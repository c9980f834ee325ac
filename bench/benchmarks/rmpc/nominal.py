"""Model predictive control solvers of the field on the same models, deviations and bounds.

They solve another, easier problem, and give the first input of a trajectory instead of a feedback. The nominal ones
know nothing of the uncertainty; the scenario tree of do-mpc has the vertices in its first step, and holds each of them
constant afterwards. Neither proves anything about the cost for all cornering stiffnesses. They show what a step costs
elsewhere.
"""

import contextlib
import importlib.util
import io
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from time import process_time
from typing import Any

import casadi
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_discrete_are

from bench.benchmarks.rmpc.problems import Problem, Problems

Vector = NDArray[np.float64]

HORIZON = 20
"""Number of steps of 10 ms."""

Solve = Callable[[], tuple[float, bool]]
"""Solves a problem that is ready; returns the cost of the trajectory, NaN if it does not tell, and whether it could."""

_QUIET: dict[str, dict[str, Any]] = {
    "hpipm": {},
    "qpoases": {"printLevel": "none"},
    "osqp": {"osqp": {"verbose": False, "eps_abs": 1e-6, "eps_rel": 1e-6, "max_iter": 20_000}},
    "daqp": {},
    "piqp": {},
    "qrqp": {"print_iter": False, "print_header": False},
}
TITLES = {
    "hpipm": "HPIPM (the QP solver of acados)",
    "qpoases": "qpOASES",
    "osqp": "OSQP, tolerance 1e-6",
    "daqp": "DAQP",
    "piqp": "PIQP",
    "qrqp": "QRQP of CasADi",
}


@dataclass(frozen=True)
class Outcome:
    """What an MPC solver made of a set of problems.

    Attributes:
        name: of the solver.
        costs: (n,) of the trajectories; NaN where it failed, or where it does not tell.
        solved: (n,) whether it found the optimum.
        seconds: (n,) processor time of each solve.
    """

    name: str
    costs: Vector
    solved: NDArray[np.bool_]
    seconds: Vector


class Nominal:
    """The nominal MPC as a sparse QP in CasADi, `min sum x'x + rho u'u + x_N' P x_N`, P from the Riccati equation.

    Args:
        solver: name of one of CasADi's QP solvers.

    Raises:
        RuntimeError: it is not part of this CasADi.
    """

    def __init__(self, solver: str) -> None:
        block = casadi.horzcat(casadi.DM.ones(3, 6), casadi.DM.eye(3)).sparsity()
        rows, columns = block.get_triplet()
        places = [(3 * k + r, 6 * k + c) for k in range(HORIZON) for r, c in zip(rows, columns, strict=True)]
        place = (list(each) for each in zip(*places, strict=True))
        self._model = casadi.Sparsity.triplet(3 * HORIZON, 6 * HORIZON + 3, *place)
        self._cost = casadi.diagcat(casadi.DM.eye(6 * HORIZON), casadi.DM.ones(3, 3)).sparsity()
        with contextlib.redirect_stdout(io.StringIO()):
            options = {"print_time": False, "error_on_fail": False, **_QUIET[solver]}
            self._solver = casadi.conic("mpc", solver, {"h": self._cost, "a": self._model}, options)

    def prepared(self, problem: Problem) -> Solve:
        """Return the solve of a problem, with all its numbers in CasADi's own form."""
        A, B, rho, N = problem.model.A, problem.model.B, problem.rho, HORIZON
        P = solve_discrete_are(A, B, np.eye(3), rho * np.eye(3))
        dynamics, weights = np.zeros((3 * N, 6 * N + 3)), np.zeros((6 * N + 3, 6 * N + 3))
        for k in range(N):
            dynamics[3 * k : 3 * k + 3, 6 * k : 6 * k + 9] = np.hstack([A, B, -np.eye(3)])
        np.fill_diagonal(weights, [*([2.0] * 3 + [2.0 * rho] * 3) * N, 0.0, 0.0, 0.0])
        weights[-3:, -3:] = 2.0 * P
        bound = np.concatenate([np.tile([*[np.inf] * 3, *problem.room], N), [np.inf] * 3])
        lower, upper = -bound, bound
        lower[:3] = upper[:3] = problem.z
        arguments = {
            "h": casadi.project(casadi.DM(weights), self._cost),
            "a": casadi.project(casadi.DM(dynamics), self._model),
            "g": casadi.DM.zeros(6 * N + 3),
            "lba": casadi.DM.zeros(3 * N),
            "uba": casadi.DM.zeros(3 * N),
            "lbx": casadi.DM(lower),
            "ubx": casadi.DM(upper),
        }

        def solve() -> tuple[float, bool]:
            cost = float(self._solver(**arguments)["cost"])
            good = bool(self._solver.stats()["success"])
            return cost if good else np.nan, good

        return solve


class ScenarioTree:
    """The multi-stage robust MPC of do-mpc: the four vertices branch once; it solves it with IPOPT.

    Raises:
        ModuleNotFoundError: do-mpc is not installed.
    """

    def __init__(self, rho: float = 1.0) -> None:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            import do_mpc

            model = do_mpc.model.Model("discrete")
            x, u = model.set_variable("_x", "x", (3, 1)), model.set_variable("_u", "u", (3, 1))
            A, B = model.set_variable("_p", "A", (3, 3)), model.set_variable("_p", "B", (3, 3))
            model.set_rhs("x", A @ x + B @ u)
            model.setup()
            mpc = self._mpc = do_mpc.controller.MPC(model)
            mpc.settings.n_horizon, mpc.settings.n_robust, mpc.settings.t_step = HORIZON, 1, 0.01
            mpc.settings.state_discretization, mpc.settings.store_full_solution = "discrete", False
            mpc.settings.supress_ipopt_output()
            state = casadi.sumsqr(x)
            mpc.set_objective(mterm=state, lterm=state + rho * casadi.sumsqr(u))
            mpc.bounds["lower", "_u", "u"], mpc.bounds["upper", "_u", "u"] = -1.0, 1.0
            self._vertices = mpc.get_p_template(4)
            mpc.set_p_fun(lambda _: self._vertices)
            mpc.setup()

    def prepared(self, problem: Problem) -> Solve:
        """Return the solve of a problem."""
        for place, (lambda_f, lambda_r) in enumerate([(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)]):
            A, B = problem.model.at(lambda_f, lambda_r)
            self._vertices["_p", place, "A"], self._vertices["_p", place, "B"] = A, B
        self._mpc.lb_opt_x["_u"], self._mpc.ub_opt_x["_u"] = -casadi.DM(problem.room), casadi.DM(problem.room)
        self._mpc.x0 = problem.z
        self._mpc.set_initial_guess()

        def solve() -> tuple[float, bool]:
            self._mpc.make_step(problem.z.reshape(3, 1))
            return np.nan, bool(self._mpc.solver_stats["success"])

        return solve


def outcomes(problems: Problems, tree: Problems) -> Iterator[Outcome | str]:
    """Yield what each solver made of the problems of `rho = 1`, the scenario tree of those in `tree`, or why not."""
    for solver, title in TITLES.items():
        try:
            yield _outcome(title, Nominal(solver).prepared, problems)
        except RuntimeError as error:
            yield f"{title} is omitted: {str(error).splitlines()[-1]}"
    if importlib.util.find_spec("do_mpc") is None:
        yield "The scenario tree of do-mpc is omitted: pip install do-mpc"
    else:
        yield _outcome("do-mpc, scenario tree, IPOPT", ScenarioTree().prepared, tree)


def _outcome(title: str, prepare: Callable[[Problem], Solve], problems: Problems) -> Outcome:
    costs, seconds, done = np.empty(len(problems)), np.empty(len(problems)), np.zeros(len(problems), dtype=np.bool_)
    prepare(problems.at(0))()
    for place, problem in enumerate(problems):
        solve = prepare(problem)
        begin = process_time()
        costs[place], done[place] = solve()
        seconds[place] = process_time() - begin
    return Outcome(title, costs, done, seconds)
