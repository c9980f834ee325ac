"""The FMU's variables, defined only here.

Value references number `VARIABLES` in order: states, their derivatives, the other outputs, inputs, parameters, start
values, and the core's own: time and the solver's settings. The C core relies on that order (fmi/model.h, fmi/core.h),
and the modelDescription follows it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any

from platoon_fmu.parameters import LAMBDA_MAX, LAMBDA_MIN, VehicleParameters
from platoon_fmu.wheels import WHEELS


@dataclass(frozen=True)
class Variable:
    """One scalar variable of the FMU, in FMI's terms; real unless it has items.

    Attributes:
        name: as users write it.
        causality: `output`, `local`, `input`, `parameter` or `independent`.
        variability: `continuous`, `tunable` or `fixed`.
        unit: a name in `UNITS`; empty for an enumeration.
        description: one line, with the frame or the sign where it matters.
        start: start value; None if the FMU calculates it.
        minimum: least sensible value, or None.
        maximum: greatest sensible value, or None.
        nominal: usual magnitude, by which an integrator scales its absolute tolerance.
        derivative_of: for a derivative, the name of its state.
        items: for an enumeration, its items' names and descriptions, numbered from 1.
    """

    name: str
    causality: str
    variability: str
    unit: str
    description: str
    start: float | None = None
    minimum: float | None = None
    maximum: float | None = None
    nominal: float | None = None
    derivative_of: str | None = None
    items: tuple[tuple[str, str], ...] = ()

    @property
    def display_unit(self) -> str | None:
        """The preferred unit for display, if any."""
        return next(iter(UNITS[self.unit].display), None) if self.unit else None


@dataclass(frozen=True)
class Unit:
    """A unit by its exponents of the SI base units and the radian, with its display units.

    Attributes:
        exponents: base unit name to exponent.
        display: display unit name to the factor a value in this unit is multiplied by.
    """

    exponents: dict[str, int]
    display: dict[str, float]


_DEGREES = 57.29577951308232

UNITS = {
    "1": Unit({}, {}),
    "rad": Unit({"rad": 1}, {"deg": _DEGREES}),
    "rad/s": Unit({"rad": 1, "s": -1}, {"deg/s": _DEGREES}),
    "rad/s2": Unit({"rad": 1, "s": -2}, {"deg/s2": _DEGREES}),
    "m": Unit({"m": 1}, {}),
    "m/s": Unit({"m": 1, "s": -1}, {"km/h": 3.6}),
    "m/s2": Unit({"m": 1, "s": -2}, {}),
    "m2": Unit({"m": 2}, {}),
    "s": Unit({"s": 1}, {}),
    "kg": Unit({"kg": 1}, {}),
    "kg/m3": Unit({"kg": 1, "m": -3}, {}),
    "kg.m2": Unit({"kg": 1, "m": 2}, {}),
    "N": Unit({"kg": 1, "m": 1, "s": -2}, {"kN": 1e-3}),
    "N/m": Unit({"kg": 1, "s": -2}, {"kN/m": 1e-3}),
    "N/s": Unit({"kg": 1, "m": 1, "s": -3}, {"kN/s": 1e-3}),
    "N/rad": Unit({"kg": 1, "m": 1, "s": -2, "rad": -1}, {"kN/rad": 1e-3}),
    "N.m": Unit({"kg": 1, "m": 2, "s": -2}, {"kN.m": 1e-3}),
    "N.m/rad": Unit({"kg": 1, "m": 2, "s": -2, "rad": -1}, {"kN.m/rad": 1e-3}),
    "N.m.s/rad": Unit({"kg": 1, "m": 2, "s": -1, "rad": -1}, {}),
}
_RATE_OF = {"m": "m/s", "rad": "rad/s", "m/s": "m/s2", "rad/s": "rad/s2", "N": "N/s"}


def _state(name: str, unit: str, nominal: float, description: str) -> Variable:
    return Variable(name, "output", "continuous", unit, description, nominal=nominal)


def _output(name: str, unit: str, nominal: float, description: str, **limits: Any) -> Variable:
    return Variable(name, "output", "continuous", unit, description, nominal=nominal, **limits)


def _input(name: str, unit: str, nominal: float, description: str, *, start: float = 0.0, **limits: Any) -> Variable:
    return Variable(name, "input", "continuous", unit, description, nominal=nominal, start=start, **limits)


def _start(name: str, unit: str, description: str) -> Variable:
    return Variable(name, "parameter", "fixed", unit, description, start=0.0)


def _per_wheel(prefix: str, unit: str, nominal: float, description: str, **limits: Any) -> tuple[Variable, ...]:
    return tuple(_output(f"{prefix}_{n}", unit, nominal, f"{description}, {w}", **limits) for n, w, *_ in WHEELS)


_LAMBDA = {"minimum": LAMBDA_MIN, "maximum": LAMBDA_MAX}
_QUARTER_TURN = {"minimum": -math.pi / 2, "maximum": math.pi / 2}


STATES = (
    _state("X", "m", 10.0, "position of the centre of mass, road axes"),
    _state("Y", "m", 10.0, "position of the centre of mass, road axes, positive to the left"),
    _state("psi", "rad", 1.0, "yaw angle from the road's X axis, not wrapped"),
    _state("phi", "rad", 0.1, "roll angle of the sprung mass, positive leaning right"),
    _state("v_x", "m/s", 10.0, "velocity of the centre of mass, forward"),
    _state("v_y", "m/s", 1.0, "velocity of the centre of mass, to the left"),
    _state("gamma", "rad/s", 0.1, "yaw rate"),
    _state("p", "rad/s", 0.1, "roll rate"),
    *(_state(f"omega_{n}", "rad/s", 50.0, f"spin of the wheel, {w}") for n, w, *_ in WHEELS),
    _state("load_transfer_x", "N", 1000.0, "load moved from the front to the rear axle, lagged"),
    _state("load_transfer_y", "N", 1000.0, "load moved from left to right through roll centres, lagged"),
)

DERIVATIVES = tuple(
    Variable(
        f"der({s.name})",
        "local",
        "continuous",
        _RATE_OF[s.unit],
        f"time derivative of {s.name}",
        derivative_of=s.name,
    )
    for s in STATES
)

OUTPUTS = (
    _output("a_x", "m/s2", 1.0, "acceleration of the centre of mass, forward, dv_x/dt - v_y gamma"),
    _output("a_y", "m/s2", 1.0, "acceleration of the centre of mass, to the left, dv_y/dt + v_x gamma"),
    _output("beta", "rad", 0.1, "side-slip angle at the centre of mass (regularised at low speed)", **_QUARTER_TURN),
    *_per_wheel("F_x", "N", 1000.0, "longitudinal tyre force in wheel axes"),
    *_per_wheel("F_y", "N", 1000.0, "lateral tyre force in wheel axes"),
    *_per_wheel("F_z", "N", 1000.0, "tyre load", minimum=0.0),
    *_per_wheel(
        "alpha", "rad", 0.1, "tyre slip angle, positive where it pushes left (as in the paper)", **_QUARTER_TURN
    ),
    *_per_wheel("kappa", "1", 0.1, "slip ratio (R omega - v)/|v| with the rolling radius R (regularised at low speed)"),
)

INPUTS = (
    _input("steering_angle", "rad", 0.1, "road-wheel angle of both front wheels, positive to the left"),
    *(_input(f"wheel_torque_{n}", "N.m", 100.0, f"torque on the wheel, {w}") for n, w, *_ in WHEELS),
    _input("lambda_f", "1", 1.0, "uncertainty of the front cornering stiffness", **_LAMBDA),
    _input("lambda_r", "1", 1.0, "uncertainty of the rear cornering stiffness", **_LAMBDA),
    _input("mu", "1", 1.0, "tyre-road friction coefficient", start=VehicleParameters().mu_a, minimum=0.01, maximum=2.0),
    *(
        _input(
            f"inflation_{n}",
            "1",
            1.0,
            f"inflation pressure of the tyre over nominal, 1 sound, 0 flat, {w}",
            start=1.0,
            minimum=0.0,
            maximum=1.0,
        )
        for n, w, *_ in WHEELS
    ),
    _input("force_x", "N", 1000.0, "external force at the centre of mass along the vehicle's x axis (wind, slope)"),
    _input("force_y", "N", 1000.0, "external force at the centre of mass along the vehicle's y axis (wind, slope)"),
    _input("moment_z", "N.m", 1000.0, "external yaw moment"),
)

_DEFAULTS = VehicleParameters()

# The nominal road's adhesion is the start value of the input mu, not a parameter of the vehicle.
PARAMETERS = tuple(
    Variable(
        f.name,
        "parameter",
        "tunable",
        f.metadata["unit"],
        f"{f.metadata['description']} ({f.metadata['source']})",
        start=getattr(_DEFAULTS, f.name),
        minimum=f.metadata["minimum"],
        maximum=f.metadata["maximum"],
    )
    for f in fields(VehicleParameters)
    if f.name != "mu_a"
)

STARTS = (
    _start("X_start", "m", "start value of X"),
    _start("Y_start", "m", "start value of Y"),
    _start("psi_start", "rad", "start value of psi"),
    _start("v_x_start", "m/s", "start value of v_x; the wheels start rolling with it"),
    _start("v_y_start", "m/s", "start value of v_y"),
    _start("gamma_start", "rad/s", "start value of gamma"),
)

TIME = Variable("time", "independent", "continuous", "s", "simulation time")

#: The real-valued settings of the Co-Simulation's solver; in Model Exchange the importer provides the solver.
SOLVER_SETTINGS = (
    Variable(
        "solver_step",
        "parameter",
        "fixed",
        "s",
        "Co-Simulation: longest step of the fixed-step solver; shortened if it would be unstable at rest",
        start=1e-3,
        minimum=1e-6,
        maximum=1e-2,
    ),
    Variable(
        "solver_tolerance",
        "parameter",
        "fixed",
        "1",
        "Co-Simulation: relative tolerance of the adaptive solver, unless the experiment's is smaller",
        start=1e-6,
        minimum=1e-13,
        maximum=1e-1,
    ),
)

SOLVER = Variable(
    "solver",
    "parameter",
    "fixed",
    "",
    "Co-Simulation: the solver",
    start=1,
    minimum=1,
    maximum=2,
    items=(
        ("runge_kutta_4", "classical Runge-Kutta, order 4, fixed step"),
        ("dormand_prince_5", "Dormand-Prince, orders 5 and 4, adaptive step"),
    ),
)

#: All variables of the model itself; they have the first value references.
MODEL_VARIABLES = (*STATES, *DERIVATIVES, *OUTPUTS, *INPUTS, *PARAMETERS, *STARTS)

VARIABLES = (*MODEL_VARIABLES, TIME, *SOLVER_SETTINGS, SOLVER)
