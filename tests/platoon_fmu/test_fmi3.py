"""What only FMI 3.0 has: adjoint derivatives, intermediate updates and early return, more types."""

from __future__ import annotations

import ctypes

import numpy as np
import pytest
from fmpy.fmi1 import FMICallException

from platoon_fmu import interface
from platoon_fmu.errors import FmuError
from platoon_fmu.importer import Kind

UNKNOWNS = [v.name for v in (*interface.STATES, *interface.DERIVATIVES, *interface.OUTPUTS)]
STATES, INPUTS = [v.name for v in interface.STATES], [v.name for v in interface.INPUTS]


@pytest.fixture
def make_car3(open_fmu3, car_class, request):
    """Makes instances of the FMU for FMI 3.0, with fmpy's arguments of instantiate."""

    def make(kind=Kind.CO_SIMULATION, **options):
        class Chosen(car_class):
            def _instantiate(self):
                self.raw.instantiate(loggingOn=True, logMessage=self._log_3, **options)

        car = Chosen(open_fmu3, kind, "car")
        request.addfinalizer(car.free)
        return car

    return make


def test_adjoint_derivatives_are_the_transposed_directional_ones(make_car3):
    random = np.random.default_rng(2)
    for kind in Kind:
        car = make_car3(kind).start(v_x_start=20.0, v_y_start=0.4, gamma_start=0.3)
        car.set(steering_angle=0.04)
        knowns = [*STATES, *INPUTS]
        jacobian = np.array([car.directional_derivative(UNKNOWNS, [known], [1.0]) for known in knowns]).T
        for _ in range(3):
            seed = random.normal(size=len(UNKNOWNS))
            found = car.adjoint_derivative(UNKNOWNS, knowns, seed)
            assert found == pytest.approx(seed @ jacobian, rel=1e-9, abs=1e-9)
        # The same unknown twice counts twice.
        assert car.adjoint_derivative(["a_y", "a_y"], ["v_y"], [1.0, 2.0]) == pytest.approx(
            3 * car.directional_derivative(["a_y"], ["v_y"], [1.0])
        )


def test_adjoint_derivatives_of_the_beginning(make_car3):
    car = make_car3()
    car.set(v_x_start=20.0, v_y_start=0.4)
    car.raw.enterInitializationMode()
    knowns = ["v_x_start", "R_w", "M", "steering_angle"]
    seed = np.random.default_rng(4).normal(size=len(UNKNOWNS))
    jacobian = np.array([car.directional_derivative(UNKNOWNS, [known], [1.0]) for known in knowns]).T
    assert car.adjoint_derivative(UNKNOWNS, knowns, seed) == pytest.approx(seed @ jacobian, rel=1e-9)


def test_the_number_of_values_is_checked(make_car3):
    car = make_car3().start()
    with pytest.raises(FMICallException):
        car.raw.getFloat64([4], nValues=2)
    assert "there must be 1 values, not 2" in car.said[-1]
    with pytest.raises(FMICallException):
        car.raw.setFloat64([car.references(["mu"])[0]], [0.5, 0.5])
    with pytest.raises(FMICallException):
        car.raw.getDirectionalDerivative([4], [4], [1.0], nSensitivity=2)
    with pytest.raises(FMICallException):
        car.raw.getAdjointDerivative([4], [4], [1.0], nSensitivity=2)


TYPES = ("Float32", "Int8", "UInt8", "Int16", "UInt16", "Int32", "UInt32", "UInt64", "Boolean", "String")


@pytest.mark.parametrize("type_name", TYPES)
def test_types_that_no_variable_has_are_refused(make_car3, type_name):
    car = make_car3().start()
    for call in (
        lambda: getattr(car.raw, f"get{type_name}")([0]),
        lambda: getattr(car.raw, f"set{type_name}")([0], ["a" if type_name == "String" else 1]),
    ):
        with pytest.raises(FMICallException):
            call()
        assert "the model has none of these" in car.said[-1]
        assert type_name in car.said[-1]


def test_every_function_of_the_standard_is_there(make_car3):
    car = make_car3()
    names = [name for name in dir(type(car.raw)) if name.startswith("fmi3")]
    assert len(names) > 70
    for name in [*names, "fmi3InstantiateModelExchange", "fmi3InstantiateScheduledExecution"]:
        assert hasattr(car.raw.dll, name), name


def test_errors_are_said_even_where_logging_is_off(make_car3):
    car = make_car3()
    car.raw.setDebugLogging(False, [])
    car.start()
    assert car.said == []
    with pytest.raises(FMICallException):
        car.raw.doStep(0.0, -1.0)
    assert "step size" in car.said[-1]


# ---- intermediate update and early return ----


class Watcher:
    """An importer that looks at the instance after every step of its solver, and may ask to return."""

    def __init__(self, return_when=lambda _time: False, return_at=lambda time: time):
        self.car = None
        self.rows = []
        self.said = []
        self._return_when, self._return_at = return_when, return_at

    def __call__(self, _environment, time, set_requested, get_allowed, finished, can_return, requested, at):
        assert (set_requested, get_allowed, finished) == (False, True, True)
        self.rows.append((time, *self.car.get("time", "X", "v_x", "a_y")))
        self.said.append(can_return)
        if self._return_when(time):
            requested[0] = True
            at[0] = self._return_at(time)

    def watched(self, make, **options):
        self.car = make(intermediateUpdate=self, **options)
        self.car.start(v_x_start=20.0)
        self.car.set(steering_angle=0.03)
        return self.car


