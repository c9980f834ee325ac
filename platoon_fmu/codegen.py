"""The model's C: CasADi's functions for the equations, and their table for the core (fmi/model.h)."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Sequence
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
    """

    x: Any
    u: Any
    p: Any
    derivatives: Any
    outputs: Any
    initial: Any


def _symbols(name: str, variables: Sequence[Variable]) -> tuple[Any, dict[str, Any]]:
    vector = ca.SX.sym(name, len(variables))
    return vector, {variable.name: vector[i] for i, variable in enumerate(variables)}


def _in_order(expressions: dict[str, Any], variables: Sequence[Variable]) -> Any:
    names = [variable.name for variable in variables]
    if set(names) != set(expressions):
        raise ValueError(f"interface and model differ in {sorted(set(names) ^ set(expressions))}")
    return ca.vertcat(*[expressions[name] for name in names])


def symbolic_model() -> SymbolicModel:
    """The vehicle's equations with every input and parameter a symbol.

    Raises:
        ValueError: where `vehicle` and `interface` do not name the same quantities.
    """
    x, states = _symbols("x", interface.STATES)
    u, inputs = _symbols("u", interface.INPUTS)
    p, parameters = _symbols("p", (*interface.PARAMETERS, *interface.STARTS))
    # mu_a is no parameter of the FMU: the model must not use it, and no symbol would come up if it did.
    P = VehicleParameters(**{f.name: parameters.get(f.name, ca.SX.nan()) for f in fields(VehicleParameters)})
    derivatives, outputs = vehicle.equations(states, inputs, P)
    return SymbolicModel(
        x=x,
        u=u,
        p=p,
        derivatives=_in_order(derivatives, interface.STATES),
        outputs=_in_order(outputs, interface.OUTPUTS),
        initial=_in_order(vehicle.initial_state(parameters, P), interface.STATES),
    )


def _names(variables: Sequence[Variable]) -> list[str]:
    return [variable.name for variable in variables]


def _dependencies(unknowns: list[str], expressions: Any, knowns: list[str], symbols: Any) -> dict[str, tuple[str, ...]]:
    """For each unknown the knowns that its expression contains."""
    found: dict[str, list[str]] = {unknown: [] for unknown in unknowns}
    for row, column in zip(*ca.jacobian_sparsity(expressions, symbols).get_triplet(), strict=True):
        found[unknowns[row]].append(knowns[column])
    return {unknown: tuple(names) for unknown, names in found.items()}


def dependencies(model: SymbolicModel) -> tuple[dict[str, tuple[str, ...]], dict[str, tuple[str, ...]]]:
    """What every state, derivative and output depends on, by name: while simulating, and while initializing.

    While simulating the knowns are states and inputs; while initializing, inputs and parameters.
    """
    unknowns = _names((*interface.STATES, *interface.DERIVATIVES, *interface.OUTPUTS))
    states, inputs = _names(interface.STATES), _names(interface.INPUTS)
    parameters = _names((*interface.PARAMETERS, *interface.STARTS))
    values = ca.vertcat(model.x, model.derivatives, model.outputs)
    simulating = _dependencies(unknowns, values, states + inputs, ca.vertcat(model.x, model.u))
    at_start = ca.substitute(values, model.x, model.initial)
    initial = _dependencies(unknowns, at_start, inputs + parameters, ca.vertcat(model.u, model.p))
    return simulating, initial


def equations_c(model: SymbolicModel) -> str:
    """C source of vehicle_derivatives, vehicle_outputs and vehicle_initial, in CasADi's calling form."""
    functions = [
        ca.Function("vehicle_derivatives", [model.x, model.u, model.p], [model.derivatives]),
        ca.Function("vehicle_outputs", [model.x, model.u, model.p], [model.outputs]),
        ca.Function("vehicle_initial", [model.p], [model.initial]),
    ]
    generator = ca.CodeGenerator("equations", {"casadi_int": "int"})
    for function in functions:
        generator.add(function)
    # Nothing but the FMI functions may leave the binary.
    return "#define CASADI_SYMBOL_EXPORT\n" + str(generator.dump())


def _array(name: str, values: Iterable[float]) -> str:
    numbers = ", ".join(repr(float(v)) for v in values)
    numbers = textwrap.fill(numbers, 100, initial_indent="    ", subsequent_indent="    ")
    return f"static const double {name}[] = {{\n{numbers}\n}};\n"


_TABLE = """\
/* The vehicle as the core's model: sizes, start values and the functions of equations.c. */
#include "model.h"

int vehicle_derivatives(const double **arg, double **res, int *iw, double *w, int mem);
int vehicle_outputs(const double **arg, double **res, int *iw, double *w, int mem);
int vehicle_initial(const double **arg, double **res, int *iw, double *w, int mem);

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

{arrays}
const Model platoon_model = {{
    .token = "{token}",
    .n_states = {n_states},
    .n_outputs = {n_outputs},
    .n_inputs = {n_inputs},
    .n_parameters = {n_parameters},
    .n_tunable = {n_tunable},
    .nominals = nominals,
    .inputs_start = inputs_start,
    .parameters_start = parameters_start,
    .solver_step = {solver_step!r},
    .initial = initial,
    .derivatives = derivatives,
    .outputs = outputs,
}};
"""


def table_c(token: str, solver_step: float) -> str:
    """C source of `platoon_model`.

    Args:
        token: the guid that ties binary and modelDescription together.
        solver_step: longest inner step of the co-simulation [s].
    """
    parameters = (*interface.PARAMETERS, *interface.STARTS)
    arrays = [
        _array("nominals", (v.nominal or 1.0 for v in interface.STATES)),
        _array("inputs_start", (v.start or 0.0 for v in interface.INPUTS)),
        _array("parameters_start", (v.start or 0.0 for v in parameters)),
    ]
    return _TABLE.format(
        arrays="\n".join(arrays),
        token=token,
        n_states=len(interface.STATES),
        n_outputs=len(interface.OUTPUTS),
        n_inputs=len(interface.INPUTS),
        n_parameters=len(parameters),
        n_tunable=len(interface.PARAMETERS),
        solver_step=solver_step,
    )
