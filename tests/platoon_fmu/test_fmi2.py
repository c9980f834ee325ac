"""What only FMI 2.0 has: its own status functions, its types, its way to be instantiated."""

from __future__ import annotations

import pytest
from fmpy import fmi2
from fmpy.fmi1 import FMICallException

from platoon_fmu.importer import Kind


def test_the_last_successful_time_is_the_only_status(make_car):
    car = make_car().start(v_x_start=20.0)
    car.step()
    assert car.raw.getRealStatus(fmi2.fmi2LastSuccessfulTime) == 0.01
    with pytest.raises(FMICallException) as refused:
        car.raw.getRealStatus(fmi2.fmi2DoStepStatus)
    assert refused.value.status == fmi2.fmi2Discard


@pytest.mark.parametrize("type_name", ["Boolean", "String"])
def test_types_that_no_variable_has_are_refused(make_car, type_name):
    car = make_car().start()
    with pytest.raises(FMICallException):
        getattr(car.raw, f"get{type_name}")([0])
    assert f"{type_name}: the model has none of these" in car.said[-1]
    with pytest.raises(FMICallException):
        getattr(car.raw, f"set{type_name}")([0], ["a" if type_name == "String" else 1])
    assert f"{type_name}: the model has none of these" in car.said[-1]


def test_inputs_are_held_as_the_capability_flags_say(make_car):
    car = make_car().start()
    assert not car.fmu.element(Kind.CO_SIMULATION).canInterpolateInputs
    with pytest.raises(FMICallException):
        car.raw.fmi2SetRealInputDerivatives(car.raw.component, None, 0, None, None)
    assert "inputs are held" in car.said[-1]


def test_an_instance_needs_a_name_and_the_right_guid(make_car):
    car = make_car()
    assert car.raw.fmi2GetTypesPlatform() == b"default"
    assert car.raw.fmi2GetVersion() == b"2.0"
    instantiate = car.raw.dll.fmi2Instantiate
    guid = car.fmu.description.guid.encode()
    for arguments, reason in (
        ((b"", 1, guid), "instance name is missing"),
        ((None, 1, guid), "instance name is missing"),
        ((b"car", 1, b"{another}"), "guid {another} is not this binary's"),
        ((b"car", 1, None), "guid (none) is not"),
        ((b"car", 7, guid), "unknown fmuType 7"),
    ):
        assert instantiate(*arguments, None, car.raw.callbacks, 0, 0) in (None, 0)
        assert reason in car.said[-1]
    assert instantiate(b"car", 1, guid, None, None, 0, 0) in (None, 0)


def test_only_fmi_functions_leave_the_binary(make_car):
    dll = make_car().raw.dll
    for name in ("core_new", "solver_fixed_step", "vehicle_derivatives", "platoon_model"):
        assert not hasattr(dll, name)


def test_without_logging_nothing_is_said(make_car):
    car = make_car()
    car.raw.setDebugLogging(False, [])
    car.start()
    with pytest.raises(FMICallException):
        car.raw.doStep(0.0, -1.0)
    assert car.said == []


def test_dependencies_are_those_of_the_equations(open_fmu2):
    found = {u.variable.name: {d.name for d in u.dependencies} for u in open_fmu2.description.derivatives}
    assert found["der(X)"] == {"psi", "v_x", "v_y"}
    assert found["der(psi)"] == {"gamma"}
    outputs = {u.variable.name: {d.name for d in u.dependencies} for u in open_fmu2.description.outputs}
    assert outputs["X"] == {"X"}
    assert "wheel_torque_fl" not in outputs["a_x"]
    assert {"mu", "lambda_f", "steering_angle", "phi"} <= outputs["F_y_fl"]
    starts = {u.variable.name: {d.name for d in u.dependencies} for u in open_fmu2.description.initialUnknowns}
    assert starts["omega_fl"] == {"v_x_start", "gamma_start", "l_t", "R_w"}
