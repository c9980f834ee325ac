"""Who solves the set of problems: the bench's controller, and others with the same certificate."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from time import process_time
from typing import Any

import cvxpy as cp
import numpy as np
from numpy.typing import NDArray

from bench.benchmarks.rmpc.problems import Problem, Problems
from bench.control.program import Program
from bench.control.rmpc import Gain, RobustController
from bench.control.robust_program import RobustProgram
from bench.control.settings import TrackerSettings
from bench.control.tracker import own_programs
from bench.examples.lmi_tracker import RobustMpc

Vector = NDArray[np.float64]

Programs = Callable[[float, bool], Sequence[Program]]
"""Makes the programs for an input weight rho, and for independent axles or equal ones."""


@dataclass
class Contestant:
    """One way to solve the problems; every gain is certified as in the bench's tracker.

    Attributes:
        name: for the tables.
        programs: what is tried in turn.
        most: the largest number of problems that it is given: the slow ones get fewer.
    """

    name: str
    programs: Programs
    most: int
    _controllers: dict[tuple[float, bool], RobustController] = field(default_factory=dict)

    def controller(self, problem: Problem) -> RobustController:
        """Return the controller for problems of this kind, made once; units are those of the problems."""
        kind = problem.rho, problem.independent
        if kind not in self._controllers:
            one = np.ones(3)
            self._controllers[kind] = RobustController(
                one, one, problem.rho, self.programs(*kind), independent=problem.independent
            )
        return self._controllers[kind]


def settings(rho: float, *, independent: bool) -> TrackerSettings:
    """Return the bench's tracker settings with this input weight."""
    return replace(TrackerSettings(), input_weight=rho, independent_axles=independent)


def ours(rho: float, independent: bool) -> Sequence[Program]:
    """Return the programs of the bench's tracker."""
    return own_programs(settings(rho, independent=independent))


def clarabel_directly(rho: float, independent: bool) -> Sequence[Program]:
    """Return the bench's semidefinite program, without the bounds and then with them."""
    chosen = settings(rho, independent=independent)
    return [
        RobustProgram(
            3,
            rho,
            independent=independent,
            bounded=bounded,
            tolerance=chosen.solver_tolerance,
            max_iterations=chosen.solver_max_iterations,
        )
        for bounded in (False, True)
    ]


def by_cvxpy(solver: str, *, printed: bool = False) -> Programs:
    """Return what makes the paper's inequalities in cvxpy, for one of its solvers at its default tolerance."""
    options = _OPTIONS.get(solver)
    return lambda rho, independent: [
        RobustMpc(rho, independent=independent, printed=printed, solver=solver, options=options)
    ]


_OPTIONS: Mapping[str, Mapping[str, Any]] = {cp.CVXOPT: {"kktsolver": "robust"}}
"""CVXOPT's default factorisation fails on these problems."""

OURS = Contestant("platoon", ours, 1_000_000)
_OTHERS = {cp.SDPA: 100, cp.CVXOPT: 100, cp.SCS: 10}
"""Other solvers in cvxpy, and how many problems each is given; SCS takes seconds for one."""


def contestants() -> list[Contestant]:
    """Return all that are installed, the bench's own first."""
    found = [
        replace(OURS, _controllers={}),
        Contestant("Clarabel directly", clarabel_directly, 1_000_000),
        Contestant("cvxpy + Clarabel", by_cvxpy(cp.CLARABEL), 400),
        Contestant("cvxpy + Clarabel, εI as printed", by_cvxpy(cp.CLARABEL, printed=True), 400),
    ]
    others = (name for name in _OTHERS if name in cp.installed_solvers())
    return found + [Contestant(f"cvxpy + {name}", by_cvxpy(name), _OTHERS[name]) for name in others]


@dataclass(frozen=True)
class Result:
    """What a contestant made of a set of problems.

    Attributes:
        name: of the contestant.
        problems: the set.
        gains: its gain for each.
        seconds: (n,) processor time of each solve, of all threads, with its certificate.
    """

    name: str
    problems: Problems
    gains: Sequence[Gain]
    seconds: Vector

    @cached_property
    def usable(self) -> NDArray[np.bool_]:
        """(n,) whether the gain is certified."""
        return np.array([gain.usable for gain in self.gains], dtype=np.bool_)

    @cached_property
    def feasible(self) -> NDArray[np.bool_]:
        """(n,) whether there is a gain at all."""
        return np.isfinite(self.problems.tau)

    @cached_property
    def ratio(self) -> Vector:
        """(n,) certified tau relative to the optimum; NaN without a certified gain or an optimum."""
        tau = np.array([gain.tau if gain.usable else np.nan for gain in self.gains])
        return np.where(self.feasible, tau / np.where(self.feasible, self.problems.tau, 1.0), np.nan)

    @property
    def sources(self) -> Mapping[str, int]:
        """How many certified gains each kind of program gave."""
        names = [gain.source.name for gain in self.gains if gain.usable]
        return {name: names.count(name) for name in dict.fromkeys(names)}


def solved(contestant: Contestant, problems: Problems) -> Result:
    """Let a contestant solve problems in their order, after one that does not count."""
    gains: list[Gain] = []
    seconds = np.empty(len(problems))
    kinds = set()
    for place, problem in enumerate(problems):
        controller = contestant.controller(problem)
        if (problem.rho, problem.independent) not in kinds:
            kinds.add((problem.rho, problem.independent))
            controller.solve(problem.model, problem.z, problem.room)
        begin = process_time()
        gain = controller.solve(problem.model, problem.z, problem.room)
        seconds[place] = process_time() - begin
        gains.append(gain)
    return Result(contestant.name, problems, gains, seconds)
