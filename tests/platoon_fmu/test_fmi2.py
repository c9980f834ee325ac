"""The FMI 2.0 face: both kinds agree, and every misuse is refused with an error and no harm."""

from __future__ import annotations

import ctypes
import math

import fmpy
import numpy as np
import pytest
from fmpy import fmi2
from fmpy.fmi1 import FMICallException

from platoon_fmu import interface
from platoon_fmu.validate import validate

BOTH = pytest.mark.parametrize("kind", [fmi2.FMU2Slave, fmi2.FMU2Model])
UNKNOWN = len(interface.VARIABLES)


def enter(car):
    """Starts a car and brings it to where it is stepped or integrated."""
    car.start(v_x_start=20.0)
    if isinstance(car.fmu, fmi2.FMU2Model):
        car.fmu.enterContinuousTimeMode()
    return car


def simulate(path, kind, **options):
    steps = np.array(
        [(0.0, 0.0), (1.0, 0.0), (1.0, 0.05), (5.0, 0.05)],
        dtype=[("time", np.float64), ("steering_angle", np.float64)],
    )
    return fmpy.simulate_fmu(
        str(path),
        fmi_type=kind,
        start_values={"v_x_start": 20.0, "wheel_torque_fl": 30.0, "wheel_torque_fr": 30.0},
        input=steps,
        stop_time=5.0,
        output_interval=0.01,
        output=["X", "Y", "psi", "phi", "v_x", "v_y", "gamma", "p", "omega_fl", "a_y", "F_y_fl", "F_z_rr"],
        **options,
    )


def test_validates(fmu_path):
    assert validate(fmu_path) == []


def test_model_exchange_with_cvode_and_co_simulation_agree_on_a_step_steer(fmu_path):
    exchange = simulate(fmu_path, "ModelExchange", solver="CVode", relative_tolerance=1e-8)
    cosimulation = simulate(fmu_path, "CoSimulation")
    times = cosimulation["time"]
    for name in cosimulation.dtype.names[1:]:
        # An event of the input has two rows in Model Exchange; the later one is the value after it.
        index = np.searchsorted(exchange["time"], times + 1e-9, side="right") - 1
        away = np.abs(times - 1.0) > 1e-6
        scale = np.abs(cosimulation[name]).max()
        difference = np.abs(exchange[name][index] - cosimulation[name])[away]
        assert difference.max() <= 1e-4 * scale, name


def test_a_step_of_any_size_is_the_same_time_in_small_steps(make_car):
    cars = [make_car().start(v_x_start=20.0) for _ in range(3)]
    for car, (h, n) in zip(cars, ((0.001, 600), (0.01, 60), (0.6, 1)), strict=True):
        car.set(steering_angle=0.03)
        for _ in range(n):
            car.step(h)
    small, usual, large = (car.get("X", "Y", "psi", "v_x", "v_y", "gamma") for car in cars)
    assert usual == pytest.approx(small, rel=1e-12)
    assert large == pytest.approx(small, rel=1e-12)
    odd = make_car().start(v_x_start=20.0)
    odd.set(steering_angle=0.03)
    for h in (0.0137, 0.0003, 0.586):
        odd.step(h)
    assert odd.get("X", "Y", "psi") == pytest.approx(small[:3], rel=1e-7)


def test_instances_do_not_disturb_each_other_and_reset_starts_afresh(make_car):
    def drive(car):
        car.set(steering_angle=0.05)
        return car.run(1.0, names=["X", "Y", "gamma"])

    alone = drive(make_car().start(v_x_start=20.0))
    one, other = make_car().start(v_x_start=20.0), make_car().start(v_x_start=35.0)
    one.set(steering_angle=0.05)
    other.set(steering_angle=-0.2)
    rows = []
    for _ in range(100):
        one.step()
        other.step()
        rows.append(one.get("X", "Y", "gamma"))
    assert (np.array(rows) == alone).all()
    one.fmu.reset()
    one.time = 0.0
    assert (drive(one.start(v_x_start=20.0)) == alone).all()


def test_a_tunable_parameter_counts_from_the_next_step(make_car):
    car = make_car().start(v_x_start=20.0)
    car.run(0.1)
    before = car["a_x"]
    car.set(C_d=0.9)
    assert car["a_x"] < before
    car.step()


def test_start_values_can_still_change_in_initialization_mode(make_car):
    car = make_car()
    car.fmu.setupExperiment(startTime=0.0)
    car.set(v_x_start=10.0)
    car.fmu.enterInitializationMode()
    assert car["v_x"] == 10.0
    car.set(v_x_start=12.0, X_start=5.0, R_w=0.4)
    assert car.get("v_x", "X", "omega_rr") == pytest.approx([12.0, 5.0, 30.0])
    car.fmu.exitInitializationMode()
    assert car["v_x"] == 12.0


def test_starts_at_the_time_it_is_told(make_car):
    car = make_car()
    car.time = 7.5
    car.start(v_x_start=20.0)
    car.step()
    assert car.fmu.getRealStatus(fmi2.fmi2LastSuccessfulTime) == pytest.approx(7.51)


