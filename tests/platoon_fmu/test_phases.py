"""Every function of the standard in every phase: allowed where the standard says so, refused elsewhere."""

from __future__ import annotations

import ctypes
import math

import pytest
from fmpy.fmi1 import FMICallException

from platoon_fmu import interface
from platoon_fmu.importer import Kind

N = len(interface.STATES)
ERROR = 3
REFERENCE = (ctypes.c_uint * 1)(4)
BUFFER = (ctypes.c_double * N)()
MU = next(i for i, v in enumerate(interface.VARIABLES) if v.name == "mu")
SOLVER = len(interface.VARIABLES) - 1

ME = {
    "instantiated": lambda _: None,
    "initialization": lambda car: enter_initialization(car),
    "event": lambda car: (car.start(), car.raw.enterEventMode()),
    "continuous": lambda car: car.start(v_x_start=20.0),
    "terminated": lambda car: (car.start(), car.terminate()),
}
CS = {
    "instantiated": lambda _: None,
    "initialization": lambda car: enter_initialization(car),
    "stepping": lambda car: car.start(v_x_start=20.0),
    "terminated": lambda car: (car.start(), car.terminate()),
    "failed": lambda car: fail(car),
}


def enter_initialization(car):
    if car.fmu.version == 2:
        car.raw.setupExperiment()
    car.raw.enterInitializationMode()


def fail(car):
    car.start()
    car.set(force_x=1e305)
    with pytest.raises(FMICallException):
        car.step()


def save_and_free(car):
    car.discard(car.save())


BEFORE = "instantiated initialization"
ALL_ME, ALL_CS = " ".join(ME), " ".join(CS)
AFTER_START_ME, AFTER_START_CS = (
    "initialization event continuous terminated",
    "initialization stepping terminated failed",
)

