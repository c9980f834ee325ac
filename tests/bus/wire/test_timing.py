"""Length of frames on the wire, arbitration, and the order in which a cycle's frames pass."""

import itertools
import random
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.bus.codec import load_codecs
from bench.bus.link.base import EXTENDED
from bench.bus.network import transmissions
from bench.bus.topic import Topic
from bench.bus.wire.frame_length import INTERFRAME_BITS, crc15, frame_bits, longest_bits, priority
from bench.bus.wire.timing import FRAME, MOST_HELD, BusTimeline
from bench.cycle import CYCLE_NS

BIT_NS = {"v2v": 1000, "veh1": 2000, "veh2": 2000}
INPUTS = {
    "veh1.planner": [Topic("veh1", "VehiclePosition"), Topic("veh1", "VehicleMotion"), Topic("v2v", "V2VMotion_2")],
    "veh1.tracker": [Topic("veh1", "VehicleMotion"), Topic("veh1", "Reference")],
}


def bits_of(value, count):
    return [value >> shift & 1 for shift in reversed(range(count))]


def wire(can_id, data):
    """The bits of a frame from start to end of frame, one after the other, as ISO 11898-1 has them."""
    if can_id & EXTENDED:
        number = can_id & ~EXTENDED
        stuffed = [0, *bits_of(number >> 18, 11), 1, 1, *bits_of(number & 0x3FFFF, 18), 0, 0, 0]
    else:
        stuffed = [0, *bits_of(can_id, 11), 0, 0, 0]
    stuffed += bits_of(len(data), 4)
    for byte in data:
        stuffed += bits_of(byte, 8)
    crc = 0
    for bit in stuffed:
        feedback = bit ^ crc >> 14
        crc = crc << 1 & 0x7FFF
        crc ^= 0x4599 if feedback else 0
    sent = []
    for bit in [*stuffed, *bits_of(crc, 15)]:
        sent.append(bit)
        if sent[-5:] == [bit] * 5:
            sent.append(1 - bit)
    return sent + [1, 0, 1] + [1] * 7


def lengths(frames):
    ids = np.array([can_id for can_id, _ in frames], np.uint32)
    sizes = np.array([len(data) for _, data in frames], np.uint8)
    data = np.array([list(data.ljust(8, b"\xa5")) for _, data in frames], np.uint8).reshape(-1, 8)
    return frame_bits(ids, sizes, data).tolist()


identifiers = st.one_of(st.integers(0, 0x7FF), st.integers(0, 0x1FFFFFFF).map(lambda number: number | EXTENDED))
payloads = st.one_of(
    st.binary(max_size=8),
    st.lists(st.sampled_from([0x00, 0xFF, 0x0F, 0x1F, 0x83, 0xF8]), max_size=8).map(bytes),
)


@settings(deadline=None)
@given(st.lists(st.tuples(identifiers, payloads), max_size=30))
def test_the_length_is_that_of_the_bits_written_out_one_by_one(frames):
    assert lengths(frames) == [len(wire(can_id, data)) for can_id, data in frames]


def test_the_crc_is_that_of_the_catalogue():
    """Check value of CRC-15/CAN in G. Cook's catalogue of parametrised CRC algorithms."""
    assert crc15(b"123456789") == 0x059E


@pytest.mark.parametrize("size", range(9))
def test_no_frame_is_longer_or_shorter_than_can_be(size):
    """Davis et al. (2007), equations 1 and 2, interframe space included: 55 + 10 s and 80 + 10 s."""
    assert longest_bits(size) == 55 + 10 * size
    assert longest_bits(size, extended=True) == 80 + 10 * size
    generator = random.Random(size)
    for flag, shortest in ((0, 47), (EXTENDED, 67)):
        width = 29 if flag else 11
        frames = [(generator.getrandbits(width) | flag, generator.randbytes(size)) for _ in range(2000)]
        found = [bits + INTERFRAME_BITS for bits in lengths(frames)]
        assert shortest + 8 * size <= min(found)
        assert max(found) <= longest_bits(size, extended=bool(flag))


def test_arbitration_is_bit_by_bit():
    """A dominant bit wins; where the first 11 bits agree, the short identifier's RTR is dominant, SRR is not."""
    ids = [0x123, 0x124, 0x123 << 18 | EXTENDED, (0x123 << 18 | 1) | EXTENDED, 0x122 << 18 | EXTENDED, 0x7FF, 0]
    ranks = priority(np.array(ids, np.uint32))
    assert [ids[index] for index in np.argsort(ranks)] == sorted(ids, key=unstuffed_head)
    assert len(set(ranks.tolist())) == len(ids)


