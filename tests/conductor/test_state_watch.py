"""Changes of state on the bus become events."""

import pytest

from bench.bus.codec import load_codecs
from bench.bus.states import Cause, EcuState
from bench.conductor.state_watch import Change, StateWatch
from bench.control.outcome import Limit
from bench.events import CauseChange, HardBraking, StateChange, Uncomfortable

CODECS = load_codecs(1)


def shown(watch: StateWatch, message: str, **signals: float) -> Change | None:
    codec = CODECS["veh1"]
    found = list(watch.changes("veh1", *codec.encode(message, {**codec.start_values(message), **signals})))
    assert len(found) <= 1
    return found[0] if found else None


def test_each_change_is_told_once_with_its_cause() -> None:
    watch = StateWatch(CODECS)
    names = {"PlannerStatus", "TrackerStatus", "ActuatorStatus"}
    assert set(watch.watched) == {("veh1", CODECS["veh1"].can_id(name)) for name in names}
    assert shown(watch, "TrackerStatus", State=0) is None
    assert shown(watch, "TrackerStatus", State=1) == StateChange("info", "veh1.tracker", "init", "run", "", "")
    assert shown(watch, "TrackerStatus", State=1, Tau=2.0) is None
    causes = CODECS["veh1"].message("TrackerStatus").get_signal_by_name("Cause").choices
    cause = max(causes)
    degraded = shown(watch, "TrackerStatus", State=2, Cause=cause)
    assert degraded == StateChange("warning", "veh1.tracker", "run", "degraded", str(causes[cause]), "")
    well = StateChange("info", "veh1.tracker", "degraded", "run", "", str(causes[cause]))
    assert shown(watch, "TrackerStatus", State=1) == well


def test_each_change_of_an_ecus_cause_is_told_once_also_if_the_state_stays() -> None:
    watch = StateWatch(CODECS)
    lost = {"State": EcuState.DEGRADED, "Cause": Cause.PEER_LOST}
    assert shown(watch, "PlannerStatus", State=0, Cause=Cause.PEER_MISSING) == CauseChange(
        "info", "veh1.planner", "init", "PeerMissing", ""
    )
    degraded = StateChange("warning", "veh1.planner", "init", "degraded", "PeerMissing", "PeerMissing")
    assert shown(watch, "PlannerStatus", State=2, Cause=Cause.PEER_MISSING) == degraded
    assert degraded.text == "init -> degraded (PeerMissing)"
    change = shown(watch, "PlannerStatus", **lost)
    assert change == CauseChange("warning", "veh1.planner", "degraded", "PeerLost", "PeerMissing")
    assert change.text == "degraded: PeerMissing -> PeerLost"
    assert change.fields == {
        **{"vehicle": 1, "ecu": "veh1.planner", "state": "degraded"},
        **{"cause": "PeerLost", "cause_before": "PeerMissing"},
    }
    assert shown(watch, "PlannerStatus", **lost, SolveTime=0.1) is None
    gone = shown(watch, "PlannerStatus", State=2)
    assert gone == CauseChange("info", "veh1.planner", "degraded", "", "PeerLost")
    assert gone.text == "degraded: PeerLost -> no cause"


def test_senders_are_told_apart() -> None:
    watch = StateWatch(CODECS)
    assert shown(watch, "PlannerStatus", State=3) == StateChange("warning", "veh1.planner", "init", "safe", "", "")
    hold = StateChange("warning", "veh1.actuators", "init", "hold", "", "")
    assert shown(watch, "ActuatorStatus", ActuatorState=2) == hold
    assert "ecu" not in hold.fields


@pytest.mark.parametrize("length", [*range(8), 9, 64])
def test_a_frame_of_wrong_length_shows_nothing(length: int) -> None:
    watch = StateWatch(CODECS)
    for bus, can_id in watch.watched:
        assert not list(watch.changes(bus, can_id, b"\xff" * length))


def test_braking_harder_than_is_comfortable_is_told_when_it_begins_and_ends() -> None:
    watch = StateWatch(CODECS)
    assert shown(watch, "PlannerStatus", Limit=Limit.CLEARANCE) is None
    begins = shown(watch, "PlannerStatus", Limit=Limit.HARD_BRAKING)
    assert begins == HardBraking("info", "veh1.planner", True)
    assert begins.fields == {"vehicle": 1, "ecu": "veh1.planner", "begins": True}
    assert shown(watch, "PlannerStatus", Limit=Limit.HARD_BRAKING, Slot=2) is None
    ends = shown(watch, "PlannerStatus", Limit=Limit.NONE)
    assert ends == HardBraking("info", "veh1.planner", False)
    assert ends.text == "brakes comfortably again"
    assert shown(watch, "PlannerStatus", Limit=Limit.COMFORT) == Uncomfortable("info", "veh1.planner", True)
    assert shown(watch, "PlannerStatus", Limit=Limit.CLEARANCE) == Uncomfortable("info", "veh1.planner", False)
    codec = CODECS["veh1"]
    values = {**codec.start_values("PlannerStatus"), "State": EcuState.RUN, "Limit": Limit.HARD_BRAKING}
    both = list(watch.changes("veh1", *codec.encode("PlannerStatus", values)))
    assert [each.kind for each in both] == ["state_change", "hard_braking"]
