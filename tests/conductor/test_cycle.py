"""Which frames a cycle consists of, and who keeps it waiting."""

import pytest

from bench.bus.codec import load_codecs
from bench.bus.frame import BusFrame, CanFrame
from bench.bus.topic import Topic
from bench.conductor.cycle import CycleFrames, frames_due
from bench.conductor.refusals import Refusals
from bench.events import Refusal
from bench.faults.frames import FrameDuplicate
from bench.faults.plan import FaultPlan

VEHICLES = 2
CODECS = load_codecs(VEHICLES)
DUE = frames_due(CODECS, VEHICLES)
INPUTS = {
    "veh1.planner": [Topic("veh1", "VehicleMotion"), Topic("v2v", "V2VPosition_2")],
    "veh1.tracker": [Topic("veh1", "VehicleMotion"), Topic("veh1", "Reference")],
}


def frame(bus: str, message: str, counter: int) -> CanFrame:
    return CODECS[bus].encode(message, CODECS[bus].start_values(message), counter)


def of(*senders: str) -> list[tuple[str, str]]:
    """Bus and message of all that the senders send in every cycle."""
    every = [due for bus in DUE.values() for due in bus.values() if due.sender in senders]
    return [(due.bus, due.message) for due in every if due.period == 1]


@pytest.fixture
def refusals() -> Refusals:
    return Refusals(CODECS)


@pytest.fixture
def frames(refusals: Refusals) -> CycleFrames:
    frames = CycleFrames(DUE, CODECS, refusals=refusals)
    frames.begin(7)
    return frames


def take(frames: CycleFrames, messages: list[tuple[str, str]], counter: int = 7) -> None:
    for bus, message in messages:
        frames.take(bus, [frame(bus, message, counter)])


def test_due_is_what_the_dbc_says_of_the_vehicles_that_are_there() -> None:
    assert {due.sender for due in DUE["v2v"].values()} == {"veh1.planner", "veh2.planner"}
    kinds = ("V2VPosition", "V2VMotion", "V2VStatus")
    assert [due.message for due in DUE["v2v"].values()] == [f"{kind}_{number}" for kind in kinds for number in (1, 2)]
    assert {due.sender for due in DUE["veh2"].values()} == {"plant", "veh2.planner", "veh2.tracker"}
    assert set(CODECS["veh1"].names) - {due.message for due in DUE["veh1"].values()} == {"BenchSync", "BenchAbsent"}


def test_the_last_bus_that_lacks_a_frame_is_awaited(frames: CycleFrames) -> None:
    assert frames.awaited == "veh2"
    for due in list(DUE["veh2"].values()):
        frames.give_up("veh2", due.can_id)
    assert frames.awaited == "veh1"
    for due in frames.missing():
        frames.give_up(due.bus, due.can_id)
    assert frames.awaited is None


def test_a_cycle_is_complete_with_its_last_frame(frames: CycleFrames) -> None:
    messages = of("plant", "veh1.planner", "veh2.planner", "veh1.tracker", "veh2.tracker")
    for message in messages:
        assert not frames.complete
        take(frames, [message])
    assert frames.complete
    assert frames.missing() == []
    assert len(frames.due) == len(messages)


def test_the_order_of_the_log_does_not_depend_on_the_order_of_arrival() -> None:
    messages = of("plant", "veh1.planner", "veh2.planner", "veh1.tracker", "veh2.tracker")
    orders = []
    for arrival in (messages, messages[::-1]):
        frames = CycleFrames(DUE, CODECS)
        frames.begin(0)
        take(frames, arrival, 0)
        orders.append(list(frames.ordered()))
    assert orders[0] == orders[1]
    assert [(bus, can_id) for bus, can_id, _ in orders[0]] == [
        (bus, can_id) for bus in ("v2v", "veh1", "veh2") for can_id in sorted(DUE[bus]) if DUE[bus][can_id].period == 1
    ]


def test_frames_that_are_not_due_are_refused_and_kept(frames: CycleFrames, refusals: Refusals) -> None:
    first = frame("veh1", "Reference", 7)
    assert frames.take("veh1", [first, first]) is True
    assert frames.take("veh1", [frame("veh1", "SteeringCommand", 6), CanFrame(0x7FF, b"\x01")]) is False
    assert [event.fields for event in refusals.news()] == [
        {"bus": "veh1", "can_id": first.can_id, "why": Refusal.NOT_DUE, "length": 8},
        {"bus": "veh1", "can_id": 0x300, "why": Refusal.NOT_DUE, "length": 8},
        {"bus": "veh1", "can_id": 0x7FF, "why": Refusal.UNKNOWN, "length": 1},
    ]
    assert frames.due == [BusFrame("veh1", *first)]
    assert len(list(frames.ordered())) == 4
    assert Topic("veh1", "SteeringCommand") in [due.topic for due in frames.missing()]
    frames.begin(8)
    assert frames.due == []
    assert list(frames.ordered()) == []


@pytest.mark.parametrize("length", [0, 1, 2, 7])
@pytest.mark.parametrize(
    "message", ["PlantBusHealth", "PlannerBusHealth", "TrackerBusHealth", "Reference", "TrackerStatus"]
)
def test_a_frame_of_another_length_is_not_the_due_one(
    frames: CycleFrames, refusals: Refusals, message: str, length: int
) -> None:
    frames.begin(10)
    can_id, data = frame("veh1", message, 10)
    assert frames.take("veh1", [CanFrame(can_id, data[:length])]) is False
    assert can_id in [due.can_id for due in frames.missing() if due.bus == "veh1"]
    assert refusals.totals[0].counts == {Refusal.LENGTH: 1}
    assert frames.due == []
    assert frames.take("veh1", [CanFrame(can_id, data)]) is True


