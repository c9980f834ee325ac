"""The worst case of a bus, against the paper's example, a simulation and the shipped DBC files."""

import random
from heapq import heappop, heappush

import pytest

from bench.bus.codec import DBC_DIR, Codec, load_codecs
from bench.bus.link.base import EXTENDED
from bench.bus.wire.schedulability import Stream, WorstCase, check_load, load, response_times, streams
from bench.errors import BadInput

MS = 1_000_000
# 7 bytes take 1 ms at 125 kbit/s: the example of Davis et al. (2007) that the analysis of 1994 passes.
PAPER = [
    Stream("A", 1, 7, 2_500_000),
    Stream("B", 2, 7, 3_500_000),
    Stream("C", 3, 7, 3_500_000),
]


def test_the_papers_example_where_the_first_analysis_was_wrong():
    """C's first frame takes 3 ms, its second 3.5 ms, beyond its deadline of 3.25 ms; the bus is used to 97 %."""
    worst = response_times(PAPER, 125_000)
    assert {can_id: found.response_ns for can_id, found in worst.items()} == {1: 2 * MS, 2: 3 * MS, 3: 3_500_000}
    assert load(PAPER, 125_000) == pytest.approx(0.971, abs=5e-4)


def test_the_priority_decides_and_not_the_order_given():
    assert response_times(PAPER[::-1], 125_000) == response_times(PAPER, 125_000)


def test_a_frame_alone_takes_its_own_time_and_jitter():
    alone = Stream("A", 1 | EXTENDED, 8, 10 * MS, jitter_ns=300_000)
    assert response_times([alone], 500_000) == {alone.can_id: WorstCase(300_000 + 160 * 2000, 160 * 2000)}


def test_there_is_no_bound_where_higher_priorities_take_all():
    full = [Stream("A", 1, 7, MS), Stream("B", 2, 7, 100 * MS)]
    assert response_times(full, 125_000) == {1: None, 2: None}
    halves = [Stream("A", 1, 7, 2 * MS), Stream("B", 2, 7, 2 * MS)]
    assert response_times(halves, 125_000) == {1: WorstCase(2 * MS, 2 * MS), 2: None}


def test_there_is_no_bound_beyond_the_horizon_and_none_is_looked_for():
    """A damaged log may have any jitter: frames of it in one busy period would be too many to go through."""
    late = [Stream("a", 1, 8, 10 * MS), Stream("b", 2, 8, 10 * MS, jitter_ns=1 << 62), Stream("c", 3, 8, 10 * MS)]
    assert list(response_times(late, 500_000)) == [1, 2, 3]
    assert [found is None for found in response_times(late, 500_000).values()] == [False, True, True]


def simulated(messages, bit_ns, until, generator):
    """Longest time from release to end of each message's longest frames; without a generator all begin together."""
    releases = []
    for message in messages:
        at = generator.randint(0, message.period_ns) if generator else 0
        while at < until:
            late = generator.randint(0, message.jitter_ns) if generator else 0
            heappush(releases, (at + late, message.can_id, message.bits * bit_ns))
            at += message.period_ns
    worst = dict.fromkeys((message.can_id for message in messages), 0)
    now, ready = 0, []
    while releases or ready:
        if not ready:
            now = max(now, releases[0][0])
        while releases and releases[0][0] <= now:
            release, can_id, length = heappop(releases)
            heappush(ready, (can_id, release, length))
        can_id, release, length = heappop(ready)
        now += length
        worst[can_id] = max(worst[can_id], now - release)
    return worst


