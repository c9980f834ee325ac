"""Which frames a cycle consists of, and who keeps it waiting."""

import pytest

from bench.bus.codec import load_codecs
from bench.bus.topic import Topic
from bench.conductor.cycle import CycleFrames, frames_due

VEHICLES = 2
CODECS = load_codecs(VEHICLES)
DUE = frames_due(CODECS, VEHICLES)
INPUTS = {
    "veh1.planner": [Topic("veh1", "VehicleMotion"), Topic("v2v", "V2VPosition_2")],
    "veh1.tracker": [Topic("veh1", "VehicleMotion"), Topic("veh1", "Reference")],
}


def frame(bus: str, message: str, counter: int) -> tuple[int, bytes]:
    return CODECS[bus].encode(message, CODECS[bus].start_values(message), counter)


def of(*senders: str) -> list[tuple[str, str]]:
    """Bus and message of all that the senders send."""
    return [(due.bus, due.message) for bus in DUE.values() for due in bus.values() if due.sender in senders]


@pytest.fixture
def frames() -> CycleFrames:
    frames = CycleFrames(DUE)
    frames.begin(7)
    return frames


def take(frames: CycleFrames, messages: list[tuple[str, str]], counter: int = 7) -> None:
    for bus, message in messages:
        frames.take(bus, [frame(bus, message, counter)])


def test_due_is_what_the_dbc_says_of_the_vehicles_that_are_there() -> None:
    assert {due.sender for due in DUE["v2v"].values()} == {"veh1.planner", "veh2.planner"}
    assert [due.message for due in DUE["v2v"].values()] == [
        "V2VPosition_1",
        "V2VPosition_2",
        "V2VMotion_1",
        "V2VMotion_2",
    ]
    assert {due.sender for due in DUE["veh2"].values()} == {"plant", "veh2.planner", "veh2.tracker"}
    assert set(CODECS["veh1"].names) - {due.message for due in DUE["veh1"].values()} == {"BenchSync"}


def test_a_cycle_is_complete_with_its_last_frame(frames: CycleFrames) -> None:
    messages = of("plant", "veh1.planner", "veh2.planner", "veh1.tracker", "veh2.tracker")
    for message in messages:
        assert not frames.complete
        take(frames, [message])
    assert frames.complete
    assert frames.missing() == []
    assert frames.strays == []


def test_the_order_of_the_log_does_not_depend_on_the_order_of_arrival() -> None:
    messages = of("plant", "veh1.planner", "veh2.planner", "veh1.tracker", "veh2.tracker")
    orders = []
    for arrival in (messages, messages[::-1]):
        frames = CycleFrames(DUE)
        frames.begin(0)
        take(frames, arrival, 0)
        orders.append(list(frames.ordered()))
    assert orders[0] == orders[1]
    assert [(bus, can_id) for bus, can_id, _ in orders[0]] == [
        (bus, can_id) for bus in ("v2v", "veh1", "veh2") for can_id in sorted(DUE[bus])
    ]


def test_strays_are_noted_and_kept(frames: CycleFrames) -> None:
    first = frame("veh1", "Reference", 7)
    frames.take("veh1", [first, first])
    frames.take("veh1", [frame("veh1", "SteeringCommand", 6), (0x7FF, b"\x01")])
    assert frames.strays == [("veh1", first[0]), ("veh1", 0x300), ("veh1", 0x7FF)]
    assert len(list(frames.ordered())) == 4
    assert Topic("veh1", "SteeringCommand") in [due.topic for due in frames.missing()]
    frames.begin(8)
    assert frames.strays == []
    assert list(frames.ordered()) == []


def test_the_guilty_one_has_got_all_it_needs(frames: CycleFrames) -> None:
    take(frames, of("plant", "veh2.planner", "veh2.tracker"))
    assert frames.silent(INPUTS) == "veh1.planner sends no V2VPosition_1 (0x101 on v2v) and 8 more"
    take(frames, of("veh1.planner"))
    assert frames.silent(INPUTS).startswith("veh1.tracker sends no SteeringCommand (0x300 on veh1) and ")


def test_a_silent_plant_is_guilty_alone(frames: CycleFrames) -> None:
    inputs = INPUTS | {
        name.replace("veh1", "veh2"): [Topic(t.bus.replace("veh1", "veh2"), t.message) for t in topics]
        for name, topics in INPUTS.items()
    }
    assert frames.silent(inputs).startswith("plant sends no VehiclePosition (0x100 on veh1) and ")
    assert ";" not in frames.silent(inputs)


def test_where_nothing_is_known_of_the_inputs_all_are_named(frames: CycleFrames) -> None:
    take(frames, of("plant", "veh2.planner", "veh2.tracker"))
    text = frames.silent({})
    assert "veh1.planner sends no " in text
    assert "veh1.tracker sends no " in text
