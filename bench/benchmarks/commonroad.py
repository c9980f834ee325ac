"""The FMU compared with the multi-body model of `commonroad-vehicle-models`: same manoeuvre, same accuracy.

The two are different models of different cars (14 states here, 29 there), so neither is the other's reference: each is
compared with an accurate solution of its own equations, using its fastest solver setting within the allowed error. The
package is Python and is integrated with scipy, as in its own examples; its model gets lists instead of numpy arrays,
which halves its time. The FMU is called by plain ctypes with several step sizes, setting all inputs and getting all
outputs at every step. While the steering moves, the FMU and its reference hold it during a step (zero-order hold), as
in co-simulation; the package gets the continuous steering rate.

In the last rows of a manoeuvre the package is used as in its own example ("as is"): odeint with its default tolerances
and numpy arrays; the error of this setting is the allowed error.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib import import_module
from time import perf_counter, process_time
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import NDArray
from rich.table import Table
from scipy.integrate import odeint, solve_ivp

from bench.benchmarks.figures import Measure, Samples, in_turns, ratio_figure, seconds_text
from bench.benchmarks.prepared import PreparedCalls
from platoon_fmu.importer import Instance, Kind, OpenFmu

PACKAGE = "commonroad-vehicle-models"
WANTED = 1_000.0
SPEED_MPS, DURATION_S, STEERING_RAD, SLALOM_HZ = 20.0, 5.0, 0.03, 0.5
COMPARED_S = 0.5
"""Time between the instants at which the solutions are compared (s)."""

ACCURACIES = (1e-4, 1e-6)
ROUNDS = 5
FMU_RUNS = 20
"""Number of runs that a round averages for the FMU, since one run is too short to be representative."""

_SHORTLIST, _RERUNS = 3, 3
"""Number of the fastest settings that are repeated, and number of repetitions."""

Trajectory = NDArray[np.float64]
"""X (m), Y (m) and yaw rate (rad/s) at the compared instants: (instants, 3)."""


@dataclass(frozen=True)
class Manoeuvre:
    """The driver's input, from straight driving at `SPEED_MPS`.

    Attributes:
        title: its name.
        angle, rate: the steering angle (rad) and its rate (rad/s) over time (s).
        steps_s: the FMU's step sizes for it (s).
    """

    title: str
    angle: Callable[[float], float]
    rate: Callable[[float], float]
    steps_s: tuple[float, ...]


_TURN = 2 * math.pi * SLALOM_HZ
MANOEUVRES = (
    Manoeuvre(
        "slalom",
        lambda t: STEERING_RAD * math.sin(_TURN * t),
        lambda t: STEERING_RAD * _TURN * math.cos(_TURN * t),
        steps_s=(0.01,),
    ),
    Manoeuvre("step steer", lambda _: STEERING_RAD, lambda _: 0.0, steps_s=(0.01, 0.1, 0.5)),
)


def _short(value: float) -> str:
    """Return a value with one digit and its power of ten, as 1e-4."""
    digit, power = f"{value:.0e}".split("e")
    return f"{digit}e{int(power)}"


@dataclass(frozen=True)
class FmuSolver:
    """Settings of the FMU's own solver: a fixed step (s), or the tolerance of the adaptive one."""

    step_s: float | None = None
    tolerance: float | None = None

    def __str__(self) -> str:
        """Its name in the table."""
        return f"RK4 {1000 * self.step_s:g} ms" if self.step_s else f"DP5 {_short(self.tolerance or 0.0)}"

    @property
    def start_values(self) -> dict[str, float]:
        """The FMU's start values that select it."""
        if self.step_s:
            return {"solver": 1, "solver_step": self.step_s}
        return {"solver": 2, "solver_tolerance": self.tolerance or 0.0}


@dataclass(frozen=True)
class ScipySolver:
    """A scipy solver: `odeint` or a method of solve_ivp, and its tolerances; None for the default."""

    method: str
    relative: float | None
    absolute: float | None

    def __str__(self) -> str:
        """Its name in the table."""
        if self.relative is None or self.absolute is None:
            return f"{self.method} as is"
        return f"{self.method} {_short(self.relative)}"


FMU_SOLVERS = (
    *(FmuSolver(step_s=step) for step in (1e-2, 5e-3, 2e-3, 1e-3)),
    *(FmuSolver(tolerance=10.0**-n) for n in range(2, 9)),
)
FMU_REFERENCE = FmuSolver(tolerance=1e-13)
SCIPY_SOLVERS = tuple(
    ScipySolver(method, 10.0**-n, ratio * 10.0**-n)
    for method, tightest in (("odeint", 9), ("RK45", 8), ("BDF", 6), ("Radau", 6))
    for n in range(3, tightest + 1)
    for ratio in (1.0, 0.1)
)
SCIPY_REFERENCE = ScipySolver("odeint", 1e-11, 1e-12)
AS_IN_THE_EXAMPLE = ScipySolver("odeint", None, None)

