"""The Jacobian of an FMU's continuous unknowns with respect to its knowns, from differences in Model Exchange.

FMI 2.0.4, section 2.1.9, and FMI 3.0.1, section 2.2.11: in Continuous-Time Mode the unknowns are the outputs and the
states' derivatives, the knowns are the inputs and the states.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from fmpy.fmi1 import FMICallException
from numpy.typing import NDArray

from platoon_fmu.checks.trial import REAL, continuous_inputs, experiment, limit
from platoon_fmu.errors import FmuError
from platoon_fmu.importer import Instance, OpenFmu

Array = NDArray[np.float64]

# Difference steps, relative to a known's scale: small for derivatives, larger to detect any dependency.
_STEP = 1e-5
_REACTION_STEP = 1e-2
# Allowed deviation from differences: relative to the derivative, to its unknown's largest one, to rounding.
_RELATIVE = 1e-4
_OF_LARGEST = 1e-8
_ROUNDINGS = 1000
# Largest change of a difference when the step is doubled, for it to be usable.
_UNRESOLVED = 0.1
# Smallest relative change that counts as a reaction: above the tolerance of an FMU's internal iterations.
_LEAST_REACTION = 1e-7
_EPS = float(np.finfo(float).eps)


@dataclass(frozen=True)
class Elements:
    """A flat list of variables, arrays with all their elements.

    Attributes:
        names: of the variables.
        labels: name of each element, with its index in an array.
        scale: of each element: its typical change.
    """

    names: tuple[str, ...]
    labels: tuple[str, ...]
    scale: Array

    def __len__(self) -> int:
        """The number of elements."""
        return len(self.labels)


def unknowns(fmu: OpenFmu) -> tuple[Any, ...]:
    """The entries of ModelStructure for the continuous outputs and the derivatives, no variable twice."""
    entries = [*fmu.description.outputs, *fmu.description.derivatives]
    real = [e for e in entries if e.variable.type in REAL and e.variable.variability == "continuous"]
    return tuple({e.variable.name: e for e in real}.values())


def states(fmu: OpenFmu) -> tuple[Any, ...]:
    """The continuous states in the order of the state vector."""
    return tuple(unknown.variable.derivative for unknown in fmu.description.derivatives)


def elements(variables: Sequence[Any]) -> Elements:
    """Variables as elements."""
    labels: list[str] = []
    scale: list[float] = []
    for variable in variables:
        places = list(itertools.product(*(range(1, n + 1) for n in variable.shape or ())))
        labels += [variable.name + (f"[{','.join(map(str, place))}]" if place else "") for place in places]
        scale += [abs(limit(variable, "nominal") or 0.0)] * len(places)
    return Elements(tuple(v.name for v in variables), tuple(labels), np.array(scale))


@dataclass
class Point:
    """A Model Exchange instance at a point of its states and inputs.

    Attributes:
        where: description of the point, for messages.
        instance: the instance.
        inputs: the continuous inputs.
        states: the continuous states.
        unknowns: the elements that depend on them.
        x: the point: inputs, then states.
        scale: typical change of each element of x.
    """

    where: str
    instance: Instance
    inputs: Elements
    states: Elements
    unknowns: Elements
    x: Array
    scale: Array = field(init=False)

    def __post_init__(self) -> None:
        """Sets the scales: the nominal value if there is one, otherwise the magnitude of the value."""
        nominal = np.concatenate([self.inputs.scale, self.states.scale])
        size = np.where(self.x != 0.0, np.abs(self.x), 1.0)
        self.scale = np.where(nominal > 0.0, np.maximum(nominal, np.abs(self.x)), size)

    @property
    def knowns(self) -> tuple[str, ...]:
        """The names of the known variables: inputs, then states."""
        return (*self.inputs.names, *self.states.names)

    @property
    def labels(self) -> tuple[str, ...]:
        """The names of the known elements: inputs, then states."""
        return (*self.inputs.labels, *self.states.labels)

    def at(self, x: Array) -> Array:
        """The unknowns with other knowns, which the instance keeps."""
        self.instance.set(self.input_values(x))
        self.instance.set_states(x[len(self.inputs) :])
        return self.instance.get(*self.unknowns.names)

    def input_values(self, x: Array) -> dict[str, list[float]]:
        """The inputs of a vector of knowns, by name."""
        values, place = {}, 0
        for name in self.inputs.names:
            size = self.instance.size(name)
            values[name] = x[place : place + size].tolist()
            place += size
        return values

    def along(self, j: int, h: float) -> Array:
        """The unknowns with the known j moved by h."""
        x = self.x.copy()
        x[j] += h
        return self.at(x)


def start_point(instance: Instance) -> Point:
    """The start point of an instance; inputs at a limit are moved off it by the difference step."""
    fmu = instance.fmu
    times = experiment(fmu)
    instance.start(time=times.start, tolerance=times.tolerance)
    inputs, state_variables = continuous_inputs(fmu), states(fmu)
    values = instance.get(*(v.name for v in inputs))
    return Point(
        "at its start values",
        instance,
        elements(inputs),
        elements(state_variables),
        elements([e.variable for e in unknowns(fmu)]),
        np.concatenate([_within(inputs, values), instance.states()]),
    )


def moved_point(instance: Instance) -> Point | None:
    """A point a tenth of nominal values away from the start; None if the model has no finite values there."""
    start = start_point(instance)
    signs = np.where(np.arange(len(start.x)) % 3 == 1, -1.0, 1.0)
    x = start.x + 0.1 * signs * start.scale
    variables = [*continuous_inputs(instance.fmu), *states(instance.fmu)]
    point = Point(
        "a tenth of nominal values away from its start values",
        instance,
        start.inputs,
        start.states,
        start.unknowns,
        _within(variables, x),
    )
    try:
        return point if np.isfinite(point.at(point.x)).all() else None
    except (FMICallException, FmuError):
        return None


def _within(variables: Sequence[Any], values: Array) -> Array:
    """Values moved inside their limits so that two-sided differences are possible."""
    found, place = values.copy(), 0
    for variable in variables:
        size = math.prod(variable.shape or ())
        least, most = limit(variable, "min"), limit(variable, "max")
        margin = 2 * _STEP * max(abs(limit(variable, "nominal") or 1.0), abs(least or 0.0), abs(most or 0.0))
        part = found[place : place + size]
        if least is not None:
            part[:] = np.maximum(part, least + margin)
        if most is not None:
            part[:] = np.minimum(part, most - margin)
        place += size
    return found


@dataclass(frozen=True)
class Differences:
    """Derivatives by differences.

    Attributes:
        J: central differences, (unknowns, knowns).
        low: lower bounds of the derivatives, (unknowns, knowns); minus infinity where differences are unusable.
        high: upper bounds of the derivatives, (unknowns, knowns); infinity where differences are unusable.
    """

    J: Array
    low: Array
    high: Array


def differences(point: Point) -> Differences:
    """The Jacobian at a point, with the bounds that differences give.

    A derivative must lie between the one-sided differences, which differ at a kink. If another step gives another
    derivative, the differences do not resolve the function.
    """
    here = point.at(point.x)
    of_knowns = [_column(point, here, j) for j in range(len(point.x))]
    parts = (np.array([c[i] for c in of_knowns]).reshape(-1, len(here)).T for i in range(5))
    J, wide, low, high, noise = parts
    largest = np.max(np.abs(J) * point.scale, axis=1, initial=0.0)[:, np.newaxis]
    slack = _RELATIVE * np.abs(J) + _OF_LARGEST * largest / point.scale + noise
    # Three times the error estimated from the two steps.
    error = np.abs(J - wide)
    unresolved = error > _UNRESOLVED * np.abs(J) + slack
    slack += error
    return Differences(J, np.where(unresolved, -np.inf, low - slack), np.where(unresolved, np.inf, high + slack))


def _column(point: Point, here: Array, j: int) -> tuple[Array, Array, Array, Array, Array]:
    h = _STEP * point.scale[j]
    forward, backward = point.along(j, h), point.along(j, -h)
    wide = (point.along(j, 2 * h) - point.along(j, -2 * h)) / (4 * h)
    central = (forward - backward) / (2 * h)
    sides = np.array([(forward - here) / h, (here - backward) / h])
    noise = _ROUNDINGS * _EPS * np.maximum(np.abs(forward), np.abs(backward)) / h
    return central, wide, sides.min(axis=0), sides.max(axis=0), noise


@dataclass(frozen=True)
class Reaction:
    """An unknown's change with a known.

    Attributes:
        unknown: its label.
        known: its label.
        of: the known's value at the point and moved.
        to: the unknown's value at the point and with the known moved.
    """

    unknown: str
    known: str
    of: tuple[float, float]
    to: tuple[float, float]


def undeclared_reactions(point: Point) -> list[Reaction]:
    """The reactions of unknowns to knowns that ModelStructure does not declare as their dependencies."""
    fmu = point.instance.fmu
    here = point.at(point.x)
    after = np.array([point.along(j, _REACTION_STEP * s) for j, s in enumerate(point.scale)]).reshape(-1, len(here)).T
    change = np.abs(after - here[:, np.newaxis])
    least = _LEAST_REACTION * np.maximum(np.abs(here), np.max(change, axis=1, initial=0.0))
    found = []
    references = point.instance.references(_names_of_elements(point))
    for i, (unknown, declared) in enumerate(_declared(fmu)):
        for j, (known, reference) in enumerate(zip(point.labels, references, strict=True)):
            if declared is not None and reference not in declared and change[i, j] > least[i]:
                of = (float(point.x[j]), float(point.x[j] + _REACTION_STEP * point.scale[j]))
                found.append(Reaction(unknown, known, of, (float(here[i]), float(after[i, j]))))
    return found


def _declared(fmu: OpenFmu) -> list[tuple[str, set[int] | None]]:
    """For each unknown element, the references of its declared dependencies; None if it may depend on all."""
    rows = []
    for entry in unknowns(fmu):
        references = None if entry.dependencies is None else {v.valueReference for v in entry.dependencies}
        rows += [(label, references) for label in elements([entry.variable]).labels]
    return rows


def _names_of_elements(point: Point) -> list[str]:
    return [name for name in point.knowns for _ in range(point.instance.size(name))]


def declares_dependencies(fmu: OpenFmu) -> bool:
    """Whether ModelStructure restricts the dependencies of any unknown."""
    return any(entry.dependencies is not None for entry in unknowns(fmu))
