"""E2E Profile 1 against an independent implementation (autosar-e2e), and what the receiver makes of it."""

import random

import pytest
from e2e import p01
from hypothesis import given
from hypothesis import strategies as st

from bench.bus import e2e
from bench.bus.e2e import Receiver, Status

DATA = st.binary(min_size=8, max_size=8)
DATA_ID = st.integers(0, 0xFFFF)
ID = 0x0102


def frame(counter, data_id=ID, payload=b"\x00\x50abcdef"):
    data = bytearray(payload)
    e2e.protect(data, data_id, counter)
    return bytes(data)


@given(st.binary(min_size=2, max_size=8), DATA_ID, st.integers(0, 14))
def test_protect_gives_what_autosar_e2e_gives(payload, data_id, counter):
    ours, theirs = bytearray(payload), bytearray(payload)
    e2e.protect(ours, data_id, counter)
    theirs[1] = theirs[1] & 0xF0 | counter
    p01.e2e_p01_protect(theirs, data_id, data_id_mode=p01.E2E_P01_DATAID_BOTH, increment_counter=False)
    assert ours == theirs


def test_crc_equals_autosar_e2e_on_many_random_messages():
    rng = random.Random(1)
    for _ in range(20_000):
        data, data_id = bytearray(rng.randbytes(8)), rng.randrange(0x10000)
        assert e2e.check(data, data_id) == p01.e2e_p01_check(data, data_id)
        p01.e2e_p01_protect(data, data_id)
        assert e2e.check(data, data_id)
        assert p01.e2e_p01_check(data, data_id)


@given(DATA, DATA_ID, st.integers(0, 63))
def test_every_flipped_bit_is_found(payload, data_id, bit):
    data = bytearray(payload)
    e2e.protect(data, data_id, 3)
    data[bit // 8] ^= 1 << bit % 8
    assert not e2e.check(data, data_id)


@given(DATA, DATA_ID, st.integers(0, 1000))
def test_the_counter_runs_from_0_to_14(payload, data_id, counter):
    data = bytearray(payload)
    e2e.protect(data, data_id, counter)
    assert data[1] & 0x0F == counter % 15
    assert data[1] & 0xF0 == payload[1] & 0xF0


@pytest.mark.parametrize("data", [b"", b"\x00"])
def test_a_frame_too_short_is_an_error(data):
    assert not e2e.check(data, 0)
    assert Receiver(0).check(data) is Status.ERROR


def test_an_unbroken_sequence_is_ok_through_every_wrap():
    receiver = Receiver(ID)
    assert receiver.status is Status.NONE
    for counter in range(40):
        assert receiver.check(frame(counter)) is Status.OK
        assert receiver.age == 0
    assert receiver.errors == 0


def test_a_frame_again_is_repeated_and_the_sequence_goes_on():
    receiver = Receiver(ID)
    assert [receiver.check(frame(c)) for c in (5, 5, 6)] == [Status.OK, Status.REPEATED, Status.OK]
    assert receiver.errors == 1


@pytest.mark.parametrize("step", range(2, 15))
def test_a_gap_is_a_wrong_sequence_once(step):
    receiver = Receiver(ID)
    results = [receiver.check(frame(c)) for c in (7, 7 + step, 8 + step)]
    assert results == [Status.OK, Status.WRONG_SEQUENCE, Status.OK]
    assert receiver.errors == 1


@pytest.mark.parametrize("missed", range(1, 14))
def test_missed_cycles_allow_as_large_a_step(missed):
    receiver = Receiver(ID)
    receiver.check(frame(0))
    for age in range(1, missed + 1):
        assert receiver.missed() is Status.NONE
        assert receiver.age == age
    assert receiver.check(frame(missed + 1)) is Status.OK
    assert receiver.age == 0
    assert receiver.check(frame(missed + 3)) is Status.WRONG_SEQUENCE


def test_a_step_beyond_the_missed_cycles_is_wrong():
    receiver = Receiver(ID)
    receiver.check(frame(0))
    receiver.missed()
    assert receiver.check(frame(3)) is Status.WRONG_SEQUENCE


def test_a_sender_of_a_message_with_another_data_id_is_refused():
    receiver = Receiver(ID)
    assert receiver.check(frame(0, data_id=ID + 1)) is Status.ERROR
    assert receiver.errors == 1
    assert receiver.check(frame(9)) is Status.OK


def test_counter_15_is_an_error_though_its_crc_is_right():
    data = bytearray(frame(0))
    data[1] |= 0x0F
    data[0] = e2e.crc_of_message(data, ID)
    assert not e2e.check(data, ID)
    assert Receiver(ID).check(data) is Status.ERROR


def test_a_damaged_frame_does_not_move_the_sequence():
    receiver = Receiver(ID)
    receiver.check(frame(0))
    damaged = bytearray(frame(9))
    damaged[4] ^= 0x10
    assert receiver.check(damaged) is Status.ERROR
    assert receiver.check(frame(1)) is Status.OK
    assert receiver.errors == 1


def test_a_wider_step_is_taken_where_it_is_allowed():
    receiver = Receiver(ID, max_step=3)
    assert [receiver.check(frame(c)) for c in (0, 3, 7)] == [Status.OK, Status.OK, Status.WRONG_SEQUENCE]


def test_the_tables_are_those_of_the_polynomial():
    """They are made when the module is imported; made again here, so that a mutant of what makes them shows."""
    assert e2e._crc_table() == e2e.CRC_TABLE


@pytest.mark.parametrize("counter", [0, 14])
def test_the_shortest_frame_has_two_bytes(counter):
    assert e2e.check(frame(counter, payload=bytes(2)), ID)


def test_every_refused_frame_counts_and_the_age_is_that_of_the_last_good_one():
    receiver = Receiver(ID)
    assert (receiver.age, receiver.errors) == (0, 0)
    receiver.missed()
    assert receiver.age == 1
    assert receiver.check(frame(0)) is Status.OK
    assert receiver.age == 0
    for errors in (1, 2, 3):
        assert receiver.check(frame(0)) is Status.REPEATED
        assert receiver.errors == errors


@pytest.mark.parametrize("length", range(1, 12))
def test_each_further_byte_continues_the_crc(length: int) -> None:
    data = bytes(37 * index % 251 for index in range(length + 1))
    assert e2e.crc_of_message(data, 0x1234) == e2e.CRC_TABLE[e2e.crc_of_message(data[:-1], 0x1234) ^ data[-1]]
