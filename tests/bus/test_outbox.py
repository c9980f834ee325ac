"""What becomes of a node's frames on their way, with every fault that can befall them."""

from collections import Counter

import pytest

from bench.bus import e2e
from bench.bus.codec import load_codecs
from bench.bus.link.address import Address
from bench.bus.link.opening import open_link
from bench.bus.outbox import LARGEST_FRAME_BITS, Outbox
from bench.errors import BadInput
from bench.faults.kinds import (
    BabblingIdiot,
    BusOff,
    CounterStuck,
    Fault,
    FrameCorrupt,
    FrameDelay,
    FrameDuplicate,
    FrameLoss,
    FrameReorder,
    GilbertElliott,
    IcePatch,
    SensorBias,
    SensorDropout,
    SensorNoise,
    SignalStuck,
    V2VOutage,
)
from bench.faults.plan import FaultBoard, FaultPlan

CODECS = load_codecs(2)
CODEC = CODECS["veh1"]
CYCLES = 30
START = 10
"""Cycle in which the faults begin."""

Sent = dict[int, list[tuple[str, dict[str, float], bytes]]]


def sent(*faults: Fault, node: str = "veh1.tracker", lockstep: bool = True, seed: int = 1) -> Sent:
    """Send a steering angle that grows with each cycle, and torques; return message, signals and data by cycle."""
    address = Address.parse("direct")
    far, near = open_link("veh1", address), open_link("veh1", address)
    outbox = Outbox(node, {"veh1": near}, CODECS, FaultPlan(faults, seed))
    came: Sent = {}
    for cycle in range(CYCLES):
        outbox.put("veh1", "SteeringCommand", {"SteeringAngle": cycle / 1000, "CommandState": 1})
        outbox.put("veh1", "TorqueCommandFront", {"TorqueFL": 1.0, "TorqueFR": 2.0})
        outbox.send(cycle, lockstep=lockstep)
        came[cycle] = []
        for can_id, data in far.receive():
            known = can_id in CODEC.can_ids
            name, values = CODEC.decode(can_id, data) if known else (f"0x{can_id:03X}", {})
            came[cycle].append((name, values, data))
    return came


def names(came: Sent, cycle: int) -> list[str]:
    return [name for name, _, _ in came[cycle]]


def angles(came: Sent, cycle: int) -> list[int]:
    """Cycle numbers that the steering angles of a cycle's frames tell."""
    return [round(1000 * values["SteeringAngle"]) for name, values, _ in came[cycle] if name == "SteeringCommand"]


def absences(came: Sent, cycle: int) -> list[int]:
    return [int(values["Identifier"]) for name, values, _ in came[cycle] if name == "BenchAbsent"]


def on(**changes: object) -> dict[str, object]:
    return {"at_s": START / 100, "bus": "veh1", "message": "SteeringCommand"} | changes


def test_without_faults_every_frame_goes_out_once_and_is_good() -> None:
    came = sent()
    for cycle in range(CYCLES):
        assert names(came, cycle) == ["SteeringCommand", "TorqueCommandFront"]
        for name, values, data in came[cycle]:
            assert e2e.check(data, CODEC.data_id(name))
            assert values["AliveCounter"] == cycle % 15


def test_a_lost_frame_is_announced_as_absent_in_virtual_time_only() -> None:
    fault = FrameLoss(**on(for_s=0.05))
    came = sent(fault)
    assert names(came, START - 1) == ["SteeringCommand", "TorqueCommandFront"]
    for cycle in range(START, START + 5):
        assert names(came, cycle) == ["BenchAbsent", "TorqueCommandFront"]
        assert absences(came, cycle) == [0x300]
        assert came[cycle][0][1]["Cycle"] == cycle
    assert names(came, START + 5) == ["SteeringCommand", "TorqueCommandFront"]
    assert names(sent(fault, lockstep=False), START) == ["TorqueCommandFront"]


def test_a_fault_of_all_messages_of_a_bus_befalls_them_all() -> None:
    came = sent(FrameLoss(at_s=START / 100, bus="veh1"))
    assert names(came, START) == ["BenchAbsent", "BenchAbsent"]
    assert names(sent(FrameLoss(at_s=START / 100, bus="veh2")), START) == ["SteeringCommand", "TorqueCommandFront"]


