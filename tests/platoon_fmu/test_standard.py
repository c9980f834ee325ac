"""What both versions of the standard ask of the FMU: kinds that agree, states that restore, every misuse refused."""

from __future__ import annotations

import ctypes
import math
import subprocess
import sys

import fmpy
import numpy as np
import pytest
from fmpy.fmi1 import FMICallException
from fmpy.validation import validate_fmu

from platoon_fmu import interface
from platoon_fmu.importer import Instance, Kind

BOTH = pytest.mark.parametrize("kind", Kind, ids=["ME", "CS"])
UNKNOWN = len(interface.VARIABLES)
STATES = [v.name for v in interface.STATES]
DERIVATIVES = [v.name for v in interface.DERIVATIVES]
OUTPUTS = [v.name for v in interface.OUTPUTS]
INPUTS = [v.name for v in interface.INPUTS]
UNKNOWNS = [*STATES, *DERIVATIVES, *OUTPUTS]
TUNABLE = [v.name for v in interface.PARAMETERS]
STARTS = [v.name for v in interface.STARTS]


@pytest.fixture
def path(open_fmu, fmu_path, fmu3_path):
    """The file of `open_fmu`."""
    return fmu_path if open_fmu.version == 2 else fmu3_path


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


def test_fmpy_finds_nothing_to_complain_about(path):
    assert validate_fmu(str(path)) == []


def test_model_exchange_with_cvode_and_co_simulation_agree_on_a_step_steer(path):
    exchange = simulate(path, "ModelExchange", solver="CVode", relative_tolerance=1e-8)
    cosimulation = simulate(path, "CoSimulation")
    times = cosimulation["time"]
    for name in cosimulation.dtype.names[1:]:
        # An event of the input has two rows in Model Exchange; the later one is the value after it.
        index = np.searchsorted(exchange["time"], times + 1e-9, side="right") - 1
        away = np.abs(times - 1.0) > 1e-6
        scale = np.abs(cosimulation[name]).max()
        difference = np.abs(exchange[name][index] - cosimulation[name])[away]
        assert difference.max() <= 1e-4 * scale, name


def test_both_versions_are_one_core(fmu_path, fmu3_path):
    ours, other = simulate(fmu_path, "CoSimulation"), simulate(fmu3_path, "CoSimulation")
    assert len(ours) == len(other) == 501
    for name in ours.dtype.names[1:]:
        assert (ours[name] == other[name]).all(), name


def test_the_model_description_is_the_interface(open_fmu):
    found = open_fmu.description.modelVariables
    assert [v.name for v in found] == [v.name for v in interface.VARIABLES]
    assert [v.valueReference for v in found] == list(range(UNKNOWN))
    for variable, ours in zip(found, interface.VARIABLES, strict=True):
        assert (variable.causality, variable.variability) == (ours.causality, ours.variability)
        if ours.items:
            assert [item.name for item in variable.declaredType.items] == [name for name, _ in ours.items]
            continue
        assert (variable.unit, variable.displayUnit) == (ours.unit, ours.display_unit)
        for there, here in (
            (variable.start, ours.start),
            (variable.min, ours.minimum),
            (variable.max, ours.maximum),
            (variable.nominal, ours.nominal),
        ):
            assert (None if there is None else float(there)) == here, ours.name


def test_every_start_value_is_within_its_limits():
    limited = [v for v in interface.VARIABLES if v.start is not None]
    assert all((v.minimum is None or v.minimum <= v.start) for v in limited)
    assert all((v.maximum is None or v.start <= v.maximum) for v in limited)


def test_the_binary_starts_with_the_values_of_the_model_description(make_any):
    car = make_any()
    car.start()
    for variable in interface.VARIABLES:
        if variable.start is not None:
            assert car[variable.name] == variable.start, variable.name


# ---- steps ----


def test_a_step_of_any_size_is_the_same_time_in_small_steps(make_any):
    cars = [make_any().start(v_x_start=20.0) for _ in range(3)]
    for car, (h, n) in zip(cars, ((0.001, 600), (0.01, 60), (0.6, 1)), strict=True):
        car.set(steering_angle=0.03)
        for _ in range(n):
            car.step(h)
    small, usual, large = (car.get("X", "Y", "psi", "v_x", "v_y", "gamma") for car in cars)
    assert usual == pytest.approx(small, rel=1e-12)
    assert large == pytest.approx(small, rel=1e-12)
    odd = make_any().start(v_x_start=20.0)
    odd.set(steering_angle=0.03)
    for h in (0.0137, 0.0003, 0.586):
        odd.step(h)
    assert odd.get("X", "Y", "psi") == pytest.approx(small[:3], rel=1e-7)