def test_in_virtual_time_only_the_conductor_sends_bench_sync(frames: CycleFrames, refusals: Refusals) -> None:
    for cycle in (7, 8, 4_000_000):
        values = {"Command": 1, "Cycle": cycle, "Time": cycle / 100}
        assert frames.take("veh1", [CODECS["veh1"].encode("BenchSync", values, cycle)]) is False
    assert refusals.totals[0].counts == {Refusal.IMPLAUSIBLE: 3}


def test_an_announcement_that_concerns_nothing_is_refused(frames: CycleFrames, refusals: Refusals) -> None:
    for can_id, cycle in ((0x200, 6), (0x200, 8), (0x7FF, 7)):
        assert frames.take("veh1", [absence(can_id, cycle)]) is False
    assert refusals.totals[0].counts == {Refusal.NOT_DUE: 3}


def test_a_spoiled_frame_is_hopeless_once_its_sender_has_sent_all_else(frames: CycleFrames) -> None:
    """Before that, its sender may still be computing, and the spoiled one another's."""
    can_id, data = frame("veh1", "SteeringCommand", 7)
    frames.take("veh1", [CanFrame(can_id, bytes([data[0] ^ 1, *data[1:]]))])
    assert frames.spoiled == {("veh1", can_id)}
    assert frames.hopeless == []
    take(frames, [each for each in of("veh1.tracker") if each != ("veh1", "SteeringCommand")])
    assert frames.hopeless == [("veh1", can_id)]
    frames.take("veh1", [CanFrame(can_id, data)])
    assert frames.hopeless == []


def test_the_guilty_one_has_got_all_it_needs(frames: CycleFrames) -> None:
    take(frames, of("plant", "veh2.planner", "veh2.tracker"))
    guilty = frames.guilty(INPUTS)
    assert guilty == ["veh1.planner"]
    assert frames.silent(guilty).startswith("veh1.planner sends no V2VPosition_1 (0x101 on v2v) and ")
    take(frames, of("veh1.planner"))
    assert frames.guilty(INPUTS) == ["veh1.tracker"]


def test_a_silent_plant_is_guilty_alone(frames: CycleFrames) -> None:
    inputs = INPUTS | {
        name.replace("veh1", "veh2"): [Topic(t.bus.replace("veh1", "veh2"), t.message) for t in topics]
        for name, topics in INPUTS.items()
    }
    assert frames.guilty(inputs) == ["plant"]


def test_where_nothing_is_known_of_the_inputs_all_are_named(frames: CycleFrames) -> None:
    take(frames, of("plant", "veh2.planner", "veh2.tracker"))
    assert frames.guilty({}) == ["veh1.planner", "veh1.tracker"]


def test_a_message_of_a_longer_cycle_time_is_due_in_every_nth_cycle() -> None:
    slow = {due.message for due in DUE["veh1"].values() if due.period > 1}
    assert "TrackerBusHealth" in slow
    frames = CycleFrames(DUE, CODECS)
    for number, expected in ((10, slow), (11, set())):
        frames.begin(number)
        assert {due.message for due in frames.missing() if due.bus == "veh1"} & slow == expected


def absence(can_id: int, cycle: int) -> CanFrame:
    return CODECS["veh1"].encode("BenchAbsent", {"Identifier": can_id, "Cycle": cycle}, cycle)


def test_a_frame_announced_as_absent_is_not_waited_for(frames: CycleFrames) -> None:
    take(
        frames,
        [
            each
            for each in of("plant", "veh1.planner", "veh2.planner", "veh1.tracker", "veh2.tracker")
            if each != ("veh1", "Reference")
        ],
    )
    assert [due.message for due in frames.missing()] == ["Reference"]
    frames.take("veh1", [absence(0x200, 6)])
    assert not frames.complete
    spoiled = absence(0x200, 7)
    frames.take("veh1", [CanFrame(spoiled.can_id, bytes([spoiled[1][0] ^ 1, *spoiled[1][1:]]))])
    assert not frames.complete
    assert frames.take("veh1", [absence(0x200, 7)]) is True
    assert frames.complete


def test_a_due_frame_with_a_wrong_crc_does_not_count_until_it_is_given_up(frames: CycleFrames) -> None:
    can_id, data = frame("veh1", "Reference", 7)
    frames.take("veh1", [CanFrame(can_id, bytes([data[0] ^ 0x10, *data[1:]]))])
    assert frames.spoiled == {("veh1", can_id)}
    assert can_id in [due.can_id for due in frames.missing() if due.bus == "veh1"]
    frames.give_up("veh1", can_id)
    assert can_id not in [due.can_id for due in frames.missing() if due.bus == "veh1"]


def test_copies_that_a_fault_makes_belong_to_the_cycle() -> None:
    plan = FaultPlan([FrameDuplicate(at_s=0.07, bus="veh1", message="Reference", copies=2)])
    frames = CycleFrames(DUE, CODECS, plan)
    frames.begin(7)
    take(frames, of("plant", "veh1.planner", "veh2.planner", "veh1.tracker", "veh2.tracker"))
    assert not frames.complete
    take(frames, [("veh1", "Reference"), ("veh1", "Reference")])
    assert frames.complete
    assert not frames.take("veh1", [frame("veh1", "Reference", 7)])
