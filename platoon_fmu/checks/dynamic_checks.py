"""The checks that call an FMU's functions: they exercise what its capability flags claim.

Each check is a function of a `Subject`; `CHECKS` lists them. Call it in a separate process (`isolation`), because the
binary is not trusted.
"""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from platoon_fmu.archive import one_line
from platoon_fmu.checks.findings import Finding, Outcome, passed, problem, skipped
from platoon_fmu.checks.isolation import cause_of_death
from platoon_fmu.checks.jacobian import (
    Differences,
    Point,
    declares_dependencies,
    differences,
    elements,
    moved_point,
    start_point,
    states,
    undeclared_reactions,
    unknowns,
)
from platoon_fmu.checks.trial import (
    STEPS,
    Snapshot,
    continuous_inputs,
    experiment,
    first_difference,
    moved_start,
    observed,
    run,
    start_values,
)
from platoon_fmu.errors import FmuError
from platoon_fmu.importer import Instance, Kind, OpenFmu, Value
from platoon_fmu.interpreter import python

Array = NDArray[np.float64]

#: Allowed difference of Model Exchange and Co-Simulation, relative to a variable's range in the run and to its size.
TOLERANCE_OF_RANGE = 0.05
TOLERANCE_OF_SIZE = 1e-6

#: Largest number of inputs and states that are varied one by one; more would exceed a check's time limit.
MOST_KNOWNS = 1000

_FIRST_STEPS = 3


@dataclass
class Subject:
    """One kind of an FMU under check.

    Attributes:
        fmu: the FMU.
        kind: its interface type.
        timeout_s: time limit of a process started by a check [s].
        instances: all created instances, freed together.
    """

    fmu: OpenFmu
    kind: Kind
    timeout_s: float
    instances: list[Instance] = field(default_factory=list)

    @property
    def only_once(self) -> bool:
        """Whether a process may create only one instance."""
        return any(self.fmu.claims(kind, "canBeInstantiatedOnlyOncePerProcess") for kind in self.fmu.kinds)

    @property
    def h(self) -> float:
        """The step of a run [s]."""
        return experiment(self.fmu).step

    @property
    def names(self) -> tuple[str, ...]:
        """The variables that are compared."""
        return observed(self.fmu, self.kind)

    def instance(self, kind: Kind | None = None) -> Instance:
        """A new instance."""
        self.instances.append(Instance(self.fmu, kind or self.kind, f"instance{len(self.instances)}"))
        return self.instances[-1]

    def started(self, values: Mapping[str, list[float]] | None = None, kind: Kind | None = None) -> Instance:
        """A new, started instance, with other start values if given."""
        return self.start(self.instance(kind), values)

    def start(self, instance: Instance, values: Mapping[str, list[float]] | None = None) -> Instance:
        """Starts an instance according to the FMU's DefaultExperiment."""
        times = experiment(self.fmu)
        return instance.start(values, time=times.start, tolerance=times.tolerance)

    def run(self, instance: Instance, steps: int = STEPS) -> list[Snapshot]:
        """Advances by some steps; the values after each."""
        return run(instance, self.names, self.h, steps)

    def free(self) -> None:
        """Frees all instances."""
        for instance in self.instances:
            instance.free()
        self.instances.clear()


@dataclass(frozen=True)
class DynamicCheck:
    """A check of one kind.

    Attributes:
        name: what it checks.
        find: runs the check.
        why_not: why it is skipped for an FMU's kind; empty if it is run.
        concerns: whether it applies to an FMU's kind; if not, it is not listed.
    """

    name: str
    find: Callable[[Subject], Finding]
    why_not: Callable[[Subject], str] = lambda _: ""
    concerns: Callable[[Subject], bool] = lambda _: True

    def __call__(self, subject: Subject) -> Finding:
        """Runs the check; any error of the FMU becomes its finding."""
        try:
            finding = self.find(subject)
            subject.free()
        except Exception as error:  # noqa: BLE001 - see above
            reached = f", at t = {subject.instances[-1].time:g} s" if subject.instances else ""
            said = [line for instance in subject.instances for line in instance.complaints]
            words = f"; the FMU says: {said[-1]}" if said else ""
            return problem(one_line(f"{str(error).rstrip('.') or repr(error)}{reached}{words}"))
        return finding