def lane_change(car, h):
    """Two seconds of slalom with torque on one side, in steps of h."""
    for i in range(round(2.0 / 0.1)):
        car.set(steering_angle=0.05 * math.sin(0.7 * i), wheel_torque_fl=100.0)
        for _ in range(round(0.1 / h)):
            car.step(h)
    return car.get(*STATES)


@pytest.mark.parametrize("tolerance", [1e-4, 1e-6, 1e-8, 1e-10])
def test_the_adaptive_solver_meets_its_tolerance_in_steps_of_any_size(make_any, tolerance):
    exact = lane_change(make_any().start(v_x_start=20.0, solver=2, solver_tolerance=1e-13), 0.01)
    scale = np.abs(exact) + [v.nominal for v in interface.STATES]
    for h in (0.001, 0.01, 0.1):
        car = make_any().start(v_x_start=20.0, solver=2, solver_tolerance=tolerance)
        found = lane_change(car, h)
        assert (np.abs(found - exact) / scale).max() < 20 * tolerance


def test_a_tighter_tolerance_of_the_experiment_goes_first(open_fmu):
    ends = []
    for parameter, experiment in ((1e-4, None), (1e-4, 1e-9), (1e-9, None), (1e-9, 1e-4)):
        with Instance(open_fmu, Kind.CO_SIMULATION) as car:
            car.start({"v_x_start": 20.0, "solver": 2, "solver_tolerance": parameter}, tolerance=experiment)
            ends.append(lane_change(car, 0.1))
    assert (ends[1] == ends[2]).all()
    assert (ends[3] == ends[2]).all()
    assert (ends[0] != ends[2]).any()


@pytest.mark.parametrize("solver", [1, 2])
def test_fixed_steps_are_as_long_as_the_parameter_says(make_any, solver):
    coarse, fine = (make_any().start(v_x_start=20.0, solver=solver, solver_step=s) for s in (0.002, 0.0005))
    assert (lane_change(coarse, 0.1) == lane_change(fine, 0.1)).all() == (solver == 2)


def test_the_adaptive_solver_gives_up_where_no_step_is_short_enough(make_any):
    car = make_any().start(v_x_start=20.0, solver=2)
    car.set(force_x=1e305)
    with pytest.raises(FMICallException):
        car.step()
    assert "failed at 0 s" in car.said[-1]


@pytest.mark.parametrize("h", [0.0, -0.01, math.nan, math.inf])
def test_bad_step_sizes_are_refused_and_the_run_goes_on(make_any, h):
    car = make_any().start(v_x_start=20.0)
    with pytest.raises(FMICallException):
        car.raw.doStep(currentCommunicationPoint=0.0, communicationStepSize=h)
    assert "step size must be greater than 0 s and finite" in car.said[-1]
    car.step()
    assert car["X"] == pytest.approx(0.2, rel=1e-3)


def test_a_step_must_start_where_the_last_one_ended_and_end_by_the_stop_time(open_fmu):
    with Instance(open_fmu, Kind.CO_SIMULATION) as car:
        car.start(stop_time=0.1)
        for begin, h in ((0.5, 0.01), (-0.01, 0.01), (math.nan, 0.01), (0.0, 0.11)):
            with pytest.raises(FMICallException):
                car.raw.doStep(currentCommunicationPoint=begin, communicationStepSize=h)
        car.step(0.1)
        assert car["time"] == 0.1


def test_a_step_that_diverges_is_an_error_and_reset_recovers(make_any):
    car = make_any().start(v_x_start=20.0)
    state = car.save()
    car.set(force_x=1e305)
    with pytest.raises(FMICallException):
        car.step()
    assert "not finite" in car.said[-1]
    with pytest.raises(FMICallException):
        car.raw.doStep(currentCommunicationPoint=0.0, communicationStepSize=0.01)
    assert "not allowed in error" in car.said[-1]
    with pytest.raises(FMICallException):
        car.save()
    car.restore(state, 0.0)
    car.discard(state)
    car.step()
    assert car["v_x"] == pytest.approx(20.0, abs=0.01)
    car.reset()
    car.start(v_x_start=30.0).step()
    assert car["v_x"] == pytest.approx(30.0, abs=0.01)


