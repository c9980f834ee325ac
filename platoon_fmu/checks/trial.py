"""A short run of any FMU: its start values, its steps, and the variables read after each."""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from platoon_fmu.errors import FmuError
from platoon_fmu.importer import Instance, Kind, OpenFmu, Value

#: Number of steps of a run.
STEPS = 10

#: The real types, which can be integrated and differenced.
REAL = ("Real", "Float64")

# Change of a start value, relative to its nominal value or magnitude.
_MOVE_OF_NOMINAL = 0.1
_MOVE_OF_START = 0.01
_TOLERANCE = 1e-6

#: The values of variables by name, arrays in row-major order.
Snapshot = dict[str, tuple[Value, ...]]


@dataclass(frozen=True)
class Experiment:
    """The times of a run.

    Attributes:
        start: start time [s].
        step: communication step size [s].
        tolerance: relative tolerance for the FMU's own solver, or None.
    """

    start: float
    step: float
    tolerance: float | None


def experiment(fmu: OpenFmu) -> Experiment:
    """The times in the FMU's DefaultExperiment; without a step size, a thousandth of its duration, or 0.01 s."""
    default = fmu.description.defaultExperiment
    start = number(default.startTime if default else None) or 0.0
    stop = number(default.stopTime if default else None)
    step = number(default.stepSize if default else None)
    if not step and fmu.element(Kind.CO_SIMULATION) is not None:
        step = number(fmu.element(Kind.CO_SIMULATION).fixedInternalStepSize)
    if not step and stop is not None and stop > start:
        step = (stop - start) / 1000
    tolerance = number(default.tolerance if default else None)
    return Experiment(start, step if step and step > 0 else 0.01, tolerance)


def number(text: Any) -> float | None:
    """A number in modelDescription.xml; None if absent or not a finite number."""
    try:
        value = float(text)
    except (TypeError, ValueError):
        return None
    return value if math.isfinite(value) else None


def limit(variable: Any, name: str) -> float | None:
    """The `min`, `max` or `nominal` of a variable, possibly from its declared type."""
    own = number(getattr(variable, name))
    return own if own is not None or variable.declaredType is None else number(getattr(variable.declaredType, name))


def start_values(variable: Any) -> list[float] | None:
    """The start values of a real variable's elements; None if absent."""
    count = math.prod(variable.shape or ())
    values = [number(text) for text in (variable.start or "").split()]
    found = [value for value in values if value is not None]
    if not found or len(found) != len(values):
        return None
    return found * count if len(found) == 1 else found


def continuous_inputs(fmu: OpenFmu) -> tuple[Any, ...]:
    """The inputs that may change at any time."""
    return tuple(v for v in _real(fmu) if v.causality == "input" and v.variability == "continuous")


def moved_start(fmu: OpenFmu) -> dict[str, list[float]]:
    """Start values within the limits that differ from the FMU's own, for the most influential kind of variable.

    Returns:
        start values by name: of the inputs; if there are none, of the states; if there are none, of the parameters.
    """
    states = [v for v in _real(fmu) if v.initial == "exact" and v.variability == "continuous"]
    parameters = [v for v in _real(fmu) if v.causality == "parameter"]
    for variables in (continuous_inputs(fmu), states, parameters):
        moved = {v.name: _moved(v) for v in variables if start_values(v) is not None}
        if moved:
            return moved
    return {}


def _real(fmu: OpenFmu) -> list[Any]:
    return [v for v in fmu.description.modelVariables if v.type in REAL and v.alias is None]


def _moved(variable: Any) -> list[float]:
    nominal, least, most = (limit(variable, name) for name in ("nominal", "min", "max"))
    return [_away(start, nominal, least, most) for start in start_values(variable) or []]


def _away(start: float, nominal: float | None, least: float | None, most: float | None) -> float:
    move = _MOVE_OF_NOMINAL * abs(nominal) if nominal else _MOVE_OF_START * max(abs(start), 1.0)
    for other in (start + move, start - move):
        if (least is None or other >= least) and (most is None or other <= most):
            return other
    return start


def observed(fmu: OpenFmu, kind: Kind) -> tuple[str, ...]:
    """The variables to read: outputs, and in Model Exchange states and derivatives; all others if there are none."""
    variables = [v for v in fmu.description.modelVariables if v.type not in ("Binary", "Clock") and v.alias is None]
    names = [v.name for v in variables if v.causality == "output"]
    if kind is Kind.MODEL_EXCHANGE:
        for unknown in fmu.description.derivatives:
            names += [unknown.variable.derivative.name, unknown.variable.name]
    changing = [v.name for v in variables if v.variability in ("discrete", "continuous") and v.causality == "local"]
    return tuple(dict.fromkeys(names or changing))


def advance(instance: Instance, h: float) -> None:
    """Advances by h seconds, in Model Exchange by integration.

    The same state gives the same values, bit for bit.

    Raises:
        FmuError: a derivative is not finite, or the states cannot be integrated.
    """
    if instance.kind is Kind.CO_SIMULATION:
        instance.step(h)
        return
    time = instance.time + h
    instance.set_states(_integrated(instance, time), time)
    instance.complete_step()


def _integrated(instance: Instance, end: float) -> NDArray[np.float64]:
    from scipy.integrate import solve_ivp

    x = instance.states()
    if not len(x):
        return x
    names, nominal = _derivative_elements(instance)

    def derivatives(time: float, x: NDArray[np.float64]) -> NDArray[np.float64]:
        instance.set_states(x, time)
        found = instance.derivatives()
        wrong = np.flatnonzero(~np.isfinite(found))
        if len(wrong):
            raise FmuError(f"{names[wrong[0]]} is {found[wrong[0]]} at t = {time:g} s")
        return found

    # For stiff and non-stiff models.
    solution = solve_ivp(
        derivatives, (instance.time, end), x, method="LSODA", rtol=_TOLERANCE, atol=_TOLERANCE * nominal
    )
    if not solution.success:
        raise FmuError(f"the states cannot be integrated up to t = {end:g} s: {solution.message}")
    final: NDArray[np.float64] = solution.y[:, -1]
    return final


def _derivative_elements(instance: Instance) -> tuple[list[str], NDArray[np.float64]]:
    """For each element of the state vector: the name of its derivative, and its nominal value."""
    names: list[str] = []
    nominals: list[float] = []
    for unknown in instance.fmu.description.derivatives:
        state = unknown.variable.derivative
        names += [unknown.variable.name] * instance.size(state.name)
        nominals += [abs(limit(state, "nominal") or 1.0)] * instance.size(state.name)
    return names, np.array(nominals)


def run(instance: Instance, names: Sequence[str], h: float, steps: int = STEPS) -> list[Snapshot]:
    """Advances by some steps; the values after each."""
    snapshots = []
    for _ in range(steps):
        advance(instance, h)
        snapshots.append(instance.read(*names))
    return snapshots


def first_difference(one: Sequence[Snapshot], other: Sequence[Snapshot]) -> tuple[int, str, Value, Value] | None:
    """The first difference between two runs, compared bit for bit.

    Returns:
        the step, counted from 1, the variable, its values in both runs; None if there is no difference.
    """
    for step, (a, b) in enumerate(zip(one, other, strict=True), start=1):
        for name, values in a.items():
            for value, second in zip(values, b[name], strict=True):
                if _bits(value) != _bits(second):
                    return step, name, value, second
    return None


def _bits(value: Value) -> object:
    return struct.pack("<d", value) if isinstance(value, float) else value
