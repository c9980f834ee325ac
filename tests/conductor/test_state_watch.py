"""Changes of state on the bus become events."""

import pytest

from bench.bus.codec import load_codecs
from bench.conductor.state_watch import StateWatch
from bench.events import StateChange

CODECS = load_codecs(1)


def shown(watch: StateWatch, message: str, **signals: float) -> StateChange | None:
    codec = CODECS["veh1"]
    return watch.change("veh1", *codec.encode(message, {**codec.start_values(message), **signals}))


def test_each_change_is_told_once_with_its_cause() -> None:
    watch = StateWatch(CODECS)
    names = {"PlannerStatus", "TrackerStatus", "ActuatorStatus"}
    assert set(watch.watched) == {("veh1", CODECS["veh1"].can_id(name)) for name in names}
    assert shown(watch, "TrackerStatus", State=0) is None
    assert shown(watch, "TrackerStatus", State=1) == StateChange("info", "veh1.tracker", "init", "run")
    assert shown(watch, "TrackerStatus", State=1, Tau=2.0) is None
    causes = CODECS["veh1"].message("TrackerStatus").get_signal_by_name("Cause").choices
    cause = max(causes)
    degraded = shown(watch, "TrackerStatus", State=2, Cause=cause)
    assert degraded == StateChange("warning", "veh1.tracker", "run", "degraded", str(causes[cause]))
    assert shown(watch, "TrackerStatus", State=1) == StateChange("info", "veh1.tracker", "degraded", "run")


def test_senders_are_told_apart() -> None:
    watch = StateWatch(CODECS)
    assert shown(watch, "PlannerStatus", State=3) == StateChange("warning", "veh1.planner", "init", "safe")
    assert shown(watch, "ActuatorStatus", ActuatorState=2) == StateChange("warning", "veh1.actuators", "init", "hold")


@pytest.mark.parametrize("length", range(8))
def test_a_frame_too_short_shows_nothing(length: int) -> None:
    watch = StateWatch(CODECS)
    for bus, can_id in watch.watched:
        if 8 * length <= watch.watched[bus, can_id].state.shift:
            assert watch.change(bus, can_id, b"\xff" * length) is None