@pytest.mark.parametrize("begin", [7.5, 1.7e9])
def test_a_run_is_the_same_at_any_time(make_any, begin):
    cars = make_any(), make_any()
    cars[1].time = begin
    ends = []
    for car in cars:
        car.start(v_x_start=20.0)
        car.set(steering_angle=0.03)
        for h in (0.0137, 0.25, 0.01):
            car.step(h)
        ends.append(car.get(*UNKNOWNS))
    assert (ends[0] == ends[1]).all()


def test_a_step_is_not_done_twice_however_late_it_is(make_any):
    car = make_any()
    car.time = 1e7
    car.start(v_x_start=20.0)
    car.step(0.01)
    with pytest.raises(FMICallException):
        car.raw.doStep(1e7, 0.01)
    assert "a step must start at 10000000.01" in car.said[-1]
    with pytest.raises(FMICallException):
        car.raw.doStep(1e16, 0.5)
    assert "vanishes in rounding at the time" in car.said[-1]


@pytest.mark.parametrize(
    "values",
    [
        {"solver_step": 0.01},
        {"solver_step": 0.002, "v_x_start": 2.0},
        {"v_slip": 3.0},
        {"v_slip": 0.1},
        {"I_w": 0.1},
        {"C_x": 1.2e5},
        {"C_f": 2e6, "C_r": 2e6, "C_x": 1e3},
    ],
    ids=str,
)
def test_fixed_steps_are_stable_at_rest_with_any_parameters(make_any, values):
    ends = []
    for solver in (1, 2):
        car = make_any().start(solver=solver, solver_tolerance=1e-10, **values)
        car.torque(50.0)
        car.set(steering_angle=0.02)
        car.run(0.5)
        ends.append(car.get(*STATES, "F_x_fl", "F_y_rr"))
    assert ends[0] == pytest.approx(ends[1], rel=1e-3, abs=1e-3)


# ---- values ----


@BOTH
@pytest.mark.parametrize(("name", "value"), [("M", 0.0), ("v_slip", -5.0), ("roll_share_f", 2.0), ("R_w", 0.0)])
def test_parameters_outside_their_limits_are_refused(make_any, kind, name, value):
    car = make_any(kind)
    with pytest.raises(FMICallException):
        car.set({name: value})
    assert "allowed:" in car.said[-1]
    car.start(v_x_start=20.0)
    assert car[name] == next(v.start for v in interface.PARAMETERS if v.name == name)
    car.set(lambda_f=1.5)
    assert car["lambda_f"] == 1.5


def test_a_tunable_parameter_counts_from_the_next_step(make_any):
    car = make_any().start(v_x_start=20.0)
    car.run(0.1)
    before = car["a_x"]
    car.set(C_d=0.9)
    assert car["a_x"] < before
    car.step()


def test_tunable_parameters_change_between_steps_and_not_within(make_any):
    car = make_any(Kind.MODEL_EXCHANGE).start(v_x_start=20.0)
    with pytest.raises(FMICallException):
        car.set(C_d=0.9)
    assert "cannot be changed now" in car.said[-1]
    car.raw.enterEventMode()
    before = car["a_x"]
    car.set(C_d=0.9)
    car.raw.enterContinuousTimeMode()
    assert car["a_x"] < before


def test_start_values_can_still_change_in_initialization_mode(make_any):
    car = make_any()
    if car.fmu.version == 2:
        car.raw.setupExperiment(startTime=0.0)
    car.set(v_x_start=10.0)
    car.raw.enterInitializationMode()
    assert car["v_x"] == 10.0
    car.set(v_x_start=12.0, X_start=5.0, R_w=0.4)
    assert car.get("v_x", "X", "omega_rr") == pytest.approx([12.0, 5.0, 30.0])
    car.raw.exitInitializationMode()
    assert car["v_x"] == 12.0


def test_starts_at_the_time_it_is_told(make_any):
    car = make_any()
    car.time = 7.5
    car.start(v_x_start=20.0)
    assert car["time"] == 7.5
    car.step()
    assert car["time"] == pytest.approx(7.51)


