"""The FMU under stress: no memory, millions of steps, a thousand instances, many threads."""

from __future__ import annotations

import re
import sys

import pytest

from platoon_fmu.importer import Instance, Kind

from .hosting import COUNTED, HELGRIND, PACKED, SANITIZED, THREAD_SANITIZED, VALGRIND, workshop_in

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="the host loads binaries as Linux does")

BOTH = pytest.mark.parametrize("kind", Kind, ids=["ME", "CS"])
# What a simulation of a thousand vehicles can spare for each [bytes].
MOST_BYTES = 10_000
ERROR = "3 "


@pytest.fixture(scope="module")
def workshop(tmp_path_factory):
    return workshop_in(tmp_path_factory.getbasetemp())


def heap(text):
    """Bytes, blocks and allocations as the host's allocator has counted them."""
    found = re.fullmatch(r"(\d+) bytes, (\d+) blocks, (\d+) allocations", text)
    assert found, text
    return tuple(map(int, found.groups()))


# ---- memory ----


@BOTH
def test_an_instance_is_small_and_its_freeing_complete(workshop, open_fmu, kind):
    output = workshop.host(open_fmu, COUNTED).run(kind, "growth", 10)
    taken, blocks, allocations = heap(output["instance"])
    assert 0 < taken <= MOST_BYTES
    assert blocks == allocations
    kept, _, _ = heap(output["kept"])
    assert taken < kept <= taken + MOST_BYTES
    assert heap(output["end"])[:2] == (0, 0)


@BOTH
def test_a_million_steps_take_no_memory_and_saved_states_give_theirs_back(workshop, open_fmu, kind):
    steps = 1_000_000
    output = workshop.host(open_fmu, COUNTED).run(kind, "growth", steps)
    taken, blocks, _ = heap(output["instance"])
    assert output.reals("time") == [pytest.approx(1000.0)]
    assert heap(output["stepped"]) == (taken, blocks, 0)
    # One allocation for each state that was saved anew, none for those saved over another, and nothing is left of them.
    assert heap(output["saved"]) == (*heap(output["kept"])[:2], steps // 10 + 1)
    assert heap(output["end"])[:2] == (0, 0)


@BOTH
@pytest.mark.parametrize(
    ("make", "under"), [(COUNTED, ()), (COUNTED, VALGRIND), (SANITIZED, ())], ids=["", "valgrind", "sanitizers"]
)
def test_without_memory_there_is_no_instance_and_the_one_there_is_goes_on(workshop, open_fmu, kind, make, under):
    output = workshop.host(open_fmu, make).run(kind, "no_memory", 2, under)
    _, blocks, _ = heap(output["instance"])
    wanting = [text for label, text in output.lines if label.startswith("no block")]
    assert len(wanting) == blocks > 0
    assert len(output.all("left")) == blocks
    assert all(heap(text)[:2] == (0, 0) for text in output.all("left"))
    for text in (*wanting, output["save"], output["deserialize"]):
        assert text.startswith(ERROR)
        assert text.endswith("out of memory.")
    assert output["state"] == "none"
    assert heap(output["end"])[:2] == (0, 0)

    plenty = workshop.host(open_fmu, PACKED).run(kind, "no_memory", 2)
    for label in ("in need", "still in need"):
        assert output[label] == plenty[label]


# ---- many ----


def assert_each_goes_as_alone(output, n):
    assert output["members"] == output["as alone"] == str(n)
    # They differ from one another, so that a mix-up would show.
    assert output["as their neighbours"] == "0"


@BOTH
def test_a_thousand_instances_do_not_disturb_each_other(workshop, open_fmu, kind):
    output = workshop.host(open_fmu, PACKED).run(kind, "crowd", 1000)
    assert_each_goes_as_alone(output, 1000)


def test_the_last_of_the_thousand_goes_as_in_fmpy(workshop, open_fmu):
    output = workshop.host(open_fmu, PACKED).run(Kind.CO_SIMULATION, "crowd", 1000)
    i = 999
    variables = open_fmu.description.modelVariables
    names = [v.name for v in variables if v.causality in ("output", "local")]
    with Instance(open_fmu, Kind.CO_SIMULATION) as car:
        car.start({"v_x_start": 10.0 + 0.01 * i, "M": 1500.0 + i, "solver": 1 + i % 2}, tolerance=1e-7)
        for k in range(i, i + 12):
            car.set(
                steering_angle=0.01 * (k % 7) - 0.02,
                wheel_torque_fl=40.0 * (k % 3),
                wheel_torque_rr=-25.0 * (k % 4),
                force_x=100.0 * k,
            )
            car.step(0.01)
        assert output.reals("last") == list(car.get(*names))


@BOTH
def test_threads_do_not_disturb_each_other(workshop, open_fmu, kind):
    output = workshop.host(open_fmu, PACKED).run(kind, "threads", 50)
    assert_each_goes_as_alone(output, 8 * 50)


@BOTH
@pytest.mark.parametrize(("make", "under"), [(PACKED, HELGRIND), (THREAD_SANITIZED, ())], ids=["helgrind", "tsan"])
def test_no_checker_finds_threads_at_the_same_memory(workshop, open_fmu, kind, make, under):
    output = workshop.host(open_fmu, make).run(kind, "threads", 2, under)
    assert_each_goes_as_alone(output, 8 * 2)