# ---- a short run ----


def short_run(subject: Subject) -> Finding:
    """A run of some steps succeeds and gives finite values."""
    instance = subject.started()
    snapshots = [instance.read(*subject.names), *subject.run(instance)]
    instance.terminate()
    for i, snapshot in enumerate(snapshots):
        wrong = [name for name, values in snapshot.items() if not _finite(values)]
        if wrong:
            time = experiment(subject.fmu).start + i * subject.h
            bad = next(v for v in snapshot[wrong[0]] if not _finite([v]))
            return problem(f"{wrong[0]} is {bad} at t = {time:g} s{_more(len(wrong) - 1, 'variable')}")
    warned = f"; it warns: {instance.complaints[0]}" if instance.complaints else ""
    return passed(one_line(f"{_steps(subject)}, {_count(len(subject.names), 'variable')} finite{warned}"))


def _finite(values: Iterable[Value]) -> bool:
    return all(not isinstance(value, float) or np.isfinite(value) for value in values)


def _count(n: int, what: str) -> str:
    return f"{n} {what}" if n == 1 else f"{n} {what[:-1]}ies" if what.endswith("y") else f"{n} {what}s"


def _more(n: int, what: str) -> str:
    return f" (and {_count(n, f'more {what}')})" if n else ""


def _steps(subject: Subject) -> str:
    return f"{STEPS} steps of {subject.h:g} s"


# ---- runs that must be bit-identical ----


def _same(expected: Sequence[Snapshot], found: Sequence[Snapshot], *, after: str, what: str, fine: str) -> Finding:
    different = first_difference(expected, found)
    if different is None:
        return passed(fine)
    step, name, one, other = different
    return problem(f"{name} is {other!r} {_count(step, 'step')} after {after}, but {one!r} {what}")


def _disturb(subject: Subject, instance: Instance, inputs: Mapping[str, list[float]]) -> None:
    """Drives an instance to another state: other inputs, and steps."""
    instance.set(inputs)
    subject.run(instance, _FIRST_STEPS)


def _own_inputs(fmu: OpenFmu) -> dict[str, list[float]]:
    return {v.name: start_values(v) or [] for v in continuous_inputs(fmu) if start_values(v)}


def _moved_inputs(fmu: OpenFmu) -> dict[str, list[float]]:
    return {name: values for name, values in moved_start(fmu).items() if name in _own_inputs(fmu)}


def _under_way(subject: Subject) -> Instance:
    """An instance whose state and inputs differ from every start."""
    instance = subject.started(moved_start(subject.fmu))
    subject.run(instance, _FIRST_STEPS)
    return instance


def state_restored(subject: Subject) -> Finding:
    """A continuation from a restored state is bit-identical to the first continuation."""
    instance = _under_way(subject)
    before, state, time = instance.read(*subject.names), instance.save(), instance.time
    expected = subject.run(instance)
    _disturb(subject, instance, _own_inputs(subject.fmu))
    instance.restore(state, time)
    back = first_difference([before], [instance.read(*subject.names)])
    if back is not None:
        _, name, was, now = back
        return problem(f"{name} is {now!r} after the state was restored, but was {was!r} when it was saved")
    found = subject.run(instance)
    instance.discard(state)
    return _same(
        expected,
        found,
        after="the state was restored",
        what="in the first continuation",
        fine=f"{_steps(subject)} after restoring are bit-identical ({_count(len(subject.names), 'variable')})",
    )