@BOTH
@pytest.mark.parametrize("name", ["v_x", "der(v_x)", "F_x_fl"])
def test_what_the_fmu_calculates_cannot_be_set(make_car, kind, name):
    car = enter(make_car(kind))
    with pytest.raises(FMICallException):
        car.set(**{name: 1.0})
    assert "cannot be set" in car.said[-1]


@BOTH
def test_start_values_are_fixed_after_the_start(make_car, kind):
    car = enter(make_car(kind))
    with pytest.raises(FMICallException):
        car.set(v_x_start=1.0)
    assert "cannot be changed now" in car.said[-1]


@BOTH
@pytest.mark.parametrize("reference", [UNKNOWN, UNKNOWN + 1, 2**31, 2**32 - 1])
def test_unknown_references_are_refused(make_car, kind, reference):
    car = enter(make_car(kind))
    with pytest.raises(FMICallException):
        car.fmu.getReal([reference])
    with pytest.raises(FMICallException):
        car.fmu.setReal([reference], [1.0])
    assert str(reference) in car.said[-1]


@BOTH
@pytest.mark.parametrize("type_name", ["Integer", "Boolean", "String"])
def test_references_of_another_type_are_refused(make_car, kind, type_name):
    car = enter(make_car(kind))
    with pytest.raises(FMICallException):
        getattr(car.fmu, f"get{type_name}")([0])
    value = "a" if type_name == "String" else 1
    with pytest.raises(FMICallException):
        getattr(car.fmu, f"set{type_name}")([0], [value])
    assert f"no variable is a {type_name}" in car.said[-1].replace("an ", "a ")


@BOTH
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_values_that_are_not_finite_are_refused_and_nothing_is_set(make_car, kind, value):
    car = enter(make_car(kind))
    with pytest.raises(FMICallException):
        car.set(mu=0.3, steering_angle=value)
    assert "not finite" in car.said[-1]
    assert car.get("mu", "steering_angle") == pytest.approx([0.8, 0.0])


@pytest.mark.parametrize("h", [0.0, -0.01, math.nan, math.inf])
def test_bad_step_sizes_are_refused_and_the_run_goes_on(make_car, h):
    car = enter(make_car())
    with pytest.raises(FMICallException):
        car.fmu.doStep(currentCommunicationPoint=0.0, communicationStepSize=h)
    car.step()
    assert car["X"] == pytest.approx(0.2, rel=1e-3)


def test_a_step_must_start_where_the_last_one_ended_and_end_by_the_stop_time(make_car):
    car = make_car()
    car.fmu.setupExperiment(startTime=0.0, stopTime=0.1)
    car.fmu.enterInitializationMode()
    car.fmu.exitInitializationMode()
    for begin, h in ((0.5, 0.01), (-0.01, 0.01), (math.nan, 0.01), (0.0, 0.11)):
        with pytest.raises(FMICallException):
            car.fmu.doStep(currentCommunicationPoint=begin, communicationStepSize=h)
    car.fmu.doStep(currentCommunicationPoint=0.0, communicationStepSize=0.1)


def test_a_step_that_diverges_is_an_error_and_reset_recovers(make_car):
    car = enter(make_car())
    car.set(M=1e-300, force_x=1e300)
    with pytest.raises(FMICallException):
        car.step()
    assert "diverged" in car.said[-1]
    with pytest.raises(FMICallException):
        car.step()
    car.fmu.reset()
    car.time = 0.0
    car.start(v_x_start=20.0).step()
    assert car["v_x"] == pytest.approx(20.0, abs=0.01)


CALLS_BY_PHASE = {
    "instantiated": lambda _car: None,
    "initialization": lambda car: (car.fmu.setupExperiment(startTime=0.0), car.fmu.enterInitializationMode()),
    "running": lambda car: car.start(),
    "continuous": lambda car: (car.start(), car.fmu.enterContinuousTimeMode()),
    "terminated": lambda car: (car.start(), car.fmu.terminate()),
}
STEP = ("doStep", (0.0, 0.01))
STATES = ("getContinuousStates", ((fmi2.fmi2Real * 14)(), 14))
FORBIDDEN = {
    fmi2.FMU2Slave: {
        "instantiated": [STEP, ("exitInitializationMode", ()), ("terminate", ()), ("getReal", ([0],))],
        "initialization": [STEP, ("enterInitializationMode", ()), ("setupExperiment", ())],
        "running": [("enterInitializationMode", ()), ("exitInitializationMode", ()), ("cancelStep", ())],
        "terminated": [STEP, ("terminate", ()), ("setReal", ([66], [0.0]))],
    },
    fmi2.FMU2Model: {
        "instantiated": [("enterContinuousTimeMode", ()), ("getReal", ([0],)), STATES],
        "initialization": [("setTime", (1.0,)), ("completedIntegratorStep", ())],
        "running": [
            ("setContinuousStates", STATES[1]),
            ("completedIntegratorStep", ()),
            ("enterInitializationMode", ()),
        ],
        "continuous": [("newDiscreteStates", ()), ("setupExperiment", ())],
        "terminated": [("setTime", (1.0,)), ("enterEventMode", ()), ("setReal", ([66], [0.0]))],
    },
}