@BOTH
@pytest.mark.parametrize("name", ["v_x", "der(v_x)", "F_x_fl", "time"])
def test_what_the_fmu_calculates_cannot_be_set(make_any, kind, name):
    car = make_any(kind).start()
    with pytest.raises(FMICallException):
        car.set({name: 1.0})
    assert "cannot be set" in car.said[-1]


@BOTH
@pytest.mark.parametrize("name", ["v_x_start", "solver", "solver_step", "solver_tolerance"])
def test_fixed_parameters_are_fixed_after_the_start(make_any, kind, name):
    car = make_any(kind).start()
    if kind is Kind.MODEL_EXCHANGE:
        car.raw.enterEventMode()
    with pytest.raises(FMICallException):
        car.set({name: 1.0})
    assert "cannot be changed now" in car.said[-1]


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("solver", (0, 3, -1, 2**31 - 1)),
        ("solver_step", (0.0, -1e-3, 0.011, math.nan)),
        ("solver_tolerance", (0.0, 0.2)),
    ],
)
def test_settings_that_no_solver_works_with_are_refused(make_any, name, values):
    car = make_any()
    for value in values:
        with pytest.raises(FMICallException):
            car.set({name: value})
        assert "allowed:" in car.said[-1] or "not finite" in car.said[-1]
    car.start(v_x_start=20.0)
    assert car.get("solver", "solver_step", "solver_tolerance") == pytest.approx([1, 1e-3, 1e-6])


@BOTH
@pytest.mark.parametrize("reference", [UNKNOWN, UNKNOWN + 1, 2**31, 2**32 - 1])
def test_unknown_references_are_refused(make_any, kind, reference):
    car = make_any(kind).start()
    if kind is Kind.MODEL_EXCHANGE:
        car.raw.enterEventMode()
    real, integer = (("Real", "Integer"), ("Float64", "Int64"))[car.fmu.version - 2]
    for type_name in (real, integer):
        with pytest.raises(FMICallException):
            getattr(car.raw, f"get{type_name}")([reference])
        assert f"no variable has the value reference {reference}" in car.said[-1]
        with pytest.raises(FMICallException):
            getattr(car.raw, f"set{type_name}")([reference], [1])
        assert f"no variable has the value reference {reference}" in car.said[-1]


@BOTH
def test_a_variable_of_the_other_type_is_refused(make_any, kind):
    car = make_any(kind)
    real, integer = (("Real", "Integer"), ("Float64", "Int64"))[car.fmu.version - 2]
    (solver,) = car.references(["solver"])
    with pytest.raises(FMICallException):
        getattr(car.raw, f"set{real}")([solver], [1.0])
    with pytest.raises(FMICallException):
        getattr(car.raw, f"set{integer}")(car.references(["mu"]), [1])
    car.start()
    for type_name, reference in ((real, solver), (integer, car.references(["mu"])[0]), (integer, 0)):
        with pytest.raises(FMICallException):
            getattr(car.raw, f"get{type_name}")([reference])
        assert "is not of the type" in car.said[-1]


@BOTH
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_values_that_are_not_finite_are_refused_and_nothing_is_set(make_any, kind, value):
    car = make_any(kind).start()
    with pytest.raises(FMICallException):
        car.set(mu=0.3, steering_angle=value)
    assert "not finite" in car.said[-1]
    assert car.get("mu", "steering_angle") == pytest.approx([0.8, 0.0])


def test_the_number_of_states_is_checked(make_any):
    car = make_any(Kind.MODEL_EXCHANGE).start()
    n = len(STATES)
    for count in (0, n - 1, n + 1):
        with pytest.raises(FMICallException):
            car.set_states(np.zeros(count))
        assert f"the model has {n} continuous states, not {count}" in car.said[-1]
    with pytest.raises(FMICallException):
        car.set_states(np.full(n, math.nan))
    assert (car.states() == 0).all()


# ---- instances and states ----


def test_instances_do_not_disturb_each_other_and_reset_starts_afresh(make_any):
    def drive(car):
        car.set(steering_angle=0.05)
        return car.run(1.0, names=["X", "Y", "gamma"])

    alone = drive(make_any().start(v_x_start=20.0))
    one, other = make_any().start(v_x_start=20.0), make_any().start(v_x_start=35.0, solver=2)
    one.set(steering_angle=0.05)
    other.set(steering_angle=-0.2)
    rows = []
    for _ in range(100):
        one.step()
        other.step()
        rows.append(one.get("X", "Y", "gamma"))
    assert (np.array(rows) == alone).all()
    for car in (one, other):
        car.reset()
        assert (drive(car.start(v_x_start=20.0)) == alone).all()


