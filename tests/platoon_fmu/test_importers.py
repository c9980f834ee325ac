"""Other importers than our own: libcosim drives the FMU to the same bits, and fmpy's solvers to the same motion."""

from __future__ import annotations

import fmpy
import numpy as np
import pytest

from platoon_fmu.importer import Instance, Kind

START = {"v_x_start": 20.0, "v_y_start": 0.2, "gamma_start": 0.05, "X_start": 3.0, "M": 1800.0, "mu": 0.7}
STEP_NS = 10_000_000


def inputs(i):
    """Those of the i-th step."""
    return {
        "steering_angle": 0.01 * (i % 7) - 0.02,
        "wheel_torque_fl": 40.0 * (i % 3),
        "wheel_torque_rr": -25.0 * (i % 4),
        "force_x": 100.0 * (i % 5),
        "mu": 0.7 - 0.001 * i,
    }


# ---- libcosim ----


@pytest.fixture(scope="module")
def cosim():
    """The package, where it loads here: its library is made for glibc."""
    pytest.importorskip("libcosimpy", reason="libcosimpy is not installed")
    from libcosimpy import CosimExecution, CosimLogging, CosimManipulator, CosimObserver, CosimSlave, _internal

    try:
        _internal.libcosimc()
    except OSError as error:
        pytest.skip(f"libcosim does not load here: {error}")
    CosimLogging.log_output_level(CosimLogging.CosimLogLevel.FATAL)
    return (
        CosimExecution.CosimExecution,
        CosimSlave.CosimLocalSlave,
        CosimManipulator.CosimManipulator,
        CosimObserver.CosimObserver,
    )


class Cosim:
    """The FMU in libcosim, a step of 10 ms at a time."""

    def __init__(self, cosim, path, references):
        execution, slave, manipulator, observer = cosim
        self._references = references
        self._execution = execution.from_step_size(STEP_NS)
        self._slave = slave(str(path), "car")
        self._index = self._execution.add_local_slave(self._slave)
        assert self._index >= 0
        self._manipulator, self._observer = manipulator.create_override(), observer.create_last_value()
        assert self._execution.add_manipulator(self._manipulator)
        assert self._execution.add_observer(self._observer)

    def start(self, values):
        for name, value in values.items():
            assert self._execution.real_initial_value(self._index, self._references[name], value)

    def step(self, values):
        references = [self._references[name] for name in values]
        assert self._manipulator.slave_real_values(self._index, references, list(values.values()))
        assert self._execution.step()

    def get(self, names):
        return self._observer.last_real_values(self._index, [self._references[name] for name in names])

    def time(self):
        """Of libcosim [ns]."""
        return self._execution.status().current_time


def test_libcosim_gets_the_bits_that_fmpy_gets(cosim, fmu_path, open_fmu2):
    variables = open_fmu2.description.modelVariables
    references = {v.name: v.valueReference for v in variables}
    # libcosim has no enumerations: it drives the default solver.
    names = [v.name for v in variables if v.causality in ("output", "local", "input", "independent")]
    assert len(names) > 60
    other = Cosim(cosim, fmu_path, references)
    other.start(START)
    seen = []
    with Instance(open_fmu2, Kind.CO_SIMULATION) as car:
        car.start(START)
        for i in range(300):
            other.step(inputs(i))
            car.set(inputs(i))
            # libcosim counts nanoseconds, and gives the FMU their difference in seconds.
            begin, end = i * STEP_NS / 1e9, (i + 1) * STEP_NS / 1e9
            car.time = begin
            car.step(end - begin)
            assert other.time() == (i + 1) * STEP_NS
            theirs, ours = other.get(names), list(car.get(*names))
            differing = [name for name, a, b in zip(names, theirs, ours, strict=True) if a != b]
            assert differing == [], f"after step {i}"
            seen.append(ours)
    moved = dict(zip(names, np.ptp(seen, axis=0), strict=True))
    assert moved["X"] > 50.0
    assert min(moved[name] for name in ("v_x", "v_y", "gamma", "phi", "F_y_fl", "omega_rr")) > 0.0


# ---- fmpy ----

OUTPUTS = ["X", "Y", "psi", "phi", "v_x", "v_y", "gamma", "p", "omega_fl", "omega_rr", "a_x", "a_y", "F_y_fl", "F_z_rr"]


def simulate(path, kind, **options):
    """A lane change in 4 s with inputs that are constant for half a second each."""
    steering = [0.0, 0.02, 0.04, 0.0, -0.04, -0.02, 0.0, 0.0]
    torque = [0.0, 100.0, 100.0, 0.0, 0.0, -100.0, -50.0, 0.0]
    rows = [(t, *values) for i, values in enumerate(zip(steering, torque, strict=True)) for t in (i / 2, (i + 1) / 2)]
    return fmpy.simulate_fmu(
        str(path),
        fmi_type=kind,
        start_values=START,
        input=np.array(rows, dtype=[("time", float), ("steering_angle", float), ("wheel_torque_fl", float)]),
        stop_time=4.0,
        output_interval=0.01,
        output=OUTPUTS,
        **options,
    )


def test_fmpy_drives_both_versions_of_the_slave_to_the_same_bits(fmu_path, fmu3_path):
    ours, other = simulate(fmu_path, "CoSimulation"), simulate(fmu3_path, "CoSimulation")
    assert len(ours) == 401
    assert ours.tobytes() == other.tobytes()
    assert np.ptp(ours["Y"]) > 1.0


def test_fmpy_integrates_both_versions_of_the_model_to_the_same_bits(fmu_path, fmu3_path):
    options = {"solver": "CVode", "relative_tolerance": 1e-8}
    ours, other = simulate(fmu_path, "ModelExchange", **options), simulate(fmu3_path, "ModelExchange", **options)
    assert len(ours) >= 401
    assert ours.tobytes() == other.tobytes()


def test_cvode_and_the_own_solver_agree(fmu3_path):
    cosimulation = simulate(fmu3_path, "CoSimulation")
    exchange = simulate(fmu3_path, "ModelExchange", solver="CVode", relative_tolerance=1e-8)
    # A step of the inputs has two rows in Model Exchange, before and after it: there the two may differ.
    between = np.abs(cosimulation["time"] * 2 - np.round(cosimulation["time"] * 2)) > 1e-6
    at = np.searchsorted(exchange["time"], cosimulation["time"] + 1e-9, side="right") - 1
    assert between.sum() > 380
    for name in OUTPUTS:
        largest = np.abs(cosimulation[name]).max()
        difference = np.abs(exchange[name][at] - cosimulation[name])[between]
        assert difference.max() < 1e-4 * largest, name