@pytest.mark.parametrize("seed", range(30))
def test_no_simulation_goes_beyond_the_bound(seed):
    generator = random.Random(seed)
    messages = []
    while load(messages, 125_000) < 0.75:
        period = generator.choice([5, 8, 10, 20, 35]) * MS
        jitter = generator.choice([0, 0, period // 4, period])
        messages.append(Stream("", len(messages) + 1, generator.randint(0, 8), period, jitter))
    messages = messages[:-1]
    bounds = response_times(messages, 125_000)
    worst = simulated(messages, 8000, 400 * MS, generator)
    assert all(worst[m.can_id] <= bounds[m.can_id].from_release_ns for m in messages)


def test_the_paper_example_can_really_happen():
    """C has no lower priority to wait for, so its worst case is that all begin together; the others' is not."""
    assert simulated(PAPER, 8000, 35 * MS, None)[3] == 3_500_000


def test_the_shipped_buses_carry_their_messages_in_time():
    for vehicles in (1, 3, 16):
        assert check_load(load_codecs(vehicles), vehicles) == []


def test_what_the_bench_alone_needs_and_who_is_not_there_do_not_count():
    codecs = load_codecs(2)
    names = [stream.name for stream in streams("v2v", codecs["v2v"], 2)]
    assert names[:3] == ["BenchSync", "V2VPosition_1", "V2VPosition_2"]
    assert {name.rpartition("_")[2] for name in names[1:]} == {"1", "2"}
    assert "BenchAbsent" not in [stream.name for stream in streams("veh1", codecs["veh1"], 2)]


def test_a_period_is_that_of_the_dbc_in_cycles():
    codec = edited("vehicle", ('"GenMsgCycleTime" BO_ 256 10;', '"GenMsgCycleTime" BO_ 256 40;'))
    assert {s.name: s.period_ns for s in streams("veh1", codec, 1)}["VehiclePosition"] == 40 * MS


def edited(name, *changes):
    text = (DBC_DIR / f"{name}.dbc").read_text(encoding="cp1252")
    for before, after in changes:
        assert before in text
        text = text.replace(before, after)
    return Codec.from_bytes(text.encode(), "test.dbc")


def test_an_overloaded_bus_is_refused_with_what_helps():
    slow = edited("vehicle", ('BA_ "Baudrate" 500000;', 'BA_ "Baudrate" 125000;'))
    codecs = load_codecs(2) | {"veh1": slow, "veh2": slow}
    with pytest.raises(BadInput) as refused:
        check_load(codecs, 2)
    text = str(refused.value)
    assert text.startswith("bus veh1 to veh2: overloaded: ")
    share = round(100 * load(streams("veh1", slow, 2), 125_000))
    assert f"{share} % of 125 kbit/s" in text
    assert "dbc/vehicle.dbc set Baudrate to 250000 bit/s" in text
    assert "v2v" not in text


def test_too_many_vehicles_for_the_radio_are_named():
    slow = edited("v2v", ('BA_ "Baudrate" 1000000;', 'BA_ "Baudrate" 250000;'))
    with pytest.raises(BadInput, match=r"v2v: overloaded: .*dbc/v2v.dbc .* or fewer than 16 vehicles"):
        check_load(load_codecs(16) | {"v2v": slow}, 16)
    assert check_load(load_codecs(3) | {"v2v": slow}, 3) == []


def test_a_message_that_may_be_late_is_a_warning():
    """VehiclePosition in every cycle of a bus that is nearly full: the lowest priorities may take longer."""
    slow = edited("vehicle", ('BA_ "Baudrate" 500000;', 'BA_ "Baudrate" 230000;'))
    (codecs, used) = ({"veh1": slow}, load(streams("veh1", slow, 1), 230_000))
    assert 0.9 < used < 1.0
    warnings = check_load(codecs, 1)
    status = next(each for each in warnings if each.message == "TrackerStatus")
    assert (status.bus, status.can_id, status.period_ms, status.bit_rate) == ("veh1", 0x510, 10.0, 230_000)
    assert status.response_ms is None or status.response_ms > 10.0
    # The diagnostics behind it have five times as long.
    assert not any(each.message in ("VehiclePosition", "TrackerTarget", "PlantTiming") for each in warnings)
