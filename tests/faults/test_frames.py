"""What becomes of frames on their way, with each fault that can befall them."""

import math

import pytest

from bench.bus import e2e
from bench.bus.link.address import Address
from bench.bus.link.opening import open_link
from bench.bus.outbox import Outbox
from bench.faults.base import LOST, ON_TIME, Memory
from bench.faults.frames import (
    CounterStuck,
    FrameCorrupt,
    FrameDelay,
    FrameDuplicate,
    FrameLoss,
    FrameReorder,
    GilbertElliott,
)
from bench.faults.nodes import BusOff
from bench.faults.plan import FaultPlan
from bench.faults.vehicles import IcePatch
from tests.faults.sending import CODEC, CODECS, CYCLES, START, Loaded, absences, angles, frame, names, on, sent

TURNS = GilbertElliott(to_bad=1.0, to_good=1.0, loss_bad=1.0, loss_good=0.0)


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


def test_the_dice_are_those_of_the_plan_for_this_fault_bus_message_and_cycle() -> None:
    """So that whoever plans with the same seed knows what becomes of a frame."""
    other = IcePatch(at_s=0.0)
    loss, corrupt = FrameLoss(**on(probability=0.4)), FrameCorrupt(**on(probability=0.4))
    lost = sent(other, loss, seed=3)
    damaged = sent(other, corrupt, seed=3)
    plan = FaultPlan([other, loss], 3)
    befallen = [c for c in range(START, CYCLES) if plan.chance(1, "veh1", 0x300, c).random() < 0.4]
    assert [c for c in range(START, CYCLES) if not angles(lost, c)] == befallen
    assert [c for c in range(START, CYCLES) if absences(damaged, c)] == befallen
    assert 0 < len(befallen) < CYCLES - START


def test_every_message_has_its_own_bursts() -> None:
    """Where each frame ends a burst or begins one, every second frame of every message is lost."""
    came = sent(FrameLoss(**on(message=None, bursts=TURNS)))
    both = ["SteeringCommand", "TorqueCommandFront"]
    for cycle in range(START, CYCLES):
        good = [name for name in names(came, cycle) if name != "BenchAbsent"]
        assert good == ([] if (cycle - START) % 2 == 0 else both)


def test_every_fault_has_its_own_bursts() -> None:
    came = sent(*[FrameLoss(**on(bursts=TURNS))] * 2)
    # The second is asked only of what the first lets through, which is every second frame.
    assert [bool(angles(came, START + cycle)) for cycle in range(8)] == [False, False, False, True] * 2


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


def test_a_delay_of_nothing_or_one_cycle_leaves_some_frames_where_they_are() -> None:
    came = sent(FrameDelay(**on(cycles=0, jitter_cycles=1)))
    delays = [cycle - angle for cycle in range(START, CYCLES) for angle in angles(came, cycle)]
    assert set(delays) == {0, 1}


def test_a_delayed_frame_that_comes_due_while_its_node_is_off_the_bus_is_lost() -> None:
    off = BusOff(at_s=(START + 2) / 100, node="veh1.tracker", for_s=0.01)
    came = sent(FrameDelay(**on(cycles=2, for_s=0.01)), off)
    assert START not in [angle for cycle in came for angle in angles(came, cycle)]
    assert absences(came, START) == [0x300]


def test_reordered_frames_of_several_messages_stay_with_their_own() -> None:
    came = sent(FrameReorder(**on(message=None)))
    assert names(came, START + 1) == ["SteeringCommand"] * 2 + ["TorqueCommandFront"] * 2
    assert angles(came, START + 1) == [START + 1, START]


def test_the_second_of_a_pair_whose_first_was_lost_takes_its_place_too() -> None:
    """A cycle has as many frames as `FaultPlan.extra` tells the conductor, which waits for them."""
    came = sent(FrameLoss(**on(for_s=0.01)), FrameReorder(**on()))
    pairs = [angles(came, cycle) for cycle in range(START, START + 4)]
    assert pairs == [[], [START + 1] * 2, [], [START + 3, START + 2]]


P = 0.25
BELOW = math.nextafter(P, 0.0)


def test_a_frame_is_hit_where_the_dice_give_less_than_the_probability() -> None:
    loss, copies = FrameLoss(**on(probability=P)), FrameDuplicate(**on(copies=2, probability=P))
    corrupt = FrameCorrupt(**on(probability=P))
    assert [loss.passage(b"", frame(number), {}) for number in (0.0, BELOW, P)] == [LOST, LOST, ON_TIME]
    assert [copies.extra(frame(number)) for number in (0.0, BELOW, P)] == [2, 2, 0]
    assert [corrupt.on_bytes(bytes(8), frame(number)) != bytes(8) for number in (0.0, BELOW, P)] == [True, True, False]


@pytest.mark.parametrize("was_bad", [False, True])
def test_a_channel_changes_where_the_dice_give_less_than_the_probability(was_bad: bool) -> None:
    channel = GilbertElliott(to_bad=P, to_good=P)
    for number, changes in ((0.0, True), (BELOW, True), (P, False)):
        memory: Memory = {"bad": was_bad}
        is_bad = was_bad is not changes
        # A bad channel loses every frame, a good one none.
        assert channel.loses(memory, Loaded(number)) is is_bad
        assert memory == {"bad": is_bad}


@pytest.mark.parametrize("is_bad", [False, True])
def test_a_channel_loses_a_frame_where_the_dice_give_less_than_its_loss(is_bad: bool) -> None:
    loss = {"loss_bad": P, "loss_good": 1.0} if is_bad else {"loss_bad": 1.0, "loss_good": P}
    channel = GilbertElliott(to_bad=1e-9, to_good=1e-9, **loss)
    assert [channel.loses({"bad": is_bad}, Loaded(number)) for number in (1e-9, BELOW, P)] == [True, True, False]


def test_a_channel_begins_good() -> None:
    memory: Memory = {}
    assert not GilbertElliott(to_bad=P, to_good=P).loses(memory, Loaded(P))
    assert memory == {"bad": False}


@pytest.mark.parametrize("length", [1, 3, 8])
def test_of_a_short_frame_at_most_all_bits_are_turned_over(length: int) -> None:
    corrupt = FrameCorrupt(**on(bits=64))
    clean = bytes(range(length))
    turned = corrupt.on_bytes(clean, FaultPlan([corrupt]).context(0, "veh1", 0x300, START))
    assert turned == bytes(0xFF ^ byte for byte in clean)