def test_losses_are_as_frequent_as_asked_and_the_same_for_the_same_seed() -> None:
    fault = FrameLoss(**on(at_s=0.0, probability=0.5))
    lost = [[cycle for cycle in range(CYCLES) if not angles(came, cycle)] for came in (sent(fault), sent(fault))]
    assert lost[0] == lost[1]
    assert 5 <= len(lost[0]) <= 25
    other = sent(fault, seed=2)
    assert lost[0] != [cycle for cycle in range(CYCLES) if not angles(other, cycle)]


def test_losses_come_in_bursts() -> None:
    bursts = GilbertElliott(to_bad=0.1, to_good=0.25)
    address = Address.parse("direct")
    far, near = open_link("veh1", address), open_link("veh1", address)
    outbox = Outbox("veh1.tracker", {"veh1": near}, CODECS, FaultPlan([FrameLoss(**on(at_s=0.0, bursts=bursts))]))
    pattern = []
    for cycle in range(4000):
        outbox.put("veh1", "SteeringCommand", {})
        outbox.send(cycle)
        pattern.append(far.receive()[0][0] != 0x300)
    lengths = [len(run) for run in "".join("x" if lost else " " for lost in pattern).split()]
    # A burst is 1 / to_good frames long, and a share to_bad / (to_bad + to_good) of all frames is lost.
    assert sum(lengths) / len(lengths) == pytest.approx(4.0, rel=0.2)
    assert sum(pattern) / len(pattern) == pytest.approx(0.1 / 0.35, rel=0.2)


def test_a_delayed_frame_comes_whole_cycles_later() -> None:
    came = sent(FrameDelay(**on(cycles=3, for_s=0.04)))
    assert [angles(came, cycle) for cycle in range(START, START + 9)] == [
        [],
        [],
        [],
        [START],
        [START + 1, START + 4],
        [START + 2, START + 5],
        [START + 3, START + 6],
        [START + 7],
        [START + 8],
    ]
    assert absences(came, START) == [0x300]
    assert absences(came, START + 4) == []


def test_jitter_spreads_the_delay() -> None:
    came = sent(FrameDelay(**on(cycles=1, jitter_cycles=3)))
    delays = [cycle - angle for cycle in range(START, CYCLES) for angle in angles(came, cycle)]
    assert set(delays) == {1, 2, 3, 4}


def test_a_delay_of_nothing_or_one_cycle_leaves_some_frames_where_they_are() -> None:
    came = sent(FrameDelay(**on(cycles=0, jitter_cycles=1)))
    delays = [cycle - angle for cycle in range(START, CYCLES) for angle in angles(came, cycle)]
    assert set(delays) == {0, 1}


def test_a_delayed_frame_that_comes_due_while_its_node_is_off_the_bus_is_lost() -> None:
    off = BusOff(at_s=(START + 2) / 100, node="veh1.tracker", for_s=0.01)
    came = sent(FrameDelay(**on(cycles=2, for_s=0.01)), off)
    assert START not in [angle for cycle in came for angle in angles(came, cycle)]
    assert absences(came, START) == [0x300]


def test_duplicates_are_the_same_frame_again() -> None:
    came = sent(FrameDuplicate(**on(copies=2)))
    assert names(came, START) == ["SteeringCommand"] * 3 + ["TorqueCommandFront"]
    assert len({data for name, _, data in came[START] if name == "SteeringCommand"}) == 1


def test_reordered_frames_come_in_swapped_pairs() -> None:
    came = sent(FrameReorder(**on()))
    assert [angles(came, cycle) for cycle in range(START, START + 4)] == [
        [],
        [START + 1, START],
        [],
        [START + 3, START + 2],
    ]
    assert absences(came, START) == [0x300]


def test_the_second_of_a_pair_whose_first_was_lost_takes_its_place_too() -> None:
    """A cycle has as many frames as `FaultPlan.extra` tells the conductor, which waits for them."""
    came = sent(FrameLoss(**on(for_s=0.01)), FrameReorder(**on()))
    pairs = [angles(came, cycle) for cycle in range(START, START + 4)]
    assert pairs == [[], [START + 1] * 2, [], [START + 3, START + 2]]