# Function: (how it is called, phases of Model Exchange, phases of Co-Simulation). After the tables of FMI 2.0.4,
# sections 3.2.3 and 4.2.4, and the state machines of FMI 3.0.2, sections 2.3, 3.2 and 4.2.
SHARED = {
    "enterInitializationMode": (lambda c: c.raw.enterInitializationMode(), "instantiated", "instantiated"),
    "exitInitializationMode": (lambda c: c.raw.exitInitializationMode(), "initialization", "initialization"),
    "terminate": (lambda c: c.raw.terminate(), "event continuous", "stepping"),
    "reset": (lambda c: c.raw.reset(), ALL_ME, ALL_CS),
    "setDebugLogging": (lambda c: c.raw.setDebugLogging(True, ["logStatusError"]), ALL_ME, ALL_CS),
    "getFMUstate": (save_and_free, ALL_ME, "instantiated initialization stepping terminated"),
    "serialize": (lambda c: c.serialise(), ALL_ME, "instantiated initialization stepping terminated"),
    "getDirectionalDerivative": (
        lambda c: c.raw.getDirectionalDerivative([4], [MU], [1.0]), AFTER_START_ME, AFTER_START_CS
    ),
    "enterEventMode": (lambda c: c.raw.enterEventMode(), "event continuous", ""),
    "enterContinuousTimeMode": (lambda c: c.raw.enterContinuousTimeMode(), "event", ""),
    "completedIntegratorStep": (lambda c: c.raw.completedIntegratorStep(), "continuous", ""),
    "setContinuousStates": (lambda c: c.raw.setContinuousStates(BUFFER, N), "continuous", ""),
    "getContinuousStates": (lambda c: c.raw.getContinuousStates(BUFFER, N), AFTER_START_ME, ""),
    "getEventIndicators": (lambda c: c.raw.getEventIndicators(BUFFER, 0), AFTER_START_ME, ""),
    "getNominals": (
        lambda c: c.raw.getNominalsOfContinuousStates(BUFFER, N), f"instantiated {AFTER_START_ME}", ""
    ),
    "doStep": (lambda c: c.raw.doStep(0.0, 0.01), "", "stepping"),
}  # fmt: skip
OF_2 = {
    "setupExperiment": (lambda c: c.raw.setupExperiment(), "instantiated", "instantiated"),
    "getReal": (lambda c: c.raw.getReal([MU]), AFTER_START_ME, AFTER_START_CS),
    "getInteger": (lambda c: c.raw.getInteger([SOLVER]), AFTER_START_ME, AFTER_START_CS),
    "getBoolean": (lambda c: c.raw.getBoolean([]), AFTER_START_ME, AFTER_START_CS),
    "setReal": (
        lambda c: c.raw.setReal([MU], [0.7]), "instantiated initialization event continuous",
        "instantiated initialization stepping",
    ),
    "setInteger": (lambda c: c.raw.setInteger([SOLVER], [2]), BEFORE, BEFORE),
    "newDiscreteStates": (lambda c: c.raw.newDiscreteStates(), "event", ""),
    "setTime": (lambda c: c.raw.setTime(1.0), "event continuous", ""),
    "getDerivatives": (lambda c: c.raw.getDerivatives(BUFFER, N), AFTER_START_ME, ""),
    "getRealStatus": (lambda c: c.raw.getRealStatus(2), "", "stepping terminated failed"),
    "cancelStep": (lambda c: c.raw.cancelStep(), "", ""),
}  # fmt: skip
OF_3 = {
    "getFloat64": (lambda c: c.raw.getFloat64([MU]), ALL_ME, ALL_CS),
    "getInt64": (lambda c: c.raw.getInt64([SOLVER]), ALL_ME, ALL_CS),
    "getString": (lambda c: c.raw.getString([]), ALL_ME, ALL_CS),
    "setFloat64": (
        lambda c: c.raw.setFloat64([MU], [0.7]), "instantiated initialization event continuous",
        "instantiated initialization stepping",
    ),
    "setInt64": (lambda c: c.raw.setInt64([SOLVER], [2]), BEFORE, BEFORE),
    "updateDiscreteStates": (lambda c: c.raw.updateDiscreteStates(), "event", ""),
    "setTime": (lambda c: c.raw.setTime(1.0), "continuous", ""),
    "getDerivatives": (lambda c: c.raw.getContinuousStateDerivatives(BUFFER, N), AFTER_START_ME, ""),
    "getAdjointDerivative": (
        lambda c: c.raw.getAdjointDerivative([4], [MU], [1.0], nSensitivity=1), AFTER_START_ME, AFTER_START_CS
    ),
    "getOutputDerivatives": (lambda c: c.raw.getOutputDerivatives([4], [1]), "", "stepping terminated"),
    "getNumberOfContinuousStates": (lambda c: c.raw.getNumberOfContinuousStates(), ALL_ME, ""),
    "getNumberOfEventIndicators": (lambda c: c.raw.getNumberOfEventIndicators(), ALL_ME, ""),
    "enterStepMode": (lambda c: c.raw.fmi3EnterStepMode(c.raw.component), "", ""),
    "enterConfigurationMode": (lambda c: c.raw.enterConfigurationMode(), "", ""),
    "exitConfigurationMode": (lambda c: c.raw.exitConfigurationMode(), "", ""),
    "evaluateDiscreteStates": (lambda c: c.raw.fmi3EvaluateDiscreteStates(c.raw.component), "", ""),
    "getNumberOfVariableDependencies": (
        lambda c: c.raw.fmi3GetNumberOfVariableDependencies(c.raw.component, 4, ctypes.byref(ctypes.c_size_t())), "", ""
    ),
    "getShiftDecimal": (lambda c: c.raw.fmi3GetShiftDecimal(c.raw.component, REFERENCE, 1, BUFFER), "", ""),
    "getClock": (lambda c: c.raw.getClock([4]), "", ""),
}  # fmt: skip


def cases(kind, phases):
    return [pytest.param(kind, phase, enter, id=f"{kind.name}-{phase}") for phase, enter in phases.items()]


