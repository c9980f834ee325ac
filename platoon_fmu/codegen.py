"""The model's C: CasADi's functions for the equations, and their table for the core (fmi/model.h)."""

from __future__ import annotations

import sys
import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import casadi as ca

from platoon_fmu import interface, vehicle
from platoon_fmu.interface import Variable
from platoon_fmu.parameters import VehicleParameters


@dataclass(frozen=True)
class SymbolicModel:
    """The equations as expressions, in the order of `interface`.

    Attributes:
        x, u, p: symbols of states, inputs and parameters (tunable, then start values).
        derivatives, outputs: expressions in x, u, p.
        initial: the states at the start, expressions in p.
        fastest: upper bound of the decay rates [1/s], an expression in p.
        running: Jacobian of states, derivatives and outputs with respect to states and inputs, in x, u, p.
        beginning: the same with respect to inputs and parameters, at the initial states, in u, p.
    """

    x: Any
    u: Any
    p: Any
    derivatives: Any
    outputs: Any
    initial: Any
    fastest: Any
    running: Any
    beginning: Any


def _symbols(name: str, variables: Sequence[Variable]) -> tuple[Any, dict[str, Any]]:
    vector = ca.SX.sym(name, len(variables))
    return vector, {variable.name: vector[i] for i, variable in enumerate(variables)}


def _in_order(expressions: dict[str, Any], variables: Sequence[Variable]) -> Any:
    names = [variable.name for variable in variables]
    if set(names) != set(expressions):
        raise ValueError(f"interface and model differ in {sorted(set(names) ^ set(expressions))}")
    return ca.vertcat(*[expressions[name] for name in names])


def symbolic_model() -> SymbolicModel:
    """The vehicle's equations with a symbol for every input and parameter.

    Raises:
        ValueError: `vehicle` and `interface` do not name the same quantities.
    """
    x, states = _symbols("x", interface.STATES)
    u, inputs = _symbols("u", interface.INPUTS)
    p, parameters = _symbols("p", (*interface.PARAMETERS, *interface.STARTS))
    # mu_a is not a parameter of the FMU, so the model must not use it.
    P = VehicleParameters(**{f.name: parameters.get(f.name, ca.SX.nan()) for f in fields(VehicleParameters)})
    equations = vehicle.equations(states, inputs, P)
    derivatives = _in_order(equations[0], interface.STATES)
    outputs = _in_order(equations[1], interface.OUTPUTS)
    initial = _in_order(vehicle.initial_state(parameters, P), interface.STATES)
    unknowns = ca.vertcat(x, derivatives, outputs)
    return SymbolicModel(
        x=x,
        u=u,
        p=p,
        derivatives=derivatives,
        outputs=outputs,
        initial=initial,
        fastest=vehicle.fastest_rate(P),
        running=ca.jacobian(unknowns, ca.vertcat(x, u)),
        beginning=ca.jacobian(ca.substitute(unknowns, x, initial), ca.vertcat(u, p)),
    )


def _names(variables: Sequence[Variable]) -> list[str]:
    return [variable.name for variable in variables]


def _dependencies(unknowns: list[str], knowns: list[str], jacobian: Any) -> dict[str, tuple[str, ...]]:
    """For each unknown the knowns that its expression contains."""
    found: dict[str, list[str]] = {unknown: [] for unknown in unknowns}
    for row, column in zip(*jacobian.sparsity().get_triplet(), strict=True):
        found[unknowns[row]].append(knowns[column])
    return {unknown: tuple(names) for unknown, names in found.items()}


def dependencies(model: SymbolicModel) -> tuple[dict[str, tuple[str, ...]], dict[str, tuple[str, ...]]]:
    """The dependencies of every state, derivative and output, by name: during simulation and during initialization.

    During simulation the knowns are states and inputs; during initialization, inputs and parameters.
    """
    unknowns = _names((*interface.STATES, *interface.DERIVATIVES, *interface.OUTPUTS))
    states, inputs = _names(interface.STATES), _names(interface.INPUTS)
    parameters = _names((*interface.PARAMETERS, *interface.STARTS))
    simulating = _dependencies(unknowns, states + inputs, model.running)
    return simulating, _dependencies(unknowns, inputs + parameters, model.beginning)


def equations_c(model: SymbolicModel) -> str:
    """C source of the functions that `table_c` calls, in CasADi's calling form."""
    functions = [
        ca.Function("vehicle_derivatives", [model.x, model.u, model.p], [model.derivatives]),
        ca.Function("vehicle_outputs", [model.x, model.u, model.p], [model.outputs]),
        ca.Function("vehicle_initial", [model.p], [model.initial]),
        ca.Function("vehicle_fastest", [model.p], [model.fastest]),
        ca.Function("vehicle_running", [model.x, model.u, model.p], [model.running]),
        ca.Function("vehicle_beginning", [model.u, model.p], [model.beginning]),
    ]
    generator = ca.CodeGenerator("equations", {"casadi_int": "int"})
    for function in functions:
        generator.add(function)
    # The binary must export only the FMI functions.
    return "#define CASADI_SYMBOL_EXPORT\n" + str(generator.dump())


_LARGEST = sys.float_info.max