@pytest.mark.parametrize("bits", [1, 2, 5, 64])
def test_a_corrupted_frame_has_that_many_bits_turned_over(bits: int) -> None:
    clean, came = sent(), sent(FrameCorrupt(**on(bits=bits)))
    for cycle in range(START, CYCLES):
        good = next(data for name, _, data in clean[cycle] if name == "SteeringCommand")
        bad = next(data for name, _, data in came[cycle] if name == "SteeringCommand")
        turned = int.from_bytes(good, "big") ^ int.from_bytes(bad, "big")
        assert turned.bit_count() == bits
        assert absences(came, cycle) == [0x300]


def test_a_stuck_counter_has_a_good_crc() -> None:
    came = sent(CounterStuck(**on()))
    for cycle in range(START, CYCLES):
        values, data = next((values, data) for name, values, data in came[cycle] if name == "SteeringCommand")
        assert values["AliveCounter"] == START % 15
        assert e2e.check(data, CODEC.data_id("SteeringCommand"))
        assert angles(came, cycle) == [cycle]
        assert absences(came, cycle) == ([] if cycle == START else [0x300])


def test_a_stuck_signal_keeps_its_value_under_a_good_crc_and_counter() -> None:
    came = sent(SignalStuck(**on(signal="SteeringAngle", for_s=0.05)))
    assert [angles(came, cycle) for cycle in range(START - 1, START + 6)] == [
        [START - 1],
        *[[START]] * 5,
        [START + 5],
    ]
    assert all(e2e.check(data, 0x300) for name, _, data in came[START + 2] if name == "SteeringCommand")
    assert absences(came, START + 2) == []


def test_a_sensors_bias_and_noise_are_in_the_signals_unit() -> None:
    biased = sent(SensorBias(**on(signal="SteeringAngle", bias=0.1)))
    assert angles(biased, START) == [START + 100]
    noisy = sent(SensorNoise(**on(at_s=0.0, signal="SteeringAngle", sigma=0.05)))
    errors = [angle - cycle for cycle in range(CYCLES) for angle in angles(noisy, cycle)]
    assert 25 < (sum(error**2 for error in errors) / CYCLES) ** 0.5 < 80
    assert len(set(errors)) > 20


def test_a_sensors_dropout_is_a_frame_not_sent() -> None:
    assert absences(sent(SensorDropout(**on())), START) == [0x300]


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


def test_a_node_that_is_off_the_bus_does_not_babble_either() -> None:
    idiot = BabblingIdiot(at_s=START / 100, node="veh1.tracker", identifier=0x80, frames_per_cycle=2)
    came = sent(BusOff(at_s=START / 100, node="veh1.tracker", for_s=0.01), idiot)
    assert Counter(names(came, START)) == {"BenchAbsent": 2}
    assert Counter(names(came, START + 1))["0x080"] == 2


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


def test_a_slow_message_goes_out_in_its_cycles_only() -> None:
    address = Address.parse("direct")
    far, near = open_link("veh1", address), open_link("veh1", address)
    outbox = Outbox("veh1.tracker", {"veh1": near}, CODECS)
    period = CODEC.period("TrackerBusHealth")
    assert period > 1
    for cycle in range(3 * period):
        outbox.put("veh1", "TrackerBusHealth", {})
        outbox.send(cycle)
    assert len(far.receive()) == 3


def test_a_bus_that_the_node_is_not_on_is_refused() -> None:
    outbox = Outbox("veh1.tracker", {"veh1": open_link("veh1", Address.parse("direct"))}, CODECS)
    with pytest.raises(BadInput, match=r"veh1\.tracker sends Reference on bus veh2; it is on veh1"):
        outbox.put("veh2", "Reference", {})


def test_faults_on_the_board_reach_every_plan() -> None:
    descriptor = FaultBoard.create()
    board, others = FaultBoard(descriptor), FaultBoard(descriptor)
    plan = FaultPlan([IcePatch(at_s=1.0, mu=0.1)], board=others)
    fault = FrameLoss(**on(at_s=0.0, bursts=GilbertElliott(to_bad=0.5, to_good=0.5)))
    plan.refresh()
    assert plan.at(0) == ()
    board.post(fault)
    plan.refresh()
    assert plan.at(0) == ((1, fault),)
    assert plan.at(100) == ((0, plan.faults[0]), (1, fault))


def test_a_full_board_says_so() -> None:
    board = FaultBoard(FaultBoard.create())

    def fill() -> None:
        for _ in range(10_000):
            board.post(IcePatch(at_s=1.0))

    with pytest.raises(ValueError, match="no room"):
        fill()
    assert len(board.read()) == board.count > 1000
