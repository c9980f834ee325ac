"""The gate at the conductor's end of the buses: what it refuses, why, and that it keeps little of it."""

import random

import pytest

from bench.bus.codec import load_codecs
from bench.bus.frame import CanFrame
from bench.bus.link.base import EXTENDED
from bench.conductor.refusals import MOST_LOGGED, MOST_NAMED, OTHERS, Refusals
from bench.events import FramesRefused, Refusal, StrayFrame

CODECS = load_codecs(2)


@pytest.fixture
def refusals() -> Refusals:
    return Refusals(CODECS)


@pytest.mark.parametrize("bus", ["v2v", "veh1"])
def test_every_message_of_the_dbc_is_whole_in_its_length_only(refusals: Refusals, bus: str) -> None:
    codec = CODECS[bus]
    for name in codec.names:
        can_id, data = codec.encode(name, codec.start_values(name), 3)
        assert refusals.flaw(bus, can_id, data) is None
        for length in {*range(65)} - {len(data)}:
            assert refusals.flaw(bus, can_id, (data * 9)[:length]) is Refusal.LENGTH
        damaged = bytes([data[0] ^ 1, *data[1:]])
        assert refusals.flaw(bus, can_id, damaged) is (Refusal.DAMAGED if codec.data_id(name) else None)
        assert refusals.flaw(bus, can_id | EXTENDED, data) is Refusal.UNKNOWN
    assert refusals.flaw(bus, 0x7FF, b"") is Refusal.UNKNOWN


def test_the_first_of_bus_identifier_and_reason_is_an_event_and_all_are_counted(refusals: Refusals) -> None:
    for _ in range(3):
        refusals.refuse("veh1", CanFrame(0x107, b"1"), Refusal.LENGTH)
    refusals.refuse("veh2", CanFrame(0x107, b"1"), Refusal.LENGTH)
    refusals.refuse("veh1", CanFrame(0x100, b""), Refusal.LENGTH)
    refusals.without_data("veh1")(Refusal.REMOTE, 0x107)
    refusals.without_data("veh1")(Refusal.MALFORMED, None)
    assert refusals.news() == [
        StrayFrame("veh1", 0x107, "wrong_length", 1),
        StrayFrame("veh2", 0x107, "wrong_length", 1),
        StrayFrame("veh1", 0x100, "wrong_length", 0),
        StrayFrame("veh1", 0x107, "remote_frame", None),
        StrayFrame("veh1", None, "malformed", None),
    ]
    assert refusals.news() == []
    assert refusals.totals == [
        FramesRefused(
            "veh1",
            {"wrong_length": 4, "remote_frame": 1, "malformed": 1},
            {"wrong_length": {"0x107": 3, "0x100": 1}, "remote_frame": {"0x107": 1}, "malformed": {OTHERS: 1}},
        ),
        FramesRefused("veh2", {"wrong_length": 1}, {"wrong_length": {"0x107": 1}}),
    ]
    assert refusals.totals[0].text == (
        "6 frames on veh1 were refused in the run: 4 of a wrong length, 1 remote frame, 1 that is not a CAN frame"
    )


@pytest.mark.parametrize(
    ("event", "text"),
    [
        (StrayFrame("veh1", 0x107, "wrong_length", 1), "frame 0x107 on veh1 (1 byte) is refused: of a wrong length"),
        (StrayFrame("veh1", 0x107, "wrong_length", 0), "frame 0x107 on veh1 (0 bytes) is refused: of a wrong length"),
        (StrayFrame("v2v", None, "malformed"), "frame on v2v is refused: not a CAN frame"),
        (StrayFrame("veh2", 0x107, "fd_frame", 64), "frame 0x107 on veh2 (64 bytes) is refused: a CAN FD frame"),
        (
            FramesRefused("veh1", {"fd_frame": 28771, "error_frame": 1, "malformed": 2, "of_later_times": 3}, {}),
            "28,777 frames on veh1 were refused in the run: 28,771 CAN FD frames, 1 error frame, "
            "2 that are not CAN frames, 3 of_later_times",
        ),
        (
            FramesRefused("v2v", {"unknown_identifier": 1}, {}),
            "1 frame on v2v was refused in the run: 1 of an identifier that the bus does not have",
        ),
    ],
)
def test_an_event_says_what_was_refused_and_why(event: StrayFrame | FramesRefused, text: str) -> None:
    assert event.text == text


def test_a_flood_of_identifiers_makes_a_bounded_number_of_events(refusals: Refusals) -> None:
    dice = random.Random(1)
    for _ in range(20_000):
        refusals.refuse("veh1", CanFrame(EXTENDED | dice.randrange(1 << 29), b""), Refusal.UNKNOWN)
    assert len(refusals.news()) == MOST_NAMED + 1
    (total,) = refusals.totals
    assert total.counts == {"unknown_identifier": 20_000}
    assert total.identifiers["unknown_identifier"][OTHERS] == 20_000 - MOST_NAMED


def test_the_log_has_as_many_of_a_cycle_as_a_bus_can_carry(refusals: Refusals) -> None:
    for _ in range(2):
        refusals.begin_cycle()
        logged = [refusals.refuse("veh1", CanFrame(0x7FF, b""), Refusal.UNKNOWN) for _ in range(500)]
        assert logged == [True] * MOST_LOGGED + [False] * (500 - MOST_LOGGED)
        assert refusals.refuse("veh2", CanFrame(0x7FF, b""), Refusal.UNKNOWN)
