"""A sample belongs to the part of the bench whose code it is in, interpreted or compiled."""

import pytest

from bench.benchmarks.against.profile import OTHER, PARTS, part_of, samples_by_part, shares

LOOP = "main (bench/cli/main.py:90);Lockstep.run (bench/conductor/lockstep.py:60);Node.poll (bench/bus/node.py:200)"
SUFFIX = "cpython-311-x86_64-linux-gnu.so"


@pytest.mark.parametrize(
    ("frames", "part"),
    [
        ("", "links and nodes"),
        (";step (bench/ecu/tracker.py:90)", "ECU around the control"),
        (";step (bench/ecu/tracker.py:90);solve (bench/control/rmpc.py:50)", "tracker's control"),
        (f";step (bench.ecu.tracker.{SUFFIX});solve (bench.control.rmpc.{SUFFIX})", "tracker's control"),
        (f";solve (bench.control.rmpc.{SUFFIX});dgemm (numpy/_core/_multiarray_umath.{SUFFIX})", "tracker's control"),
        (";solve (bench/control/rmpc.py:50);clarabel::solve (clarabel/clarabel.abi3.so)", "tracker's control"),
        (";search (/home/a/bench/control/genetic.py:50)", "planner's search"),
        (";step (bench/ecu/planner.py:50)", "planner"),
        (";plan (bench/control/planner.py:50);<lambda> (bench/control/flocking.py:1)", "planner"),
        (";send (bench/bus/outbox.py:5);crc (bench/bus/e2e.py:3)", "outbox"),
        (f";take (bench.bus.inbox.{SUFFIX});crc (bench.bus.e2e.{SUFFIX})", "inbox"),
        (";send (bench/bus/outbox.py:5);encode (bench/bus/codec.py:3)", "codec"),
        (";send (bench/bus/link/udp.py:5);sendto (libc.so.6)", "links and nodes"),
        (";step (bench/plant/plant.py:5);doStep (platoon_fmu/importer.py:3);0x7f ([vdso])", "plant"),
    ],
)
def test_the_innermost_frame_of_ours_says_the_part(frames, part):
    assert part_of(LOOP + frames) == part


@pytest.mark.parametrize(
    "module", ["record/writer", "mcap/chunking", "bus/wire/timing", "conductor/recorder", "record/exchange/csv"]
)
def test_recording_is_one_part(module):
    assert part_of(f"{LOOP};write (bench/{module}.py:5)") == "recorder"


@pytest.mark.parametrize("stack", ["main (bench/cli/main.py:90)", "_find_and_load (<frozen importlib>:1)", ""])
def test_what_is_in_no_part_is_other(stack):
    assert part_of(stack) == OTHER


def test_samples_are_added_up():
    lines = [f"{LOOP};a (bench/bus/codec.py:1) 3", f"{LOOP};b (bench/bus/codec.py:9) 4", "main (x.py:1) 2"]
    assert samples_by_part(lines) == {"codec": 7, OTHER: 2}


def test_shares_are_of_what_the_longer_run_took_more():
    found = shares({"codec": 50, "plant": 30, OTHER: 40}, {"codec": 20, OTHER: 45, "plant": 20})
    assert found.pop("codec") == pytest.approx(0.75)
    assert found.pop("plant") == pytest.approx(0.25)
    assert set(found.values()) == {0.0}
    assert set(found) <= {OTHER, *(name for name, _ in PARTS)}
    assert set(shares({}, {}).values()) == {0.0}