def state_in_another_process(subject: Subject) -> Finding:
    """The continuation from a serialised state in another process is bit-identical."""
    instance = _under_way(subject)
    content = instance.serialise()
    header = {"folder": str(subject.fmu.folder), "kind": subject.kind, "time": instance.time}
    expected = subject.run(instance)
    # It terminates itself on timeout.
    with python(
        "platoon_fmu.checks.resumed",
        json.dumps(header),
        str(subject.timeout_s),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as process:
        output, errors = process.communicate(content)
    answer = _answer(process.returncode, output, errors)
    found = [{name: tuple(values) for name, values in snapshot.items()} for snapshot in answer]
    return _same(
        expected,
        found,
        after="the state was restored in another process",
        what="in this one",
        fine=f"{_steps(subject)} in another process are bit-identical (state size {_count(len(content), 'byte')})",
    )


def _answer(code: int, output: bytes, errors: bytes) -> Any:
    """The values computed by the other process.

    Raises:
        FmuError: it crashed, or the FMU refused.
    """
    if code:
        raise FmuError(f"the process that restored the state {cause_of_death(code, errors)}")
    return json.loads(output)


def interleaved(subject: Subject) -> Finding:
    """Two instances with different starts, stepped alternately, are bit-identical to each run alone."""
    starts: list[dict[str, list[float]]] = [{}, moved_start(subject.fmu)]
    alone = []
    for values in starts:
        instance = subject.started(values)
        alone.append(subject.run(instance))
        subject.free()
    pair = [subject.started(values) for values in starts]
    together: list[list[Snapshot]] = [[], []]
    for _ in range(STEPS):
        for instance, snapshots in zip(pair, together, strict=True):
            snapshots += subject.run(instance, 1)
    for one, other in zip(alone, together, strict=True):
        finding = _same(
            one,
            other,
            after="the start in turns with another instance",
            what="alone",
            fine=f"{_steps(subject)} of two alternating instances are bit-identical to each run alone",
        )
        if finding.outcome is Outcome.PROBLEM:
            return finding
    return finding


def reset(subject: Subject) -> Finding:
    """After a reset and the same start, a run is bit-identical to that of a new instance."""
    instance = subject.started()
    expected = subject.run(instance)
    _disturb(subject, instance, _moved_inputs(subject.fmu))
    instance.reset()
    subject.start(instance)
    return _same(
        expected,
        subject.run(instance),
        after="a reset and a new start",
        what="when new",
        fine=f"{_steps(subject)} after a reset are bit-identical",
    )


# ---- derivatives and dependencies ----


@dataclass(frozen=True)
class _Place:
    """An operating point at which an instance's derivatives are compared with differences.

    Attributes:
        point: where the differences are taken.
        instance: the instance at this point that provides the derivatives.
        unknowns: names of the point's first unknowns.
        knowns: names of the point's first knowns.
    """

    point: Point
    instance: Instance
    unknowns: tuple[str, ...]
    knowns: tuple[str, ...]


def _points(subject: Subject) -> Iterator[Point]:
    """Yield the operating points; a second point needs a second instance."""
    yield start_point(subject.instance(Kind.MODEL_EXCHANGE))
    if not subject.only_once:
        point = moved_point(subject.instance(Kind.MODEL_EXCHANGE))
        if point is not None:
            yield point


def _places(subject: Subject) -> Iterator[_Place]:
    """In Co-Simulation, where states cannot be set: outputs with respect to inputs at the start."""
    if subject.kind is Kind.MODEL_EXCHANGE:
        for point in _points(subject):
            yield _Place(point, point.instance, point.unknowns.names, point.knowns)
        return
    point = start_point(subject.instance(Kind.MODEL_EXCHANGE))
    slave = subject.started()
    slave.set(point.input_values(point.x))
    outputs = [e.variable.name for e in unknowns(subject.fmu) if e.variable.causality == "output"]
    yield _Place(point, slave, tuple(outputs), point.inputs.names)


def directional_derivatives(subject: Subject) -> Finding:
    """The FMU's directional derivatives agree with differences."""
    return _derivatives(subject, adjoint=False)


def adjoint_derivatives(subject: Subject) -> Finding:
    """The FMU's adjoint derivatives agree with differences."""
    return _derivatives(subject, adjoint=True)


def _derivatives(subject: Subject, *, adjoint: bool) -> Finding:
    where = []
    unresolved = 0
    for place in _places(subject):
        if not place.unknowns or not place.knowns:
            return skipped("there are no continuous unknowns, or no continuous knowns")
        expected = differences(place.point)
        place.point.at(place.point.x)
        wrong = _far_from(place, expected, adjoint=adjoint)
        if wrong:
            return problem(wrong)
        where.append(place.point.where)
        m, n = place.instance.size(*place.unknowns), place.instance.size(*place.knowns)
        unresolved += int(np.isinf(expected.low[:m, :n]).sum())
    count = f"{_count(m, 'unknown')} over {_count(n, 'known')}"
    rest = f" ({_count(unresolved, 'derivative')} not smooth enough to tell)" if unresolved else ""
    return passed(f"{count}, {' and '.join(where)}{rest}")


def _far_from(place: _Place, expected: Differences, *, adjoint: bool) -> str:
    """The derivative with the largest deviation from differences; empty if all agree."""
    m, n = place.instance.size(*place.unknowns), place.instance.size(*place.knowns)
    derivative = place.instance.adjoint_derivative if adjoint else place.instance.directional_derivative

    def product(seed: Array) -> Array:
        return derivative(place.unknowns, place.knowns, seed)

    columns = np.array([product(unit) for unit in np.eye(m if adjoint else n)])
    J = columns if adjoint else columns.T
    low, high = expected.low[:m, :n], expected.high[:m, :n]
    far = ~((low <= J) & (high >= J))
    if not far.any():
        return ""
    excess = np.where(far, np.maximum(low - J, J - high) * place.point.scale[:n], -1.0)
    i, j = np.unravel_index(np.argmax(np.nan_to_num(excess, nan=np.inf)), J.shape)
    return (
        f"d {place.point.unknowns.labels[i]} / d {place.point.labels[j]}: the FMU gives {J[i, j]:.9g}, "
        f"differences give {expected.J[i, j]:.9g}, {place.point.where}{_more(int(far.sum()) - 1, 'derivative')}"
    )


def dependencies(subject: Subject) -> Finding:
    """No unknown depends on a known that is not declared as its dependency."""
    checked = []
    for point in _points(subject):
        reactions = undeclared_reactions(point)
        if reactions:
            r = reactions[0]
            return problem(
                f"{r.unknown} declares no dependency on {r.known}, but changes from {r.to[0]:.9g} to "
                f"{r.to[1]:.9g} when {r.known} changes from {r.of[0]:.9g} to {r.of[1]:.9g}, {point.where}"
                f"{_more(len(reactions) - 1, 'dependency')}"
            )
        checked.append(point.where)
    size = f"{_count(len(point.unknowns), 'unknown')}, {_count(len(point.x), 'known')}"
    return passed(f"no undeclared dependencies: {size}, {' and '.join(checked)}")


# ---- both kinds ----


def as_model_exchange(subject: Subject) -> Finding:
    """Co-Simulation agrees with integrated Model Exchange, with the FMU's start values and with others."""
    names = _compared_variables(subject.fmu)
    if not names:
        return skipped("there are no continuous outputs and no states")
    starts = {"its own start values": {}, "inputs or other start values moved": moved_start(subject.fmu)}
    for where, values in starts.items():
        traces = []
        for kind in (Kind.MODEL_EXCHANGE, Kind.CO_SIMULATION):
            instance = subject.started(values, kind)
            traces.append([instance.read(*names), *run(instance, names, subject.h)])
            if instance.next_event_time is not None:
                return skipped("the FMU has time events, which are only handled at the end of a step")
        finding = _near(subject, names, traces, where)
        if finding.outcome is not Outcome.PASSED:
            return finding
    return finding


def _compared_variables(fmu: OpenFmu) -> tuple[str, ...]:
    outputs = [e.variable.name for e in unknowns(fmu) if e.variable.causality == "output"]
    return tuple(outputs or [e.variable.derivative.name for e in fmu.description.derivatives])


def _near(subject: Subject, names: Sequence[str], traces: Sequence[Sequence[Snapshot]], where: str) -> Finding:
    exchange, simulation = (
        np.array([[element for name in names for element in snapshot[name]] for snapshot in trace]) for trace in traces
    )
    if not (np.isfinite(exchange).all() and np.isfinite(simulation).all()):
        return skipped("not all values are finite; see the short runs")
    variables = {v.name: v for v in subject.fmu.description.modelVariables}
    compared = elements([variables[name] for name in names])
    nominal = np.where(compared.scale > 0.0, compared.scale, 1.0)
    span, size = np.ptp(exchange, axis=0), np.maximum(np.abs(exchange).max(axis=0, initial=0.0), nominal)
    allowed = TOLERANCE_OF_RANGE * span + TOLERANCE_OF_SIZE * size
    apart = np.abs(simulation - exchange)
    tolerance = f"{TOLERANCE_OF_RANGE:g} of its range in the run + {TOLERANCE_OF_SIZE:g} of its size"
    far = apart > allowed
    if far.any():
        step, i = (int(k) for k in np.unravel_index(np.argmax(apart / allowed), far.shape))
        return problem(
            f"{compared.labels[i]} is {simulation[step, i]:.9g} {_count(step, 'step')} after the start, and "
            f"{exchange[step, i]:.9g} in Model Exchange; tolerance {allowed[i]:.3g}, which is {tolerance} ({where})"
            f"{_more(int(far.any(axis=0).sum()) - 1, 'variable')}"
        )
    worst = float((apart / allowed).max(initial=0.0))
    count = _count(len(compared), "variable")
    return passed(f"{_steps(subject)}, {count}; at most {worst:.2g} of the tolerance, {tolerance}")


# ---- the list ----


def _unclaimed(*flags: str) -> Callable[[Subject], str]:
    def why_not(subject: Subject) -> str:
        missing = [flag for flag in flags if not subject.fmu.claims(subject.kind, flag)]
        return f"the FMU does not claim it: {subject.fmu.flag_name(missing[0])} is not set" if missing else ""

    return why_not


def _no_second_instance(subject: Subject) -> str:
    return "canBeInstantiatedOnlyOncePerProcess is set" if subject.only_once else ""


def _no_differences(flag: str) -> Callable[[Subject], str]:
    def why_not(subject: Subject) -> str:
        if subject.kind is Kind.MODEL_EXCHANGE:
            return _unclaimed(flag)(subject) or _too_many(subject)
        why = _unclaimed(flag)(subject)
        if not why and Kind.MODEL_EXCHANGE not in subject.fmu.kinds:
            why = "differences need Model Exchange, which the FMU lacks"
        return why or _no_second_instance(subject) or _too_many(subject)

    return why_not


def _too_many(subject: Subject) -> str:
    count = len(elements([*continuous_inputs(subject.fmu), *states(subject.fmu)]))
    return f"differences over {count} knowns take too long; allowed: {MOST_KNOWNS}" if count > MOST_KNOWNS else ""


def _nothing_declared(subject: Subject) -> str:
    if not declares_dependencies(subject.fmu):
        return "ModelStructure declares no dependencies, so any are allowed"
    return _too_many(subject)


def _cannot_be_compared(subject: Subject) -> str:
    if subject.fmu.description.numberOfEventIndicators:
        return "the FMU has state events, which are not handled here"
    return _no_second_instance(subject)


CHECKS = (
    DynamicCheck("short run", short_run),
    DynamicCheck("reset", reset),
    DynamicCheck("instances in turns", interleaved, _no_second_instance),
    DynamicCheck("state restored", state_restored, _unclaimed("canGetAndSetFMUState")),
    DynamicCheck(
        "state in another process",
        state_in_another_process,
        _unclaimed("canGetAndSetFMUState", "canSerializeFMUState"),
    ),
    DynamicCheck("directional derivatives", directional_derivatives, _no_differences("providesDirectionalDerivatives")),
    DynamicCheck(
        "adjoint derivatives",
        adjoint_derivatives,
        _no_differences("providesAdjointDerivatives"),
        concerns=lambda subject: subject.fmu.version == 3,
    ),
    DynamicCheck(
        "declared dependencies",
        dependencies,
        _nothing_declared,
        concerns=lambda subject: subject.kind is Kind.MODEL_EXCHANGE,
    ),
    DynamicCheck(
        "as Model Exchange",
        as_model_exchange,
        _cannot_be_compared,
        concerns=lambda subject: subject.kind is Kind.CO_SIMULATION and Kind.MODEL_EXCHANGE in subject.fmu.kinds,
    ),
)