Setting = TypeVar("Setting")


class Stopwatch:
    """Measures a block: wall-clock time (s), and this process's CPU time (s), which other processes do not affect."""

    wall_s = cpu_s = 0.0

    def __enter__(self) -> None:
        """Start."""
        self.wall_s, self.cpu_s = perf_counter(), process_time()

    def __exit__(self, *_: object) -> None:
        """Stop."""
        self.wall_s, self.cpu_s = perf_counter() - self.wall_s, process_time() - self.cpu_s


Run = Callable[[Setting], tuple[Trajectory, Stopwatch]]
"""Simulates a manoeuvre with a setting."""


@dataclass(frozen=True)
class Trial(Generic[Setting]):
    """One tried setting: its relative error (largest of X, Y and yaw rate), and its CPU time (s)."""

    setting: Setting
    error: float
    cpu_s: float


@dataclass(frozen=True)
class Comparison:
    """One row: the FMU with one step size compared with the package, both within one error.

    Attributes:
        title: the manoeuvre.
        accuracy: the allowed error.
        step_s: the FMU's step (s).
        ours, theirs: the fastest settings.
        our_seconds, their_seconds: of the whole manoeuvre, by round.
    """

    title: str
    accuracy: float
    step_s: float
    ours: Trial[FmuSolver]
    theirs: Trial[ScipySolver]
    our_seconds: Samples
    their_seconds: Samples


class MultiBody:
    """The package's model of a BMW 320i, its vehicle 2."""

    def __init__(self) -> None:
        """Import it.

        Raises:
            ModuleNotFoundError: the package is not installed.
        """
        self._derivatives = import_module("vehiclemodels.vehicle_dynamics_mb").vehicle_dynamics_mb
        self._parameters = import_module("vehiclemodels.parameters_vehicle2").parameters_vehicle2()
        self._initial = import_module("vehiclemodels.init_mb").init_mb

    def run(self, manoeuvre: Manoeuvre, solver: ScipySolver) -> tuple[Trajectory, Stopwatch]:
        """Integrate; return the trajectory and the time taken."""
        derivatives, parameters, rate = self._derivatives, self._parameters, manoeuvre.rate

        def from_list(t: float, x: NDArray[np.float64]) -> Any:
            return derivatives(x.tolist(), [rate(t), 0.0], parameters)

        def from_array(t: float, x: NDArray[np.float64]) -> Any:
            return derivatives(x, [rate(t), 0.0], parameters)

        function = from_array if solver == AS_IN_THE_EXAMPLE else from_list
        start = self._initial([0.0, 0.0, manoeuvre.angle(0.0), SPEED_MPS, 0.0, 0.0, 0.0], parameters)
        with (stopwatch := Stopwatch()):
            states = _integrated(function, np.array(start, dtype=float), solver)
        return states[1:, [0, 1, 5]], stopwatch


def _integrated(function: Callable[..., Any], x: NDArray[np.float64], solver: ScipySolver) -> Any:
    """Return the states at time 0 and the compared instants: (instants, states)."""
    instants = np.arange(round(DURATION_S / COMPARED_S) + 1) * COMPARED_S
    if solver.method == "odeint":
        return odeint(function, x, instants, tfirst=True, rtol=solver.relative, atol=solver.absolute, mxstep=100_000)
    found = solve_ivp(
        function,
        (0.0, DURATION_S),
        x,
        method=solver.method,
        t_eval=instants,
        rtol=solver.relative,
        atol=solver.absolute,
    )
    return found.y.T


class FmuVehicle:
    """The FMU, stepped by plain ctypes."""

    def __init__(self, instance: Instance) -> None:
        """Take a co-simulation instance that has not been started."""
        self._instance = instance
        self._calls = PreparedCalls(instance.start())
        self._step = self._calls.by_ctypes()
        self._steering = self._calls.input_names.index("steering_angle")
        self._compared = [self._calls.output_names.index(name) for name in ("X", "Y", "gamma")]

    def run(self, manoeuvre: Manoeuvre, h: float, solver: FmuSolver) -> tuple[Trajectory, Stopwatch]:
        """Simulate the manoeuvre in steps of `h` s; return the trajectory and the time taken."""
        self._instance.reset()
        self._instance.start({"v_x_start": SPEED_MPS, **solver.start_values})
        step, inputs, outputs = self._step, self._calls.inputs, self._calls.outputs
        steering, angle = self._steering, manoeuvre.angle
        rows = []
        every = round(COMPARED_S / h)
        with (stopwatch := Stopwatch()):
            for number in range(round(DURATION_S / h)):
                time = number * h
                inputs[steering] = angle(time)
                step(time, h)
                if (number + 1) % every == 0:
                    rows.append(outputs[:])
        return np.array(rows)[:, self._compared], stopwatch