def test_reset_forgets_everything(make_any):
    car = make_any().start(v_x_start=30.0, M=1500.0, solver=2, solver_tolerance=1e-9)
    car.set(steering_angle=0.1, mu=0.2)
    car.run(0.5)
    car.reset()
    fresh, again = make_any().start(), car.start()
    for variable in interface.VARIABLES:
        assert again[variable.name] == fresh[variable.name], variable.name
    fresh.set(wheel_torque_fl=300.0)
    again.set(wheel_torque_fl=300.0)
    assert (fresh.run(0.2, names=UNKNOWNS) == again.run(0.2, names=UNKNOWNS)).all()


@pytest.mark.parametrize("solver", [1, 2])
def test_a_restored_state_goes_on_bit_for_bit(make_any, solver):
    car = make_any().start(v_x_start=20.0, solver=solver)
    car.set(steering_angle=0.05, M=1800.0)
    car.run(0.37, h=0.0123)
    state, time = car.save(), car.time

    def go_on():
        car.set(wheel_torque_rl=-50.0)
        return car.run(0.5, h=0.017, names=[*UNKNOWNS, "time"])

    first = go_on()
    for _ in range(2):
        car.set(steering_angle=-0.2, mu=0.1, K_phi=1000.0)
        car.run(0.1)
        car.restore(state, time)
        assert (go_on() == first).all()
    # Overwriting an old state needs no other place for it.
    before = state.value
    (car.raw.fmi2GetFMUstate if car.fmu.version == 2 else car.raw.fmi3GetFMUState)(car.raw.component, state)
    assert state.value == before
    car.discard(state)
    assert not state.value
    car.discard(state)


def test_a_state_goes_from_one_instance_to_another(make_any):
    car, other = make_any().start(v_x_start=20.0), make_any()
    car.set(steering_angle=0.05)
    car.run(0.3)
    state = car.save()
    other.restore(state, car.time)
    car.discard(state)
    assert (car.run(0.3, names=UNKNOWNS) == other.run(0.3, names=UNKNOWNS)).all()


@BOTH
def test_a_state_is_restored_in_whatever_phase_it_was_saved(make_any, kind):
    car = make_any(kind)
    car.set(v_x_start=17.0)
    instantiated = car.save()
    car.start(v_x_start=20.0)
    running = car.save()
    car.terminate()
    car.restore(instantiated, 0.0)
    car.start()
    assert car["v_x"] == 17.0
    car.restore(running, 0.0)
    assert car["v_x"] == 20.0
    if kind is Kind.CO_SIMULATION:
        car.step()
    else:
        assert car.derivatives()[0] == 20.0
    for state in (instantiated, running):
        car.discard(state)


CONTINUE = """
import sys
from pathlib import Path
from platoon_fmu.importer import Instance, Kind, opened
with opened(Path(sys.argv[1])) as fmu, Instance(fmu, Kind.CO_SIMULATION) as car:
    car.deserialise(sys.stdin.buffer.read(), 0.37)
    for _ in range(30):
        car.step(0.017)
    print(*(value.hex() for value in car.get(*sys.argv[2].split(","))))
"""


@pytest.mark.parametrize("solver", [1, 2])
def test_a_serialised_state_goes_on_bit_for_bit_in_another_process(make_any, path, solver):
    car = make_any().start(v_x_start=20.0, solver=solver)
    car.set(steering_angle=0.05, M=1800.0)
    car.step(0.37)
    content = car.serialise()
    command = [sys.executable, "-c", CONTINUE, str(path), ",".join(UNKNOWNS)]
    done = subprocess.run(command, input=content, capture_output=True, check=True)
    for _ in range(30):
        car.step(0.017)
    assert [float.fromhex(value) for value in done.stdout.decode().split()] == list(car.get(*UNKNOWNS))