def test_the_importer_sees_every_step_of_the_solver(make_car3):
    watcher = Watcher()
    car = watcher.watched(make_car3)
    alone = make_car3().start(v_x_start=20.0)
    alone.set(steering_angle=0.03)
    car.raw.doStep(0.0, 0.01)
    rows = np.array(watcher.rows)
    assert rows[:, 0] == pytest.approx(0.001 * np.arange(1, 11))
    assert (rows[:, 0] == rows[:, 1]).all()
    for time, _, X, v_x, a_y in watcher.rows:
        alone.step(time - alone.time)
        assert (X, v_x, a_y) == pytest.approx(tuple(alone.get("X", "v_x", "a_y")), rel=1e-12)
    assert watcher.said == [False] * 10


def test_looking_on_changes_nothing(make_car3):
    for solver in (1, 2):
        watcher = Watcher()
        watcher.car = make_car3(intermediateUpdate=watcher, earlyReturnAllowed=True)
        alone = make_car3()
        for car in (watcher.car, alone):
            car.start(v_x_start=20.0, solver=solver)
            car.set(steering_angle=0.03)
            car.run(0.5, h=0.013)
        assert len(watcher.rows) > 30
        assert (watcher.car.get(*UNKNOWNS) == alone.get(*UNKNOWNS)).all()


def test_returns_early_when_asked_and_goes_on(make_car3):
    watcher = Watcher(lambda time: time > 0.0045)
    car = watcher.watched(make_car3, earlyReturnAllowed=True)
    event, terminate, early, last = car.raw.doStep(0.0, 0.01)
    assert (event, terminate, early) == (False, False, True)
    assert last == car["time"] == pytest.approx(0.005)
    assert watcher.said == [True] * 5
    watcher._return_when = lambda _time: False
    assert car.raw.doStep(last, 0.01 - last)[2:] == (False, 0.01)
    whole = make_car3().start(v_x_start=20.0)
    whole.set(steering_angle=0.03)
    whole.step(0.01)
    assert car.get(*UNKNOWNS) == pytest.approx(whole.get(*UNKNOWNS), rel=1e-9)


def test_returns_at_the_time_asked_for(make_car3):
    watcher = Watcher(lambda time: time < 0.0015, return_at=lambda _time: 0.00325)
    car = watcher.watched(make_car3, earlyReturnAllowed=True)
    assert car.raw.doStep(0.0, 0.01) == (False, False, True, 0.00325)
    assert car["time"] == 0.00325
    # A time that has passed means now; one past the step means nothing.
    watcher._return_when, watcher._return_at = (lambda _time: True), (lambda _time: 0.0)
    assert car.raw.doStep(0.00325, 0.01)[2:] == (True, pytest.approx(0.00425, abs=1e-4))
    now = car["time"]
    watcher._return_at = lambda _time: 9.0
    assert car.raw.doStep(now, 0.01)[2:] == (False, now + 0.01)


def test_no_early_return_where_it_was_not_allowed(make_car3):
    watcher = Watcher(lambda _time: True)
    car = watcher.watched(make_car3)
    assert car.raw.doStep(0.0, 0.01)[2:] == (False, 0.01)
    assert watcher.said == [False] * 10


def test_within_an_update_values_are_read_and_nothing_else(make_car3):
    refused = []

    def update(*_):
        for call in (
            lambda: car.set(mu=0.5),
            lambda: car.raw.doStep(car["time"], 0.001),
            lambda: car.raw.terminate(),
            lambda: car.raw.reset(),
            lambda: car.save(),
            lambda: car.directional_derivative(["v_x"], ["v_y"], [1.0]),
        ):
            with pytest.raises(FMICallException):
                call()
            refused.append(car.said[-1])
        assert car.raw.getOutputDerivatives(car.references(["v_x"]), [1])[0] < 0

    car = make_car3(intermediateUpdate=update)
    car.start(v_x_start=20.0)
    car.raw.doStep(0.0, 0.002)
    assert len(refused) == 12
    assert all("not allowed in intermediate update mode" in line for line in refused)


def test_what_an_instance_cannot_have_is_refused(make_car3):
    good = make_car3(requiredIntermediateVariables=[4, 30])
    good.start()
    mu = good.references(["mu"])[0]
    for options, reason in (
        ({"eventModeUsed": True}, "no event mode"),
        ({"requiredIntermediateVariables": [mu]}, f"value reference {mu} is not available in intermediate updates"),
    ):
        with pytest.raises(FmuError, match=reason):
            make_car3(**options)


def test_an_instance_needs_a_name_and_the_right_token(make_car3):
    car = make_car3()
    assert car.raw.fmi3GetVersion() == b"3.0"
    token = car.fmu.description.instantiationToken.encode()
    library = ctypes.CDLL(car.raw.dll._name)
    instantiate = library.fmi3InstantiateModelExchange
    for arguments, reason in (
        ((b"", token), "instance name is missing"),
        ((None, token), "instance name is missing"),
        ((b"car", b"{another}"), "token {another} is not this binary's"),
        ((b"car", None), "token (none) is not"),
    ):
        assert instantiate(*arguments, None, False, False, None, car.raw.logMessage) in (None, 0)
        assert reason in car.said[-1]
    scheduled = library.fmi3InstantiateScheduledExecution
    assert scheduled(b"car", token, None, False, False, None, car.raw.logMessage, None, None, None) in (None, 0)
    assert "for Model Exchange and Co-Simulation" in car.said[-1]
    assert instantiate(b"car", b"{another}", None, False, False, None, ctypes.c_void_p(None)) in (None, 0)