@pytest.mark.parametrize(
    ("kind", "phase", "call"),
    [
        pytest.param(kind, phase, call, id=f"{kind.__name__}-{phase}-{call[0]}")
        for kind, phases in FORBIDDEN.items()
        for phase, calls in phases.items()
        for call in calls
    ],
)
def test_calls_in_the_wrong_phase_are_refused_and_logged(make_car, kind, phase, call):
    car = make_car(kind)
    CALLS_BY_PHASE[phase](car)
    name, arguments = call
    with pytest.raises(FMICallException):
        getattr(car.fmu, name)(*arguments)
    assert "not allowed" in car.said[-1]


def test_co_simulation_and_model_exchange_calls_are_not_mixed(make_car):
    slave, model = enter(make_car()), enter(make_car(fmi2.FMU2Model))
    n = (fmi2.fmi2Real * 14)()
    for name, arguments in (
        ("fmi2SetTime", (0.0,)),
        ("fmi2EnterEventMode", ()),
        ("fmi2GetDerivatives", (n, 14)),
    ):
        function = getattr(slave.fmu.dll, name)
        function.argtypes = None
        assert function(ctypes.c_void_p(slave.fmu.component), *arguments_c(arguments)) == fmi2.fmi2Error
    step = model.fmu.dll.fmi2DoStep
    arguments = (ctypes.c_double(0.0), ctypes.c_double(0.01), ctypes.c_int(0))
    assert step(ctypes.c_void_p(model.fmu.component), *arguments) == fmi2.fmi2Error


def arguments_c(arguments):
    kinds = {float: ctypes.c_double, int: ctypes.c_size_t}
    return [kinds[type(a)](a) if type(a) in kinds else a for a in arguments]


def test_the_number_of_states_is_checked(make_car):
    car = enter(make_car(fmi2.FMU2Model))
    for n in (0, 13, 15):
        with pytest.raises(FMICallException):
            car.fmu.getContinuousStates((fmi2.fmi2Real * 20)(), n)
    bad = (fmi2.fmi2Real * 14)(*([math.nan] * 14))
    with pytest.raises(FMICallException):
        car.fmu.setContinuousStates(bad, 14)
    car.fmu.getEventIndicators((fmi2.fmi2Real * 1)(), 0)


def test_missing_component_and_arrays_are_errors(make_car):
    car = enter(make_car())
    dll, here = car.fmu.dll, ctypes.c_void_p(car.fmu.component)
    nothing = ctypes.c_void_p(None)
    step = (ctypes.c_double(0.0), ctypes.c_double(0.01), ctypes.c_int(0))
    assert dll.fmi2DoStep(nothing, *step) == fmi2.fmi2Error
    assert dll.fmi2Reset(nothing) == fmi2.fmi2Error
    assert dll.fmi2GetReal(here, None, ctypes.c_size_t(1), None) == fmi2.fmi2Error
    assert dll.fmi2SetReal(here, None, ctypes.c_size_t(1), None) == fmi2.fmi2Error
    dll.fmi2FreeInstance(nothing)


def test_a_wrong_guid_or_name_gives_no_instance(make_car):
    car = make_car()
    car.fmu.guid = "{00000000-0000-0000-0000-000000000000}"
    with pytest.raises(Exception, match="instantiate"):
        car.fmu.instantiate(loggingOn=False)


def test_unclaimed_capabilities_are_refused(make_car):
    car = enter(make_car())
    with pytest.raises(FMICallException):
        car.fmu.getFMUState()
    with pytest.raises(FMICallException):
        car.fmu.getDirectionalDerivative([0], [1], [1.0])
    with pytest.raises(FMICallException):
        car.fmu.setDebugLogging(True, ["noSuchCategory"])
    car.fmu.setDebugLogging(True, ["logStatusError"])


def test_only_fmi_functions_leave_the_binary(make_car):
    dll = make_car().fmu.dll
    for name in ("core_new", "solver_advance", "vehicle_derivatives", "platoon_model"):
        assert not hasattr(dll, name)


def test_dependencies_are_those_of_the_equations(fmu_path):
    description = fmpy.read_model_description(str(fmu_path))
    found = {u.variable.name: {d.name for d in u.dependencies} for u in description.derivatives}
    assert found["der(X)"] == {"psi", "v_x", "v_y"}
    assert found["der(psi)"] == {"gamma"}
    outputs = {u.variable.name: {d.name for d in u.dependencies} for u in description.outputs}
    assert outputs["X"] == {"X"}
    assert "wheel_torque_fl" not in outputs["a_x"]
    assert {"mu", "lambda_f", "steering_angle", "phi"} <= outputs["F_y_fl"]
    starts = {u.variable.name: {d.name for d in u.dependencies} for u in description.initialUnknowns}
    assert starts["omega_fl"] == {"v_x_start", "gamma_start", "l_t", "R_w"}
