"""ECUs run again on logs of the wall clock, made of a reference log with times of receipt of our own."""

import pytest

from bench.bus.codec import load_codecs
from bench.bus.states import BenchCommand
from bench.bus.sync import BENCH_SYNC
from bench.bus.topic import Topic
from bench.cycle import CYCLE_NS
from bench.record.reader import Run
from bench.resim.plan import make_plan
from bench.resim.rewrite import write
from bench.resim.text import describe
from tests.resim.conftest import rerun

CODECS = load_codecs(5)
SYNC_ID, REFERENCE_ID = 0x10, 0x200
BEGAN_NS = 1_700_000_000_000_000_000
ENDED_ID = 0
"""Command of the BenchSync that ends a run."""


def received(frame, late_ns=0):
    """The frame of a real-time log: sensors come 0.3 ms into the cycle, planners send at 1 ms, trackers at 6 ms."""
    sensors, planners, trackers = 300_000, 1_000_000, 6_000_000
    can_id = frame.can_id
    if can_id == SYNC_ID:
        codec = CODECS[frame.bus]
        values = codec.decode(can_id, frame.data)[1]
        if values["Command"] != ENDED_ID:
            command = {**values, "Command": BenchCommand.RUN_REALTIME}
            frame = frame._replace(data=codec.encode(BENCH_SYNC, command, frame.time_ns // CYCLE_NS)[1])
        into_cycle = 0
    elif frame.bus != "v2v" and can_id < REFERENCE_ID:
        into_cycle = sensors
    elif frame.bus != "v2v" and (0x300 <= can_id < 0x400 or 0x510 <= can_id < 0x520):
        into_cycle = trackers
    else:
        into_cycle = planners
    return frame._replace(receive_ns=BEGAN_NS + frame.time_ns + into_cycle + late_ns)


def test_what_came_in_time_is_answered_with_the_same_bytes(reworked, tmp_path):
    log = reworked("five", lambda frame: [received(frame)])
    outcomes = rerun(log, "veh1.tracker", "veh2.planner")
    for outcome in outcomes:
        assert outcome.same, describe(outcome, CODECS)
        assert (outcome.cycles, outcome.steps) == (100, 100)
    write(make_plan(Run(log), ["veh1.tracker"]), outcomes[:1], tmp_path / "new.mcap", "test")
    notes = make_plan(Run(tmp_path / "new.mcap"), ["veh1.tracker"]).notes
    told = "computing times of these ECUs: veh1.tracker (bench.ecu.tracker:TrackerEcu);"
    assert [note for note in notes if told in note]


@pytest.mark.parametrize("late_ns", [4_900_000, 5_100_000])
def test_what_came_after_a_step_was_no_input_of_it(reworked, late_ns):
    def late(frame):
        is_late = (frame.bus, frame.can_id, frame.time_ns) == ("veh1", REFERENCE_ID, 50 * CYCLE_NS)
        return [received(frame, late_ns if is_late else 0)]

    (outcome,) = rerun(reworked("five", late), "veh1.tracker")
    if late_ns < 5_000_000:
        assert outcome.same, describe(outcome, CODECS)
        return
    assert outcome.first is not None
    assert outcome.first.cycle == 50
    assert outcome.first.inputs is not None
    missing = [topic for topic, signals in outcome.first.inputs.items() if signals is None]
    assert missing == [Topic("veh1", "Reference")]


@pytest.mark.parametrize(("late_ms", "longest_us", "same"), [(4.4, 0, True), (4.4, 800, False), (3.9, 3000, True)])
def test_a_step_may_have_taken_what_the_longest_of_its_times_did_but_waited_for_its_inputs(
    reworked, late_ms, longest_us, same
):
    """A reference comes before the tracker's answer, but after the tracker has waited 5 ms for it; it answers at 6 ms.

    The times on the bus are the longest of several steps: one that had all its inputs early may have begun late.
    """
    codec = CODECS["veh1"]
    timing = codec.can_id("TrackerTiming")

    def change(frame):
        is_late = (frame.bus, frame.can_id, frame.time_ns) == ("veh1", REFERENCE_ID, 48 * CYCLE_NS)
        after = [received(frame, round(late_ms * 1e6) if is_late else 0)]
        if frame.bus == "veh1" and frame.can_id == SYNC_ID and frame.time_ns % (5 * CYCLE_NS) == 0:
            data = codec.encode("TrackerTiming", codec.start_values("TrackerTiming") | {"StepTime": longest_us})[1]
            late = BEGAN_NS + frame.time_ns + 6_000_000
            after.append(frame._replace(can_id=timing, data=data, receive_ns=late))
        return after

    (outcome,) = rerun(reworked("five", change), "veh1.tracker")
    assert outcome.same is same, describe(outcome, CODECS)
    assert same or (outcome.first is not None and outcome.first.cycle == 48)


def test_a_cycle_that_an_ecu_missed_is_left_out(reworked):
    def miss(frame):
        sent = frame.bus == "veh1" and (0x300 <= frame.can_id < 0x400 or 0x510 <= frame.can_id < 0x520)
        return [] if sent and frame.time_ns == 99 * CYCLE_NS else [received(frame)]

    (outcome,) = rerun(reworked("five", miss), "veh1.tracker")
    assert outcome.same, describe(outcome, CODECS)
    assert (outcome.cycles, outcome.steps) == (99, 99)