def test_bytes_that_are_no_state_are_refused(make_any):
    car = make_any().start(v_x_start=20.0)
    content = car.serialise()
    exchange = make_any(Kind.MODEL_EXCHANGE).start().serialise()
    damaged = [content[:-1], content + b"\0", b"", exchange, bytes(len(content))]
    damaged += [content[:i] + bytes([content[i] ^ 0x10]) + content[i + 1 :] for i in range(0, len(content), 7)]
    before = car.get(*UNKNOWNS)
    for wrong in damaged:
        with pytest.raises(FMICallException):
            car.deserialise(wrong, 0.0)
        assert "the bytes" in car.said[-1]
    assert (car.get(*UNKNOWNS) == before).all()
    car.deserialise(content, 0.0)
    car.step()


# ---- derivatives of derivatives and outputs ----


def points(make, kind):
    """A car at operating points where the model is smooth: slow, fast, sliding, braking."""
    for start, inputs in (
        ({"v_x_start": 20.0, "v_y_start": 0.3, "gamma_start": 0.2}, {"steering_angle": 0.03}),
        ({"v_x_start": 35.0, "v_y_start": -4.0, "gamma_start": 0.5}, {"mu": 0.4, "lambda_f": 0.7}),
        ({"v_x_start": 2.0, "v_y_start": 0.1, "gamma_start": -0.1}, {"wheel_torque_fl": 100.0, "force_y": 300.0}),
        ({"v_x_start": -6.0, "v_y_start": 0.2, "gamma_start": 0.1}, {"wheel_torque_rr": -200.0, "lambda_r": -0.5}),
        ({"v_x_start": 25.0, "v_y_start": 0.1}, {"inflation_fl": 0.0, "inflation_rr": 0.3, "inflation_fr": 0.9}),
    ):
        yield make(kind).start(**start, **inputs)


def jacobian(car, unknowns, knowns):
    """Column by column from the FMU."""
    return np.array([car.directional_derivative(unknowns, [known], [1.0]) for known in knowns]).T


def differences(of, values, known, nominal):
    """Central differences of a function of a dict of values, in the one known."""
    h = 1e-6 * max(abs(values[known]), nominal)
    return (of({**values, known: values[known] + h}) - of({**values, known: values[known] - h})) / (2 * h)


def assert_close(found, expected, scale):
    """Equal to what differences give, the knowns in `scale`: 1e-5 of the row's largest and of the unknown's nominal."""
    found, expected = found * scale, expected * scale
    largest = np.abs(expected).max(axis=1)
    nominals = np.array([v.nominal or 1.0 for v in (*interface.STATES, *interface.DERIVATIVES, *interface.OUTPUTS)])
    assert (np.abs(found - expected).max(axis=1) <= 1e-5 * (largest + nominals)).all()


def test_directional_derivatives_are_those_of_differences(make_any):
    nominals = {v.name: v.nominal or 1.0 for v in interface.VARIABLES}
    for car in points(make_any, Kind.MODEL_EXCHANGE):
        knowns = [*STATES, *INPUTS]
        at = dict(zip(knowns, car.get(*knowns), strict=True))

        def of(values, car=car):
            car.set_states([values[name] for name in STATES])
            car.set({name: values[name] for name in INPUTS})
            return car.get(*UNKNOWNS)

        expected = np.array([differences(of, at, known, nominals[known]) for known in knowns]).T
        of(at)
        found = jacobian(car, UNKNOWNS, knowns)
        assert np.isfinite(found).all()
        assert_close(found, expected, np.array([nominals[known] for known in knowns]))
        seed = np.random.default_rng(1).normal(size=len(knowns))
        assert car.directional_derivative(UNKNOWNS, knowns, seed) == pytest.approx(found @ seed, rel=1e-9, abs=1e-6)


def test_directional_derivatives_of_the_beginning_are_over_inputs_and_parameters(make_any):
    nominals = {v.name: v.nominal or abs(v.start or 0.0) or 1.0 for v in interface.VARIABLES}
    car = make_any()
    if car.fmu.version == 2:
        car.raw.setupExperiment()
    car.set(v_x_start=20.0, v_y_start=0.5, gamma_start=0.3, steering_angle=0.02)
    car.raw.enterInitializationMode()
    knowns = [*INPUTS, *TUNABLE, *STARTS]
    at = dict(zip(knowns, car.get(*knowns), strict=True))

    def of(values):
        car.set(values)
        return car.get(*UNKNOWNS)

    expected = np.array([differences(of, at, known, nominals[known]) for known in knowns]).T
    of(at)
    found = jacobian(car, UNKNOWNS, knowns)
    assert_close(found, expected, np.array([nominals[known] for known in knowns]))
    assert (found != 0).any(axis=1).sum() > 40
    with pytest.raises(FMICallException):
        car.directional_derivative(["v_x"], ["v_y"], [1.0])
    car.raw.exitInitializationMode()
    assert car.directional_derivative(["v_x", "X"], ["v_y", "X"], [1.0, 2.0]) == pytest.approx([0.0, 2.0])