def error_of(found: Trajectory, reference: Trajectory) -> float:
    """Return the largest deviation over the largest value, the worst of X, Y and yaw rate."""
    return float((np.abs(found - reference).max(axis=0) / np.abs(reference).max(axis=0)).max())


def trials_of(run: Run[Setting], settings: Sequence[Setting], reference: Setting) -> list[Trial[Setting]]:
    """Try every setting once."""
    truth, _ = run(reference)
    tried = ((setting, *run(setting)) for setting in settings)
    return [Trial(setting, error_of(found, truth), took.cpu_s) for setting, found, took in tried]


def quickest(run: Run[Setting], trials: Sequence[Trial[Setting]], accuracy: float) -> Trial[Setting]:
    """Return the fastest trial within an error; close ones are repeated, since one run is not representative.

    Raises:
        ValueError: none is within the error.
    """
    good = sorted((trial for trial in trials if trial.error <= accuracy), key=lambda trial: trial.cpu_s)
    if not good:
        raise ValueError(f"no setting has an error of {accuracy:g} or less")
    return min(good[:_SHORTLIST], key=lambda trial: min(run(trial.setting)[1].cpu_s for _ in range(_RERUNS)))


def _seconds_of(run: Run[Setting], trial: Trial[Setting], runs: int) -> Measure:
    """Return a measure that runs a trial several times and returns the mean wall-clock seconds."""
    return lambda: sum(run(trial.setting)[1].wall_s for _ in range(runs)) / runs


def comparisons(
    fmu: OpenFmu,
    manoeuvre: Manoeuvre,
    *,
    accuracies: Sequence[float] = ACCURACIES,
    solvers: Sequence[ScipySolver] = SCIPY_SOLVERS,
    rounds: int = ROUNDS,
) -> list[Comparison]:
    """Compare the two at one manoeuvre, within every accuracy and within that of the package's example.

    Raises:
        ModuleNotFoundError: the package is not installed.
    """
    theirs = partial(MultiBody().run, manoeuvre)
    *tried, example = trials_of(theirs, [*solvers, AS_IN_THE_EXAMPLE], SCIPY_REFERENCE)
    rivals = [(accuracy, quickest(theirs, tried, accuracy)) for accuracy in accuracies]
    found: list[Comparison] = []
    with Instance(fmu, Kind.CO_SIMULATION) as instance:
        vehicle = FmuVehicle(instance)
        ours = {h: partial(vehicle.run, manoeuvre, h) for h in manoeuvre.steps_s}
        trials = {h: trials_of(run, FMU_SOLVERS, FMU_REFERENCE) for h, run in ours.items()}
        for accuracy, rival in [*rivals, (example.error, example)]:
            best = {h: quickest(run, trials[h], accuracy) for h, run in ours.items()}
            measures = {f"{h}": _seconds_of(run, best[h], FMU_RUNS) for h, run in ours.items()}
            taken = in_turns({"theirs": _seconds_of(theirs, rival, 1), **measures}, rounds)
            found += [
                Comparison(manoeuvre.title, accuracy, h, best[h], rival, taken[f"{h}"], taken["theirs"]) for h in ours
            ]
    return found


def table(fmu: OpenFmu) -> Table | str:
    """Return the table of comparisons, or the reason for omitting it."""
    try:
        rows = [row for manoeuvre in MANOEUVRES for row in comparisons(fmu, manoeuvre)]
    except ModuleNotFoundError as error:
        return f"The comparison with {PACKAGE} is omitted ({error}): pip install {PACKAGE}"
    return table_of(rows)


def table_of(rows: Sequence[Comparison]) -> Table:
    """Return the table of comparisons: times are medians, ratios those of the minima and of the medians.

    scipy's solvers are named with their relative tolerance; the absolute one is equal to it or a tenth.
    """
    found = Table(
        title=f"Vehicle FMU through ctypes beside {PACKAGE}'s multi-body model with scipy: speed ratio\n"
        f"{DURATION_S:g} s from {SPEED_MPS:g} m/s; errors of X, Y and yaw rate, each against its own accurate solution",
        title_justify="left",
    )
    found.add_column("")
    headings = ("error\nat most", "step\nms", "FMU's\nsolver", "error", "time", "scipy's solver", "error", "time")
    for heading in (*headings, "target", "min", "median"):
        found.add_column(heading, justify="right")
    for row in rows:
        ratio = ratio_figure("", "", row.their_seconds, row.our_seconds)
        found.add_row(
            row.title,
            _short(row.accuracy),
            f"{1000 * row.step_s:g}",
            str(row.ours.setting),
            _short(row.ours.error),
            seconds_text(float(np.median(row.our_seconds))),
            str(row.theirs.setting),
            _short(row.theirs.error),
            seconds_text(float(np.median(row.their_seconds))),
            f"{WANTED:g}",
            f"{ratio.least:.3g}",
            f"{ratio.median:.3g}",
        )
    return found
