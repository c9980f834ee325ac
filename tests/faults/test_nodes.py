"""Nodes that babble, are off their bus or without radio."""

from collections import Counter

import pytest

from bench.bus.link.address import Address
from bench.bus.link.opening import open_link
from bench.bus.outbox import LARGEST_FRAME_BITS, Outbox
from bench.faults.nodes import BabblingIdiot, BusOff, V2VOutage
from bench.faults.plan import FaultPlan, is_off
from tests.faults.sending import CODECS, START, absences, names, sent


def test_a_babbling_idiot_starves_what_has_a_lower_priority() -> None:
    room = 500_000 // 100 // LARGEST_FRAME_BITS
    came = sent(BabblingIdiot(at_s=START / 100, node="veh1.tracker", identifier=0x80, frames_per_cycle=room))
    assert Counter(names(came, START)) == {"0x080": room, "BenchAbsent": 2}
    few = sent(BabblingIdiot(at_s=START / 100, node="veh1.tracker", identifier=0x80, frames_per_cycle=2))
    assert Counter(names(few, START)) == {"0x080": 2, "SteeringCommand": 1, "TorqueCommandFront": 1}
    beneath = sent(BabblingIdiot(at_s=START / 100, node="veh1.tracker", identifier=0x7F0, frames_per_cycle=room))
    assert absences(beneath, START) == []
    beside = sent(BabblingIdiot(at_s=START / 100, node="veh1.planner", identifier=0x80, frames_per_cycle=room))
    assert Counter(names(beside, START)) == {"BenchAbsent": 2}


def test_a_node_that_is_off_the_bus_sends_nothing() -> None:
    came = sent(BusOff(at_s=START / 100, node="veh1.tracker", for_s=0.02))
    assert [absences(came, cycle) for cycle in (START, START + 1, START + 2)] == [[0x300, 0x301]] * 2 + [[]]
    assert absences(sent(BusOff(at_s=START / 100, node="veh1.planner")), START) == []


@pytest.mark.parametrize(("vehicle", "is_out"), [(1, True), (2, False), (None, True)])
def test_an_outage_of_the_radio_is_of_one_vehicle_or_of_all(vehicle: int | None, is_out: bool) -> None:
    address = Address.parse("direct")
    far, near = open_link("v2v", address), open_link("v2v", address)
    plan = FaultPlan([V2VOutage(at_s=0.0, vehicle=vehicle)])
    outbox = Outbox("veh1.planner", {"v2v": near}, CODECS, plan)
    outbox.put("v2v", "V2VPosition_1", {"X": 1.0})
    outbox.send(0)
    ((can_id, _),) = far.receive()
    assert can_id == (0x011 if is_out else 0x101)


def test_a_node_that_is_off_its_bus_still_has_its_radio() -> None:
    faults = FaultPlan([BusOff(at_s=0.0, node="veh1.planner")]).at(0)
    assert is_off("veh1.planner", "veh1", faults)
    assert not is_off("veh1.planner", "v2v", faults)
    assert not is_off("veh1.tracker", "veh1", faults)


def test_a_node_that_is_off_the_bus_does_not_babble_either() -> None:
    idiot = BabblingIdiot(at_s=START / 100, node="veh1.tracker", identifier=0x80, frames_per_cycle=2)
    came = sent(BusOff(at_s=START / 100, node="veh1.tracker", for_s=0.01), idiot)
    assert Counter(names(came, START)) == {"BenchAbsent": 2}
    assert Counter(names(came, START + 1))["0x080"] == 2


def test_a_babbling_idiot_takes_no_room_on_other_buses() -> None:
    idiot = BabblingIdiot(at_s=0.0, node="veh1.planner", frames_per_cycle=60)
    assert idiot.starved("veh1", (0x300,), 37) == {0x300}
    assert idiot.starved("veh2", (0x300,), 37) == set()
    assert idiot.starved("v2v", (0x300,), 37) == set()


def test_what_a_node_babbles_follows_from_the_plan() -> None:
    idiot = BabblingIdiot(at_s=START / 100, node="veh1.tracker", identifier=0x80, frames_per_cycle=3)
    other = BusOff(at_s=0.0, node="veh2.tracker")
    came, plan = sent(other, idiot, seed=4), FaultPlan([other, idiot], 4)
    for cycle in (START, START + 1):
        babble = [data for name, _, data in came[cycle] if name == "0x080"]
        assert babble == [*idiot.payloads(plan.chance(1, "veh1", 0x80, cycle))]
        assert len(set(babble)) == 3
        assert {len(data) for data in babble} == {8}


@pytest.mark.parametrize(
    ("room", "starved"),
    [
        (6, set()),
        (5, {0x300}),
        (4, {0x200, 0x300}),
        (3, {0x200, 0x300}),
        (2, {0x200, 0x300}),
        (1, {0x100, 0x200, 0x300}),
        (0, {0x80, 0x100, 0x200, 0x300}),
    ],
)
def test_what_has_no_room_beside_the_babble_starves_by_priority(room: int, starved: set[int]) -> None:
    """An equal or lower identifier goes first, then the babble, then the rest as far as there is room."""
    idiot = BabblingIdiot(at_s=0.0, node="veh1.planner", identifier=0x100, frames_per_cycle=2)
    assert idiot.starved("veh1", (0x80, 0x100, 0x200, 0x300), room) == starved
