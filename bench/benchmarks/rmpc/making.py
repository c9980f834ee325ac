"""Makes the set of problems: steps recorded from all shipped scenarios, random ones, and ones at the input bounds.

Everything is drawn from one seed. The optimum of each problem is found by the paper's inequalities in cvxpy.
"""

import platform
import tempfile
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import clarabel
import cvxpy
import numpy as np
from numpy.typing import NDArray

from bench.benchmarks.rmpc.problems import PIECE, Problem, Problems, problems_of
from bench.bus.link.address import Address
from bench.conductor.options import RunOptions
from bench.conductor.run import run
from bench.control.allocation import allocate
from bench.control.outcome import SolverStatus
from bench.control.program import Answer, Program
from bench.control.robust_program import RobustProgram
from bench.control.settings import TrackerSettings
from bench.control.vehicle_model import LinearModel, VehicleModel
from bench.cycle import CYCLE_S
from bench.ecu.loading import DEFAULT_ECUS
from bench.ecu.tracker import TrackerEcu
from bench.examples.lmi_tracker import RobustMpc
from bench.scenario import load, shipped
from platoon_fmu.parameters import VehicleParameters

Vector = NDArray[np.float64]

SEED = 2020
RECORDED, RANDOM, BOUND, WEIGHTS, EQUAL = 5000, 2000, 2000, 500, 500
"""How many problems of each kind."""
ORACLE_TOLERANCES = (1e-9, 1e-8, 1e-7)
"""Of the oracle's solver; a looser one only where it does not reach the one before."""
_MORE_ROOM = 10.0
"""The bench's controller uses no more room than this."""


@dataclass(frozen=True)
class Step:
    """What a tracker's solver was asked in one step, in scaled units."""

    model: LinearModel
    z: Vector
    room: Vector


class Recorder:
    """A program that keeps what it is asked, and lets another one answer."""

    def __init__(self, program: Program, steps: list[Step]) -> None:
        self.source = program.source
        self._program = program
        self._steps = steps

    def solve(self, model: LinearModel, z: Vector, room: Vector) -> Answer:
        """Solve for one step."""
        self._steps.append(Step(model, z.copy(), room.copy()))
        return self._program.solve(model, z, room)


class RecordingTracker(TrackerEcu):
    """The built-in tracker, which keeps what its solver is asked."""

    steps: ClassVar[list[list[Step]]] = []

    @classmethod
    def solvers(cls, settings: TrackerSettings) -> Sequence[Program]:
        """Return the built-in programs, the first of which is recorded, as it is always asked."""
        cls.steps.append([])
        first, *others = TrackerEcu.solvers(settings)
        return [Recorder(first, cls.steps[-1]), *others]


def made(note: Callable[[str], None]) -> Problems:
    """Make the whole set; `note` is told what is being done."""
    dice = np.random.default_rng(SEED)
    recorded = recorded_problems(dice, RECORDED, note)
    random = [random_problem(dice) for _ in range(RANDOM)]
    found = [*recorded, *random]
    found += [at_bounds(replace(_any(dice, found), group="at the bounds", run=-1), dice) for _ in range(BOUND)]
    for _ in range(WEIGHTS):
        weight = float(dice.choice([0.1, 10.0]))
        found.append(perhaps_at_bounds(replace(random_problem(dice), group="other weights", rho=weight), dice))
    for _ in range(EQUAL):
        equal = replace(_any(dice, random), group="equal axles", independent=False)
        found.append(perhaps_at_bounds(equal, dice))
    return with_optima(problems_of(found, {}), note)


def recorded_problems(dice: np.random.Generator, count: int, note: Callable[[str], None]) -> list[Problem]:
    """Return problems from runs of all shipped scenarios, as many of each, in runs of consecutive steps."""
    names = shipped()
    found: list[Problem] = []
    for place, name in enumerate(names):
        note(f"running {name}")
        trackers = recorded_steps(name)
        wanted = count * (place + 1) // len(names) - len(found)
        while wanted > 0:
            steps = trackers[dice.integers(len(trackers))]
            start = int(dice.integers(len(steps) - PIECE))
            number = 1 + max((each.run for each in found), default=-1)
            piece = steps[start : start + min(wanted, PIECE)]
            found += [Problem(s.model, s.z, s.room, 1.0, True, name, number, np.nan) for s in piece]
            wanted -= len(piece)
    return found


def recorded_steps(scenario: str, overrides: Sequence[str] = ()) -> list[list[Step]]:
    """Run a scenario; return what the solver of each vehicle was asked in each step."""
    RecordingTracker.steps.clear()
    ecus = {**DEFAULT_ECUS, "tracker": f"{__name__}:{RecordingTracker.__name__}"}
    with tempfile.TemporaryDirectory(prefix="platoon-bench-") as folder:
        run(
            RunOptions(
                load(scenario, overrides),
                address=Address.parse("direct"),
                out=Path(folder) / "run.mcap",
                command_line=["bench.benchmarks", "rmpc"],
                ecus=ecus,
            )
        )
    return [steps for steps in RecordingTracker.steps if len(steps) > PIECE]