@pytest.mark.parametrize(("kind", "phase", "enter"), [*cases(Kind.MODEL_EXCHANGE, ME), *cases(Kind.CO_SIMULATION, CS)])
def test_calls_are_allowed_where_the_standard_says_so(open_fmu, make_any, kind, phase, enter):
    functions = SHARED | (OF_2 if open_fmu.version == 2 else OF_3)
    wrong = []
    for name, (call, exchange, simulation) in functions.items():
        car = make_any(kind)
        enter(car)
        said = len(car.said)
        allowed = phase in (exchange if kind is Kind.MODEL_EXCHANGE else simulation).split()
        try:
            call(car)
            outcome = "done"
        except FMICallException as error:
            outcome = "refused" if error.status == ERROR and car.said[said:] else f"refused without a word: {error}"
        except AttributeError:
            # fmpy has some functions only on its class for the kind they are of.
            outcome = "refused"
        if outcome != ("done" if allowed else "refused"):
            wrong.append(f"{name}: {outcome}; said: {car.said[said:]}")
    assert wrong == []


def plain_library(car):
    """The binary without the argument types that fmpy gives its functions."""
    return ctypes.CDLL(car.raw.dll._name)


@pytest.mark.parametrize("kind", Kind, ids=["ME", "CS"])
def test_functions_of_the_other_kind_are_refused(make_any, kind):
    car = make_any(kind).start(v_x_start=20.0)
    dll, here, prefix = plain_library(car), ctypes.c_void_p(car.raw.component), f"fmi{car.fmu.version}"
    names = {
        Kind.CO_SIMULATION: ["EnterEventMode", "EnterContinuousTimeMode"],
        Kind.MODEL_EXCHANGE: ["CancelStep"] if car.fmu.version == 2 else ["EnterStepMode"],
    }[kind]
    for name in names:
        said = len(car.said)
        assert dll[prefix + name](here) == ERROR
        assert len(car.said) == said + 1
    if kind is Kind.CO_SIMULATION:
        assert dll[f"{prefix}SetTime"](here, ctypes.c_double(0.0)) == ERROR
        assert "not allowed in step mode of Co-Simulation" in car.said[-1]
    else:
        assert dll[f"{prefix}SetTime"](here, ctypes.c_double(math.nan)) == ERROR
        assert "the time is not finite" in car.said[-1]
        step = (ctypes.c_double(0.0), ctypes.c_double(0.01), 0, None, None, None, None)
        assert dll[f"{prefix}DoStep"](here, *step) == ERROR
        assert "not allowed in continuous-time mode of Model Exchange" in car.said[-1]


def test_missing_instances_and_arrays_are_errors(make_any):
    car = make_any().start()
    dll, here, nothing = plain_library(car), ctypes.c_void_p(car.raw.component), ctypes.c_void_p(None)
    prefix, one = f"fmi{car.fmu.version}", ctypes.c_size_t(1)
    for name in ("Reset", "Terminate", "EnterInitializationMode", "ExitInitializationMode", "DoStep"):
        assert dll[prefix + name](nothing, ctypes.c_double(0.0), ctypes.c_double(0.01), 0) == ERROR
    dll[f"{prefix}FreeInstance"](nothing)
    extra = () if car.fmu.version == 2 else (one,)
    types = ("Real", "Integer") if car.fmu.version == 2 else ("Float64", "Int64")
    for name in (verb + type_name for verb in ("Get", "Set") for type_name in types):
        assert dll[prefix + name](here, None, one, None, *extra) == ERROR
        assert "an array is missing" in car.said[-1]
    state = "FMUstate" if car.fmu.version == 2 else "FMUState"
    assert dll[f"{prefix}Get{state}"](here, None) == ERROR
    assert dll[f"{prefix}Set{state}"](here, None) == ERROR
    assert "the state is missing" in car.said[-1]
    assert dll[f"{prefix}Free{state}"](here, None) == 0
    assert dll[f"{prefix}Serialize{state}"](here, None, None, one) == ERROR
    assert dll[f"{prefix}GetDirectionalDerivative"](here, None, one, None, one, None, *extra, None, *extra) == ERROR
    car.step()