def unstuffed_head(can_id):
    number = can_id & ~EXTENDED
    if can_id & EXTENDED:
        return [*bits_of(number >> 18, 11), 1, 1, *bits_of(number & 0x3FFFF, 18)]
    return [*bits_of(number, 11), 0, 0]


def frames_of(rows, codecs):
    """Frames as a recorder has them; rows are (bus, cycle, message or identifier, data or counter)."""
    numbers = {bus: number for number, bus in enumerate(codecs)}
    table = np.zeros(len(rows), FRAME)
    for row, (bus, cycle, what, content) in zip(table, rows, strict=True):
        can_id, data = what, content
        if isinstance(what, str):
            values = codecs[bus].start_values(what)
            can_id, data = codecs[bus].encode(what, values, content)
        row["bus"], row["can_id"], row["time"], row["length"] = numbers[bus], can_id, cycle * CYCLE_NS, len(data)
        row["data"][: len(data)] = list(data)
    return table


def cycle_rows(codecs, cycle):
    """Everything that vehicles 1 and 2 send in a cycle, in the order of identifiers."""
    for bus, codec in codecs.items():
        for name in codec.names:
            absent = bus == "v2v" and name not in ("BenchSync", *(f"V2V{kind}_{i}" for kind in KINDS for i in (1, 2)))
            if name != "BenchAbsent" and not absent:
                yield bus, cycle, name, cycle


KINDS = ("Position", "Motion")


@pytest.fixture(scope="module")
def codecs():
    return load_codecs(2)


@pytest.fixture(scope="module")
def passed(codecs):
    timeline = BusTimeline(codecs, INPUTS)
    rows = [row for cycle in range(3) for row in cycle_rows(codecs, cycle)]
    return timeline.send(frames_of(rows, codecs), last=True)


def named(frames, codecs, bus, cycle=1):
    """End, release (ns in the cycle) and row of each message of a bus in a cycle."""
    number = list(codecs).index(bus)
    found = {}
    for row in frames[(frames["bus"] == number) & (frames["time"] == cycle * CYCLE_NS)]:
        name = codecs[bus].decode(int(row["can_id"]), row["data"][: row["length"]].tobytes())[0]
        end = int(row["wire"] - row["time"])
        found[name] = end, end - int(row["response"]), row
    return found


def duration(row, bus):
    return len(wire(int(row["can_id"]), row["data"][: row["length"]].tobytes())) * BIT_NS[bus]


@pytest.mark.parametrize("bus", ["v2v", "veh1", "veh2"])
def test_a_bus_carries_one_frame_at_a_time(passed, codecs, bus):
    ends = sorted((end, duration(row, bus)) for end, _, row in named(passed, codecs, bus).values())
    for (before, _), (end, length) in itertools.pairwise(ends):
        assert end - length >= before + INTERFRAME_BITS * BIT_NS[bus]


@pytest.mark.parametrize("bus", ["v2v", "veh1", "veh2"])
def test_no_frame_is_overtaken_by_one_of_lower_priority(passed, codecs, bus):
    frames = list(named(passed, codecs, bus).values())
    for end, _, row in frames:
        start = end - duration(row, bus)
        waiting = [int(other["can_id"]) for later, release, other in frames if release <= start < later - 1]
        assert int(row["can_id"]) == min(waiting)


def test_frames_are_released_by_what_they_answer(passed, codecs):
    found = named(passed, codecs, "veh1")
    end = {name: at for name, (at, _, _) in found.items()}
    release = {name: at for name, (_, at, _) in found.items()}
    assert release["BenchSync"] == 0
    assert end["BenchSync"] == duration(found["BenchSync"][2], "veh1")
    assert release["VehiclePosition"] == release["PlantTiming"] == end["BenchSync"]
    assert release["Reference"] == release["PlannerTiming"] == end["VehicleMotion"]
    assert release["SteeringCommand"] == end["Reference"]
    assert named(passed, codecs, "v2v")["V2VPosition_1"][1] == end["VehicleMotion"]
    # Nothing is known of what these take: they answer BenchSync.
    assert named(passed, codecs, "veh2")["Reference"][1] == named(passed, codecs, "veh2")["BenchSync"][0]


def test_the_order_is_that_of_the_wire(passed):
    keys = list(zip(passed["time"].tolist(), passed["wire"].tolist(), strict=True))
    assert keys == sorted(keys)


def test_batches_make_no_difference(passed, codecs):
    timeline = BusTimeline(codecs, INPUTS)
    found = [timeline.send(frames_of(list(cycle_rows(codecs, cycle)), codecs)) for cycle in range(3)]
    found.append(timeline.send(frames_of([], codecs), last=True))
    assert np.concatenate(found).tobytes() == passed.tobytes()