def random_problem(dice: np.random.Generator) -> Problem:
    """Return a problem at a random speed, yaw rate and input, with a random deviation."""
    settings, vehicle = TrackerSettings(), VehicleParameters()
    allocation = allocate(vehicle, settings.steering_max_rad, settings.wheel_force_max_n, settings.yaw_moment_share)
    model = VehicleModel(vehicle, CYCLE_S)
    v = dice.uniform(3.0, 45.0)
    gamma = dice.uniform(-1.0, 1.0) * 0.85 * vehicle.mu_a * 9.8 / max(v, 8.0)
    xi = np.array([v, model.steady_lateral_velocity(v, gamma), gamma])
    u = dice.uniform(-0.5, 0.5, 3) * allocation.limit
    linear = model.linearise(xi, allocation.matrix @ u).with_inputs(allocation.matrix)
    x_unit = np.array([settings.speed_unit_mps, settings.lateral_speed_unit_mps, settings.yaw_rate_unit_radps])
    u_unit = np.array([settings.steering_unit_rad, settings.force_unit_n, settings.yaw_moment_unit_nm])
    scaled = LinearModel(
        linear.A / x_unit[:, None] * x_unit,
        linear.B / x_unit[:, None] * u_unit,
        linear.H / x_unit[:, None],
        linear.N1 * x_unit,
        linear.N2 * u_unit,
    )
    z = dice.normal(size=3)
    size = np.exp(dice.uniform(np.log(0.01), np.log(2.0)))
    room = (allocation.limit - np.abs(u)) / u_unit / size
    return Problem(scaled, z / np.linalg.norm(z), np.minimum(room, _MORE_ROOM), 1.0, True, "random", -1, np.nan)


def at_bounds(problem: Problem, dice: np.random.Generator) -> Problem:
    """Return the problem with so little room that one to three of its input bounds bind."""
    free = RobustProgram(
        3, problem.rho, independent=problem.independent, bounded=False, tolerance=1e-6, max_iterations=60
    ).solve(problem.model, problem.z, problem.room)
    # The largest inputs in the ellipsoid of the optimum without bounds.
    reached = np.sqrt(np.maximum(np.diag(free.Y @ np.linalg.solve(free.P, free.Y.T)), 1e-6))
    tight = dice.permutation(3) < dice.integers(1, 4)
    return replace(
        problem, room=np.where(tight, dice.uniform(0.2, 1.0, 3) * reached, np.maximum(problem.room, reached))
    )


def perhaps_at_bounds(problem: Problem, dice: np.random.Generator) -> Problem:
    """Return every other problem with input bounds that bind."""
    return at_bounds(problem, dice) if dice.random() < 0.5 else problem


def with_optima(problems: Problems, note: Callable[[str], None]) -> Problems:
    """Return the problems with the optimum of each; those that cvxpy cannot decide are left out."""
    note("solving all in cvxpy")
    tau = optima_of(problems, note)
    note(f"{np.isinf(tau).sum()} are infeasible; left out as undecided: {np.isnan(tau).sum()}")
    about = {
        "tau": f"cvxpy {cvxpy.__version__}, Clarabel {clarabel.__version__}, tolerance {ORACLE_TOLERANCES[0]:g}",
        "left out": str(int(np.isnan(tau).sum())),
        "made on": f"Python {platform.python_version()}, numpy {np.__version__}",
    }
    return replace(problems, tau=tau, about=about).chosen(np.flatnonzero(~np.isnan(tau)))


def optima_of(problems: Problems, note: Callable[[str], None]) -> Vector:
    """Return the optimum of each problem (n,); infinite if it is infeasible, NaN if cvxpy cannot decide."""
    oracles: dict[tuple[float, bool], list[RobustMpc]] = {}
    tau = np.full(len(problems), np.nan)
    for place, problem in enumerate(problems):
        kind = (problem.rho, problem.independent)
        if kind not in oracles:
            oracles[kind] = [_oracle(*kind, tolerance) for tolerance in ORACLE_TOLERANCES]
        tau[place] = optimum(oracles[kind], problem)
        if place % 1000 == 999:
            note(f"{place + 1} of {len(problems)} solved")
    return tau


def optimum(oracles: Sequence[RobustMpc], problem: Problem) -> float:
    """Return the least tau, infinite if infeasible, NaN if no oracle decides."""
    for oracle in oracles:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message="Solution may be inaccurate")
            answer = oracle.solve(problem.model, problem.z, problem.room)
        if answer.status is SolverStatus.SOLVED:
            return answer.tau
        if answer.status is SolverStatus.INFEASIBLE:
            return np.inf
    return np.nan


def _oracle(rho: float, independent: bool, tolerance: float) -> RobustMpc:
    options = dict.fromkeys(("tol_gap_abs", "tol_gap_rel", "tol_feas"), tolerance) | {"max_iter": 200}
    return RobustMpc(rho, independent=independent, options=options)


def _any(dice: np.random.Generator, problems: Sequence[Problem]) -> Problem:
    return problems[int(dice.integers(len(problems)))]
