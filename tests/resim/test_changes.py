"""What a review of a changed controller, or a changed log, shows."""

import resource

import pytest

from bench.bus.codec import load_codecs
from bench.cycle import CYCLE_NS
from bench.errors import BadInput, RunFailed
from bench.record.compare import diff
from bench.record.reader import Run
from bench.resim.plan import make_plan
from bench.resim.rewrite import write
from bench.resim.text import describe
from tests.reference.__main__ import FOLDER
from tests.resim.conftest import CONTROLLERS, rerun
from tests.resim.controllers import CYCLE, NUDGE_RAD

FIVE = FOLDER / "five.mcap"
CODECS = load_codecs(5)
STEERING, FRONT, MOTION = 0x300, 0x301, 0x102


def changed(name):
    return [f"tracker={CONTROLLERS}:{name}"]


def test_a_changed_parameter_is_found_with_the_first_cycle_its_signal_and_the_inputs():
    (outcome,) = rerun(FIVE, "veh2.tracker", classes=changed("OtherParameter"))
    assert not outcome.same
    # In the first cycle there is nothing yet for the observer to correct; in the second that shows in a command, before
    # its estimate is sent again.
    assert outcome.first is not None
    assert outcome.first.cycle == 1
    assert outcome.first.inputs is not None
    assert "TrackerDisturbance" in {signal.message for signal in outcome.signals}
    text = describe(outcome, CODECS)
    assert "veh2.tracker: DIFFERENT from 0.010 s on: " in text
    assert "veh2 VehicleMotion: VelocityX 2" in text
    assert "rad/s^2" in text


def test_a_change_is_told_from_when_how_often_and_by_how_much():
    (outcome,) = rerun(FIVE, "veh1.tracker", classes=changed("Nudged"), tolerances=())
    signal = next(signal for signal in outcome.signals if signal.signal == "SteeringAngle")
    assert (signal.message, signal.first_s, signal.count, signal.unit) == ("SteeringCommand", 0.3, 70, "rad")
    assert signal.largest == pytest.approx(NUDGE_RAD, abs=2.1e-6)


def test_within_a_tolerance_it_is_the_same_and_still_told():
    wide = [
        f"SteeringCommand.SteeringAngle={2 * NUDGE_RAD}",
        "2",
        "TrackerStatus.Iterations=6",
        "TrackerStatus.Tau=0.01",
    ]
    (outcome,) = rerun(FIVE, "veh1.tracker", classes=changed("Nudged"), tolerances=wide)
    assert outcome.same
    assert outcome.differing >= 70
    assert "within the tolerance: " in describe(outcome, CODECS)
    narrow = [f"SteeringCommand.SteeringAngle={NUDGE_RAD / 2}", *wide[1:]]
    (outcome,) = rerun(FIVE, "veh1.tracker", classes=changed("Nudged"), tolerances=narrow)
    assert outcome.beyond == 70


def test_a_frame_that_is_flipped_in_the_log_is_reported(reworked):
    def flip(frame):
        if (frame.bus, frame.can_id, frame.time_ns) == ("veh1", FRONT, 30 * CYCLE_NS):
            return [frame._replace(data=frame.data[:3] + bytes([frame.data[3] ^ 0x40]) + frame.data[4:])]
        return [frame]

    (outcome,) = rerun(reworked("five", flip), "veh1.tracker")
    assert outcome.beyond == 1
    assert outcome.first is not None
    assert (outcome.first.cycle, outcome.first.pair.can_id) == (30, FRONT)
    assert [signal.signal for signal in outcome.signals if signal.message == "TorqueCommandFront"] == ["TorqueFL"]


def test_a_frame_that_is_missing_or_too_many_is_reported(reworked):
    def change(frame):
        if (frame.bus, frame.time_ns) == ("veh1", 30 * CYCLE_NS) and frame.can_id in (STEERING, FRONT):
            return [] if frame.can_id == STEERING else [frame, frame]
        return [frame]

    (outcome,) = rerun(reworked("five", change), "veh1.tracker")
    assert outcome.beyond == 2
    assert sorted(outcome.alone) == [
        "veh1 SteeringCommand: from 0.300 s, 1 frame is sent that the log does not have",
        "veh1 TorqueCommandFront: from 0.300 s, 1 frame of the log is not sent",
    ]


def test_an_input_that_never_came_leaves_the_ecu_waiting(reworked):
    def change(frame):
        return [] if (frame.bus, frame.can_id) == ("veh1", MOTION) and frame.time_ns >= 50 * CYCLE_NS else [frame]

    (outcome,) = rerun(reworked("five", change), "veh1.tracker")
    assert outcome.first is not None
    assert (outcome.first.cycle, outcome.first.inputs, outcome.steps) == (50, None, 50)
    assert "it did no step in this cycle" in describe(outcome, CODECS)