def test_a_bus_that_is_taken_at_the_end_of_a_cycle_delays_the_next_but_not_its_higher_priorities(codecs):
    """45 frames of 8 bytes take more than a cycle at 500 kbit/s."""
    babble = [("veh1", 0, 0x700, bytes([0x55] * 8))] * 45
    rows = [("veh1", 0, "BenchSync", 0), *babble], [("veh1", 1, "BenchSync", 1), ("veh1", 1, "VehiclePosition", 1)]
    timeline = BusTimeline(codecs, INPUTS)
    first = timeline.send(frames_of(rows[0], codecs))
    assert 0 < len(first) < 46
    # The one that was under way at the end of the cycle is certain, what still waits is not.
    assert CYCLE_NS <= first["wire"].max() < CYCLE_NS + 135 * BIT_NS["veh1"]
    rest = timeline.send(frames_of(rows[1], codecs), last=True)
    assert len(first) + len(rest) == 48
    sync, position = (rest[(rest["can_id"] == can_id) & (rest["time"] == CYCLE_NS)][0] for can_id in (0x10, 0x100))
    length = duration(sync, "veh1")
    assert sync["wire"] == first["wire"].max() + INTERFRAME_BITS * BIT_NS["veh1"] + length
    late = rest[rest["time"] == 0]
    assert len(late)
    assert (late["wire"] > position["wire"]).all()
    assert sync["response"] == sync["wire"] - CYCLE_NS


def written_out(codecs, inputs, cycles):
    """End and response time of each frame of lockstep by (time, place in its cycle), by the rules of the module."""
    sent, waiting, free = {}, [], dict.fromkeys(codecs, 0)
    for cycle, rows in enumerate(cycles):
        time = cycle * CYCLE_NS
        waiting += opened(codecs, inputs, time, rows)
        for bus in sorted(codecs, key=lambda bus: bus == "v2v"):
            while (frame := next_on(bus, waiting, free[bus])) is not None:
                begin = max(free[bus], frame.release)
                if begin >= time + CYCLE_NS:
                    break
                waiting.remove(frame)
                end = begin + frame.duration
                sent[frame.place] = end, end - frame.release
                free[bus] = end + INTERFRAME_BITS * BIT_NS[bus]
                for each in waiting:
                    if each.release is None and each.home == bus and not set(each.awaited) & set(waiting):
                        each.release = end
    return sent


def opened(codecs, inputs, time, rows):
    """The frames of a cycle, each with those that it answers."""
    senders = {bus: {each.can_id: each.sender for each in transmissions(bus, codec)} for bus, codec in codecs.items()}
    new = []
    for place, (bus, _, can_id, data) in enumerate(rows):
        sender = senders[bus].get(can_id, "")
        bits = longest_bits(8) - INTERFRAME_BITS if codecs[bus].is_wall_clock(can_id) else len(wire(can_id, data))
        home = sender.partition(".")[0] if sender.partition(".")[0] in codecs else bus
        new.append(Waiting((time, place), bus, can_id, sender, home, bits * BIT_NS[bus]))
    for frame in new:
        topics = [topic for topic in inputs.get(frame.sender, ()) if topic.bus == frame.home and not topic.delay]
        wanted = {codecs[frame.home].can_id(topic.message) for topic in topics}
        others = [each for each in new if each.bus == frame.home]
        frame.awaited = [e for e in others if e.can_id == SYNC or (e.can_id in wanted and e.sender != frame.sender)]
        answers = frame.sender and frame.can_id != SYNC
        frame.release = None if answers and frame.awaited else time
    return new


def next_on(bus, waiting, free):
    """The frame that is the next on a bus that is free from `free` on; None if none is waiting."""
    released = [each for each in waiting if each.bus == bus and each.release is not None]
    if not released:
        # Senders that wait for each other do not wait for ever.
        for frame in [each for each in waiting if each.home == bus and each.release is None]:
            frame.release = free - INTERFRAME_BITS * BIT_NS[bus]
        released = [each for each in waiting if each.bus == bus and each.release is not None]
    begin = max([free, min((each.release for each in released), default=0)])
    ready = [each for each in released if each.release <= begin]
    return min(ready, key=lambda each: (unstuffed_head(each.can_id), each.place), default=None)


SYNC = 0x10


@dataclass(eq=False)
class Waiting:
    """A frame in `written_out`: its place, and the frames that it answers."""

    place: tuple[int, int]
    bus: str
    can_id: int
    sender: str
    home: str
    duration: int
    release: int | None = None
    awaited: Sequence = ()


MUTUAL = {"veh1.planner": [Topic("veh1", "SteeringCommand")], "veh1.tracker": [Topic("veh1", "Reference")]}