def _array(kind: str, name: str, values: Iterable[float]) -> str:
    numbers = ", ".join(repr(float(v) if kind == "double" else int(v)) for v in values)
    numbers = textwrap.fill(numbers, 100, initial_indent="    ", subsequent_indent="    ")
    return f"static const {kind} {name}[] = {{\n{numbers}\n}};\n"


def _struct(numbers: Mapping[str, float | None]) -> str:
    """The initialiser of a struct of doubles."""
    return "{" + ", ".join(f".{name} = {float(number or 0.0)!r}" for name, number in numbers.items()) + "}"


def _pattern(name: str, jacobian: Any) -> list[str]:
    """A Jacobian's sparsity, column by column, as CasADi orders the nonzeros."""
    sparsity = jacobian.sparsity()
    return [_array("int", f"{name}_starts", sparsity.colind()), _array("int", f"{name}_rows", sparsity.row())]


_TABLE = """\
/* The vehicle as the core's model: sizes, start values and the functions of equations.c. */
#include "model.h"

int vehicle_derivatives(const double **arg, double **res, int *iw, double *w, int mem);
int vehicle_outputs(const double **arg, double **res, int *iw, double *w, int mem);
int vehicle_initial(const double **arg, double **res, int *iw, double *w, int mem);
int vehicle_fastest(const double **arg, double **res, int *iw, double *w, int mem);
int vehicle_running(const double **arg, double **res, int *iw, double *w, int mem);
int vehicle_beginning(const double **arg, double **res, int *iw, double *w, int mem);

static void initial(const double *p, double *x) {{
    const double *arg[] = {{p}};
    double *res[] = {{x}};
    vehicle_initial(arg, res, 0, 0, 0);
}}

static void derivatives(const double *x, const double *u, const double *p, double *dx) {{
    const double *arg[] = {{x, u, p}};
    double *res[] = {{dx}};
    vehicle_derivatives(arg, res, 0, 0, 0);
}}

static void outputs(const double *x, const double *u, const double *p, double *y) {{
    const double *arg[] = {{x, u, p}};
    double *res[] = {{y}};
    vehicle_outputs(arg, res, 0, 0, 0);
}}

static void fastest(const double *p, double *rate) {{
    const double *arg[] = {{p}};
    double *res[] = {{rate}};
    vehicle_fastest(arg, res, 0, 0, 0);
}}

static void running(const double *x, const double *u, const double *p, double *nonzeros) {{
    const double *arg[] = {{x, u, p}};
    double *res[] = {{nonzeros}};
    vehicle_running(arg, res, 0, 0, 0);
}}

static void beginning(const double *x, const double *u, const double *p, double *nonzeros) {{
    const double *arg[] = {{u, p}};
    double *res[] = {{nonzeros}};
    (void)x;
    vehicle_beginning(arg, res, 0, 0, 0);
}}

{arrays}
const Model platoon_model = {{
    .token = "{token}",
    .n_states = {n_states},
    .n_outputs = {n_outputs},
    .n_inputs = {n_inputs},
    .n_parameters = {n_parameters},
    .n_tunable = {n_tunable},
    .most_nonzeros = {most_nonzeros},
    .nominals = nominals,
    .inputs_start = inputs_start,
    .parameters_start = parameters_start,
    .parameters_minimum = parameters_minimum,
    .parameters_maximum = parameters_maximum,
    .settings_start = {settings_start},
    .settings_minimum = {settings_minimum},
    .settings_maximum = {settings_maximum},
    .initial = initial,
    .derivatives = derivatives,
    .outputs = outputs,
    .fastest = fastest,
    .running = {{running_starts, running_rows, running}},
    .beginning = {{beginning_starts, beginning_rows, beginning}},
}};
"""


def table_c(model: SymbolicModel, token: str) -> str:
    """C source of `platoon_model`.

    Args:
        model: the equations.
        token: the GUID that binary and modelDescription share.
    """
    parameters = (*interface.PARAMETERS, *interface.STARTS)
    settings = (*interface.SOLVER_SETTINGS, interface.SOLVER)
    arrays = [
        _array("double", "nominals", (v.nominal or 1.0 for v in interface.STATES)),
        _array("double", "inputs_start", (v.start or 0.0 for v in interface.INPUTS)),
        _array("double", "parameters_start", (v.start or 0.0 for v in parameters)),
        _array("double", "parameters_minimum", (-_LARGEST if v.minimum is None else v.minimum for v in parameters)),
        _array("double", "parameters_maximum", (_LARGEST if v.maximum is None else v.maximum for v in parameters)),
        *_pattern("running", model.running),
        *_pattern("beginning", model.beginning),
    ]
    return _TABLE.format(
        arrays="\n".join(arrays),
        token=token,
        n_states=len(interface.STATES),
        n_outputs=len(interface.OUTPUTS),
        n_inputs=len(interface.INPUTS),
        n_parameters=len(parameters),
        n_tunable=len(interface.PARAMETERS),
        most_nonzeros=max(model.running.nnz(), model.beginning.nnz()),
        settings_start=_struct({v.name: v.start for v in settings}),
        settings_minimum=_struct({v.name: v.minimum for v in settings}),
        settings_maximum=_struct({v.name: v.maximum for v in settings}),
    )
