"""The benchmarks' FMU part runs, and its tables are whole. How fast anything is, is not tested."""

import io
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from bench.benchmarks import bus, commonroad, figures
from bench.benchmarks.fmu import Effort, binary_figures, python_figures, size_table, sizes
from bench.benchmarks.prepared import PreparedCalls
from bench.benchmarks.timing_host import TimingHost
from bench.errors import RunFailed
from platoon_fmu.build import build
from platoon_fmu.importer import Instance, Kind, opened
from platoon_fmu.versions import FMI2, FMI3

LITTLE = Effort(rounds=2, right_hand_sides=20, jacobians=2, steps=4, instances=3)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("fmus")
    return [build(folder, version=version) for version in (FMI2, FMI3)]


@pytest.fixture(scope="module")
def fmus(files):
    with opened(files[0]) as fmu2, opened(files[1]) as fmu3:
        yield fmu2, fmu3


@pytest.fixture(scope="module")
def host(fmus, tmp_path_factory):
    return TimingHost(*fmus, tmp_path_factory.mktemp("host"))


def assert_whole(found, titles):
    assert [figure.title.strip() for figure in found] == titles
    for figure in found:
        assert all(math.isfinite(value) and value > 0.0 for value in (figure.least, figure.median, figure.high))
    assert all(figure.least <= figure.median <= figure.high for figure in found if not figure.is_ratio)
    assert figures.table_of("title", found).row_count == len(titles)


def printed(table):
    file = io.StringIO()
    Console(width=120, file=file).print(table)
    return file.getvalue()


def test_the_binarys_figures(host, fmus):
    assert_whole(
        binary_figures(host, *fmus, LITTLE),
        [
            "right-hand side: the model alone",
            "right-hand side: Model Exchange, states set, derivatives got",
            "step of 10 ms, FMI 2.0 Co-Simulation: ten steps of Runge-Kutta 4",
            "the same of FMI 3.0",
            "the same of each of 3 instances (FMI 2.0)",
            "over that of a single one",
            "Jacobian of the states: directional derivatives",
            "from central differences",
            "directional derivatives over differences",
        ],
    )


def test_pythons_figures(files, fmus):
    over = "over plain ctypes"
    assert_whole(
        python_figures(fmus[0], files[0], LITTLE),
        [
            "plain ctypes, arrays allocated once",
            "fmpy's functions, arrays allocated once",
            over,
            "the bench's plant: the same, values in and out as lists",
            over,
            "fmpy's setReal, doStep, getReal: new arrays at every call",
            over,
        ],
    )


def test_all_ways_to_call_do_the_same(fmus):
    ends = []
    for way in ("by_ctypes", "by_fmpy", "by_fmpys_lists"):
        with Instance(fmus[0], Kind.CO_SIMULATION) as vehicle:
            vehicle.start({"v_x_start": 20.0, "steering_angle": 0.02})
            step = getattr(PreparedCalls(vehicle), way)()
            for number in range(10):
                step(number * 0.01, 0.01)
            ends.append(vehicle.get(*vehicle.state_names))
    np.testing.assert_array_equal(ends[1], ends[0])
    np.testing.assert_array_equal(ends[2], ends[0])
    assert ends[0][0] > 1.9


def test_a_refused_call_is_no_time(host, fmus):
    with Instance(fmus[0], Kind.CO_SIMULATION) as vehicle:
        not_started = host.steps([vehicle], 0.01, 1)
        with pytest.raises(RunFailed, match="refused a call of time_steps_2"):
            not_started()


def test_sizes_name_each_fmu_once(files):
    found = sizes({"two": files[0], "three": files[1], "two again": files[0]})
    assert [size.name for size in found] == ["two", "three"]
    assert all(size.packed > 0 and size.largest_binary > 0 and size.platforms for size in found)
    assert size_table(found).row_count == 2


def test_the_comparison_is_at_equal_accuracy(fmus):
    pytest.importorskip("vehiclemodels")
    manoeuvre = commonroad.MANOEUVRES[1]
    solvers = [commonroad.ScipySolver("odeint", tolerance, tolerance) for tolerance in (1e-3, 1e-5)]
    rows = commonroad.comparisons(fmus[0], manoeuvre, accuracies=(1e-3,), solvers=solvers, rounds=1)
    assert [row.step_s for row in rows] == [*manoeuvre.steps_s] * 2
    for row in rows:
        assert 0.0 < row.ours.error <= row.accuracy
        assert 0.0 < row.theirs.error <= row.accuracy
        assert np.isfinite([row.our_seconds, row.their_seconds]).all()
        assert min(*row.our_seconds, *row.their_seconds) > 0.0
    text = printed(commonroad.table_of(rows))
    assert text.count("step steer") == len(rows)


def test_without_the_package_there_is_a_message(fmus, monkeypatch):
    monkeypatch.setitem(sys.modules, "vehiclemodels.vehicle_dynamics_mb", None)
    assert "pip install commonroad-vehicle-models" in commonroad.table(fmus[0])


@pytest.mark.parametrize(
    ("seconds", "text"), [(2.0, "2 s"), (1.5e-3, "1.5 ms"), (6.54e-6, "6.54 µs"), (1.5e-10, "0.15 ns")]
)
def test_times_have_three_digits_and_a_unit(seconds, text):
    assert figures.seconds_text(seconds) == text


def test_measures_are_taken_in_turns():
    taken = []
    measures = {name: lambda name=name: taken.append(name) or 1.0 for name in "abc"}
    samples = figures.in_turns(measures, rounds=2)
    assert "".join(taken) == "abc" + "abc" + "bca"
    assert all(len(values) == 2 for values in samples.values())


def test_an_unknown_part_is_refused():
    command = [sys.executable, "-m", "bench.benchmarks", "engine"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=Path(__file__).parents[1])
    assert done.returncode == 2
    assert "loop" in done.stderr
    assert "fmu" in done.stderr


def test_the_buss_figures():
    coded = ["encode, with E2E", "cantools, without E2E", "decode", "cantools"]
    assert_whole(bus.coding(rounds=2), coded)
    trips = ["python-can on both sides, echo", "the bench, an empty ECU", "ratio"]
    assert_whole(bus.round_trips("udp", trips=3, rounds=2), trips)


def test_recording_loses_nothing():
    table = printed(bus.recording(seconds=2, per_s=2_000))
    (row,) = [line.split("│")[1:5] for line in table.splitlines() if line.startswith("│")]
    assert [int(cell) for cell in row] == [4000, 4000, 4000, 0]