def test_an_ecu_that_fails_does_so_in_one_line_and_the_others_go_on():
    outcomes = rerun(FIVE, "veh1.tracker", "veh2.tracker", classes=changed("Killed"))
    assert [outcome.same for outcome in outcomes] == [True, False]
    assert outcomes[1].error == "its process ended by SIGKILL"
    (outcome,) = rerun(FIVE, "veh1.tracker", classes=changed("Raising"))
    assert outcome.cycles == CYCLE
    assert not outcome.beyond
    assert "after 0.300 s veh1.tracker failed: ZeroDivisionError: no speed (" in outcome.error
    assert "controllers.py, line " in outcome.error
    (outcome,) = rerun(FIVE, "veh1.tracker", classes=changed("Greedy"))
    assert outcome.bad_input
    assert outcome.error.startswith("veh1.tracker: input Radar does not exist on bus veh1; its DBC has ")


def test_values_that_are_no_numbers_are_told_once(capfd):
    (outcome,) = rerun(FIVE, "veh1.tracker", classes=changed("WithoutAngle"))
    assert outcome.not_numbers == 70
    assert "  70 times a value that it sent is not a number (NaN or infinite); the message is not sent" in describe(
        outcome, CODECS
    )
    assert "NaN" not in capfd.readouterr().err


def test_an_ecu_that_hangs_is_given_up():
    (outcome,) = rerun(FIVE, "veh1.tracker", classes=changed("Hanging"), step_limit_s=5.0)
    assert outcome.error == f"hangs in cycle {CYCLE} (t = 0.300 s): no end within 5 s"
    assert not outcome.same
    (outcome,) = rerun(FIVE, "veh1.tracker", classes=changed("Lingering"))
    assert outcome.same


def test_a_log_in_which_the_ecu_never_ran_fails(reworked):
    silent = reworked("five", lambda frame: [] if frame.bus == "veh3" and frame.can_id >= 0x200 else [frame])
    (outcome,) = rerun(silent, "veh3.tracker")
    assert not outcome.same
    assert outcome.error == "it never ran: the log has no frame of it"
    with pytest.raises(RunFailed, match=r"veh6\.tracker never ran in .*; its ECUs are veh1\.planner, "):
        make_plan(Run(FIVE), ["veh6.tracker"])


def test_what_was_cut_off_is_compared_up_to_there(reworked):
    log = reworked("five", lambda frame: [frame] if frame.time_ns < 40 * CYCLE_NS else [])
    plan = make_plan(Run(log), ["veh1.tracker"])
    assert [job.log.end for job in plan.jobs] == [39]
    assert "the log is incomplete: compared up to 0.39 s" in plan.notes


def test_another_class_than_the_benchs_own_is_not_compared_unasked(reworked):
    log = reworked("five", tracker="mine.py:Mine")
    with pytest.raises(BadInput, match=r"veh1\.tracker ran as mine\.py:Mine; give --class tracker=mine\.py:Mine for"):
        make_plan(Run(log), ["veh1.tracker"])
    plan = make_plan(Run(log), ["veh1.tracker"], classes=["bench.ecu.tracker:TrackerEcu"])
    assert "veh1.tracker ran as mine.py:Mine, and is bench.ecu.tracker:TrackerEcu here" in plan.notes
    assert make_plan(Run(log), ["veh1.planner"]).notes == ()


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        ({"names": []}, "give --all, or --ecu with one of veh1.planner, veh1.tracker"),
        ({"names": ["tracker"]}, "--ecu tracker: not an ECU of this log"),
        ({"classes": ["driver=x:Y"]}, "--class driver=x:Y: write ROLE=CLASS, where ROLE is tracker"),
        ({"classes": ["none.py:Y"]}, "ECU 'none.py:Y' cannot be loaded"),
        ({"tolerances": ["-1"]}, "--tolerance -1: give a number from 0 on"),
        ({"tolerances": ["nan"]}, "--tolerance nan: give a number from 0 on"),
        ({"tolerances": ["Reference.YawRate=1"]}, "these ECUs send no 'Reference', but SteeringCommand, "),
        ({"tolerances": ["2", "TrackerStatus.State=5"]}, "TrackerStatus.State=5: State must be the same, as it is a"),
        ({"tolerances": ["SteeringCommand.AliveCounter=1"]}, "AliveCounter must be the same, as it is a state"),
        ({"tolerances": ["SteeringCommand.CRC=1"]}, "CRC must be the same, as it is a state"),
        ({"tolerances": ["SteeringCommand.Angle=1"]}, "SteeringCommand has no signal 'Angle'; it has SteeringAngle"),
    ],
)
def test_bad_input_is_refused_in_words(options, complaint):
    with pytest.raises(BadInput) as refusal:
        make_plan(Run(FIVE), **{"names": ["veh1.tracker"], **options})
    assert complaint in str(refusal.value)