def test_any_frames_pass_as_the_rules_written_out_have_it(codecs, tries):
    @settings(deadline=None, max_examples=tries(15, 100))
    @given(
        st.integers(0, 2**32), st.sampled_from([INPUTS, MUTUAL, {}]), st.lists(st.sampled_from([0.3, 1, 2]), max_size=4)
    )
    def pass_alike(seed, inputs, densities):
        generator = random.Random(seed)
        cycles = [list(any_rows(codecs, generator, cycle, density)) for cycle, density in enumerate(densities)]
        timeline = BusTimeline(codecs, inputs)
        tables = [frames_of(rows, codecs) for rows in cycles]
        for table in tables:
            # To find each frame again.
            table["receive"] = np.arange(len(table))
        passed = np.concatenate([timeline.send(table) for table in [frames_of([], codecs), *tables]])
        found = {
            (int(row["time"]), int(row["receive"])): (int(row["wire"]), int(row["response"]))
            for row in passed
            if row["wire"]
        }
        assert found == written_out(codecs, inputs, cycles)

    pass_alike()


def any_rows(codecs, generator, cycle, density):
    """Frames of a cycle in any order: of the DBC, some of them repeated or absent, and of nobody."""
    rows = [("veh1", cycle, generator.choice([generator.getrandbits(11), generator.getrandbits(29) | EXTENDED]), b"x")]
    for bus, codec in codecs.items():
        for name in codec.names:
            for _ in range(int(density + generator.random())):
                if name != "BenchAbsent":
                    rows.append((bus, cycle, codec.can_id(name), generator.randbytes(codec.message(name).length)))
    generator.shuffle(rows)
    return rows


def test_what_waits_for_each_other_is_sent_all_the_same(codecs):
    inputs = {"veh1.planner": [Topic("veh1", "SteeringCommand")], "veh1.tracker": [Topic("veh1", "Reference")]}
    rows = [("veh1", 0, name, 0) for name in ("BenchSync", "Reference", "SteeringCommand")]
    passed = BusTimeline(codecs, inputs).send(frames_of(rows, codecs))
    assert (passed["wire"] > 0).sum() == 3


def test_an_announcement_of_absence_is_on_no_wire(codecs):
    absent = codecs["veh1"].encode("BenchAbsent", {"Identifier": 0x200, "Cycle": 0}, 0)
    other = codecs["veh1"].encode("BenchAbsent", {"Identifier": 0x300, "Cycle": 0}, 0)
    rows = [("veh1", 0, "BenchSync", 0), ("veh1", 0, "SteeringCommand", 0), ("veh1", 0, *absent), ("veh1", 0, *other)]
    swapped = [*rows[:2], rows[3], rows[2]]
    with_it, without, turned = (
        BusTimeline(codecs, INPUTS).send(frames_of(each, codecs)) for each in (rows, rows[:2], swapped)
    )
    assert with_it["wire"][2:].tolist() == [0, 0]
    assert with_it[:2].tobytes() == without.tobytes()
    # They come from several processes, so the order they came in must not show.
    assert turned.tobytes() == with_it.tobytes()


def test_in_real_time_a_frame_waits_from_its_receipt_on(codecs):
    rows = [("veh1", 0, "BenchSync", 0), ("veh1", 0, "PlantTiming", 0), ("veh1", 0, "VehiclePosition", 0)]
    frames = frames_of(rows, codecs)
    begin = 1_790_000_000_000_000_000
    # The position comes while the timing is under way.
    frames["receive"] = begin + np.array([0, 1_000_000, 1_050_000])
    timeline = BusTimeline(codecs, {}, realtime=True)
    passed = np.concatenate([timeline.send(frames), timeline.send(frames_of([], codecs), last=True)])
    sync, timing, position = passed
    assert sync["wire"] == sync["response"] == duration(sync, "veh1")
    assert timing["wire"] == 1_000_000 + duration(timing, "veh1")
    end = int(timing["wire"]) + INTERFRAME_BITS * BIT_NS["veh1"] + duration(position, "veh1")
    assert position["wire"] == end
    assert position["response"] == end - 1_050_000


def test_a_flood_that_no_bus_could_carry_does_not_wait_for_ever():
    """The frames of a cycle that do not fit into it are held for the next, but a bounded number of them."""
    timeline = BusTimeline(load_codecs(2), INPUTS)
    returned, held_most, cycles, count = 0, 0, 300, 128
    for cycle in range(cycles):
        frames = np.zeros(count, FRAME)
        frames["bus"], frames["can_id"], frames["length"], frames["time"] = 1, 0x7FF, 8, cycle * CYCLE_NS
        returned += len(timeline.send(frames))
        held_most = max(held_most, (cycle + 1) * count - returned)
    assert returned < cycles * count
    assert 10 * count < held_most <= MOST_HELD + 2 * count
    rest = timeline.send(np.zeros(0, FRAME), last=True)
    assert returned + len(rest) == cycles * count
    assert (rest["wire"] > 0).all()