def test_declared_dependencies_are_exactly_what_derivatives_show(make_any, open_fmu):
    declared = {
        unknown.variable.name: {known.name for known in unknown.dependencies}
        for unknown in (*open_fmu.description.outputs, *open_fmu.description.derivatives)
    }
    knowns = [*STATES, *INPUTS]
    seen = np.zeros((len(UNKNOWNS), len(knowns)), dtype=bool)
    for car in points(make_any, Kind.MODEL_EXCHANGE):
        # A wheel that spins, a body that rolls: at the start neither does.
        x = car.states() + np.random.default_rng(3).normal(size=len(STATES)) * 0.01
        car.set_states(x)
        seen |= jacobian(car, UNKNOWNS, knowns) != 0
    for row, unknown in enumerate(UNKNOWNS):
        assert {known for known, there in zip(knowns, seen[row], strict=True) if there} == declared[unknown], unknown


@BOTH
def test_knowns_and_unknowns_are_checked(make_any, kind):
    car = make_any(kind).start(v_x_start=20.0)
    for unknowns, knowns in (
        (["mu"], ["v_x"]), (["v_x"], ["M"]), (["v_x"], ["der(v_x)"]), (["v_x"], ["a_x"]), (["v_x"], ["solver"]),
        (["time"], ["v_x"]), (["v_x"], ["v_x_start"]), (["v_x"], ["time"]),
    ):  # fmt: skip
        with pytest.raises(FMICallException):
            car.directional_derivative(unknowns, knowns, [1.0])
        assert "is not a known now" in car.said[-1] or "is not an unknown" in car.said[-1]
    assert car.directional_derivative([], [], []).size == 0


def test_derivatives_of_outputs_in_time_are_those_of_short_steps(make_any):
    car = make_any().start(v_x_start=20.0, solver=2, solver_tolerance=1e-12)
    car.set(steering_angle=0.03)
    car.run(0.2)
    names = [*STATES, *OUTPUTS]
    if car.fmu.version == 2:
        n = len(names)
        references, values = (ctypes.c_uint * n)(*car.references(names)), (ctypes.c_double * n)()
        car.raw.fmi2GetRealOutputDerivatives(car.raw.component, references, n, (ctypes.c_int * n)(*([1] * n)), values)
        found = np.array(values)
        with pytest.raises(FMICallException):
            car.raw.fmi2GetRealOutputDerivatives(car.raw.component, references, 1, (ctypes.c_int * 1)(2), values)
    else:
        found = np.array(car.raw.getOutputDerivatives(car.references(names), [1] * len(names)))
        with pytest.raises(FMICallException):
            car.raw.getOutputDerivatives(car.references(["v_x"]), [2])
    assert "order must be 1" in car.said[-1]
    h = 1e-5
    before = car.get(*names)
    car.step(h)
    middle = car.get(*names)
    car.step(h)
    slope = (-3 * before + 4 * middle - car.get(*names)) / (2 * h)
    assert found == pytest.approx(slope, rel=1e-4, abs=1e-3)


# ---- log ----


def test_categories_choose_what_is_logged(make_any):
    car = make_any()
    car.raw.setDebugLogging(True, ["logEvents"])
    car.start()
    assert any("step mode from 0 s on" in line for line in car.said)
    car.raw.setDebugLogging(True, ["logStatusError"])
    count = len(car.said)
    car.terminate()
    assert len(car.said) == count
    with pytest.raises(FMICallException):
        car.raw.setDebugLogging(True, ["noSuchCategory"])
    assert "no log category noSuchCategory" in car.said[-1]
    categories = [category.name for category in car.fmu.description.logCategories]
    for category in categories:
        car.raw.setDebugLogging(True, [category])
    assert categories == ["logStatusError", "logEvents", "logAll"]
    car.raw.setDebugLogging(True, [])
    car.reset()
    count = len(car.said)
    car.start()
    assert len(car.said) > count