def test_the_log_as_it_would_be_has_the_new_frames_and_all_others_as_they_were(tmp_path):
    plan = make_plan(Run(FIVE), ["veh1.tracker"], classes=changed("Nudged"))
    outcomes = rerun(FIVE, "veh1.tracker", classes=changed("Nudged"))
    write(plan, [], tmp_path / "as_it_was.mcap", "test")
    write(plan, outcomes, tmp_path / "as_it_would_be.mcap", "test")
    frames = [
        [(frame.time_ns, frame.bus, frame.can_id, frame.data) for frame in Run(path).frames()]
        for path in (FIVE, tmp_path / "as_it_was.mcap")
    ]
    assert frames[0] == frames[1]
    difference = diff(tmp_path / "as_it_was.mcap", tmp_path / "as_it_would_be.mcap")
    assert difference.first is not None
    steered = [signal for signal in difference.signals if signal.signal == "SteeringAngle"]
    assert [(signal.bus, signal.message, signal.first_s, signal.count) for signal in steered] == [
        ("veh1", "SteeringCommand", 0.3, 70)
    ]
    written = Run(tmp_path / "as_it_would_be.mcap")
    assert "veh1.tracker" in written.metadata["resimulated"]
    assert written.metadata["label"] == f"{FIVE.name}, resim of veh1.tracker"
    assert written.scenario == Run(FIVE).scenario


def test_the_log_as_it_would_be_is_that_of_the_new_class(reworked, tmp_path):
    sync, timing = (CODECS["veh1"].can_id(name) for name in ("BenchSync", "TrackerTiming"))

    def timed(frame):
        times = frame.can_id == sync and frame.bus in ("veh1", "veh2")
        return [frame, frame._replace(can_id=timing, data=bytes(8))] if times else [frame]

    own, new = "bench.ecu.tracker:TrackerEcu", f"{CONTROLLERS}:Nudged"
    log, one, every = reworked("five", timed), tmp_path / "one.mcap", tmp_path / "every.mcap"
    plan = make_plan(Run(log), ["veh1.tracker"], classes=changed("Nudged"))
    write(plan, rerun(log, "veh1.tracker", classes=changed("Nudged")), one, "test")
    metadata = Run(one).metadata
    assert "ecu tracker" not in metadata
    assert [metadata[f"ecu veh{vehicle}.tracker"] for vehicle in (1, 2)] == [new, own]
    # What the old class took of the processor is not what the new one does.
    timed_after = [bus for bus in ("veh1", "veh2") if timing in Run(one).frame_table(bus)["can_id"]]
    assert timed_after == ["veh2"]
    with pytest.raises(BadInput, match=r"veh1\.tracker ran as .*controllers\.py:Nudged; give --class"):
        make_plan(Run(one), ["veh1.tracker"])
    (again,) = rerun(one, "veh1.tracker", classes=changed("Nudged"))
    assert not again.differing
    back = make_plan(Run(one), ["veh1.tracker"], classes=[f"tracker={own}"])
    write(back, rerun(one, "veh1.tracker", classes=[f"tracker={own}"]), every, "test")
    assert {key: spec for key, spec in Run(every).metadata.items() if key.startswith("ecu ") and "tracker" in key} == {
        "ecu tracker": own
    }


def test_a_log_that_cannot_be_written_whole_is_not_there(tmp_path):
    plan = make_plan(Run(FIVE), ["veh1.tracker"])
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    # Half of the file; a full disk is the same to who writes.
    resource.setrlimit(resource.RLIMIT_FSIZE, (FIVE.stat().st_size // 2, limits[1]))
    try:
        with pytest.raises(BadInput, match=r"cannot write .*/new\.mcap: File too large"):
            write(plan, [], tmp_path / "new.mcap", "test")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert list(tmp_path.iterdir()) == []


def test_an_ecu_of_which_nothing_is_left_to_compare_fails(reworked):
    def only_at_the_end(frame):
        sent = frame.bus == "veh1" and (0x300 <= frame.can_id < 0x400 or 0x510 <= frame.can_id < 0x520)
        return [] if frame.time_ns >= 40 * CYCLE_NS or (sent and frame.time_ns < 39 * CYCLE_NS) else [frame]

    (outcome,) = rerun(reworked("five", only_at_the_end), "veh1.tracker")
    assert not outcome.same
    assert outcome.error == "it sent nothing in the cycles that could be compared"
