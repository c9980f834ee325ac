"""Frames decoded many at once, and one by one, against cantools, for layouts that the bench's own DBC does not have."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.bus.codec import Codec
from bench.errors import BadInput
from bench.record.layout import message_class
from bench.record.signals import SignalTable, signal_message

DBC = """
VERSION ""
BS_:
BU_: ECU
BO_ 1 Whole: 8 ECU
 SG_ Whole : 0|12@1+ (1,0) [0|4095] "" ECU
 SG_ Signed : 12|13@1- (0.25,-3) [-1000|1000] "m" ECU
 SG_ Wide : 25|32@1- (1,0) [-1|1] "" ECU
 SG_ State : 57|3@1+ (1,0) [0|7] "" ECU
BO_ 2 Widest: 8 ECU
 SG_ Widest : 11|53@1- (1,0) [-1|1] "" ECU
 SG_ Negative : 0|9@1- (-2,1) [-400|400] "" ECU
BO_ 3 Floats: 8 ECU
 SG_ A : 31|32@1- (1,0) [-1|1] "" ECU
 SG_ Before : 0|31@1+ (0.001,0) [0|1] "" ECU
BO_ 5 Short: 3 ECU
 SG_ S : 3|17@1+ (0.1,0) [0|1] "" ECU
SIG_VALTYPE_ 3 A : 1;
VAL_ 1 State 1 "On" 2 "On" 5 "Not here" ;
"""
CODEC = Codec.from_bytes(DBC.encode(), "test.dbc")
MESSAGES = [signal_message("test", CODEC, name) for name in CODEC.names]
TABLE = SignalTable(MESSAGES)


@settings(deadline=None)
@given(st.lists(st.tuples(st.integers(0, len(MESSAGES) - 1), st.binary(min_size=8, max_size=8)), max_size=20))
def test_any_mix_of_frames_is_decoded_as_cantools_decodes_it(frames):
    data = np.frombuffer(b"".join(d for _, d in frames), np.uint8).reshape(-1, 8)
    first, values = TABLE.decode(data, np.array([number for number, _ in frames], np.int64))
    found = [
        {(MESSAGES[number].name, name): values[at + place] for place, name in enumerate(MESSAGES[number].layout.values)}
        for (number, _), at in zip(frames, first.tolist(), strict=True)
    ]
    assert len(values) == sum(map(len, found))
    for row, (number, raw) in enumerate(frames):
        message = MESSAGES[number]
        payload = raw[: message.length]
        wanted = CODEC.database.decode_message(message.can_id, payload, decode_choices=False)
        np.testing.assert_equal(CODEC.decode(message.can_id, payload), (message.name, wanted))
        assert found[row].keys() == {(message.name, name) for name in wanted}
        for name, value in wanted.items():
            np.testing.assert_equal(found[row][message.name, name], float(value))


def test_kinds_follow_scale_sign_and_value_table():
    kinds = {field.name: field.kind for message in MESSAGES for field in message.layout.fields}
    assert kinds == {
        **{"Whole": "fixed32", "Signed": "double", "Wide": "sfixed32", "State": "enum"},
        **{"Widest": "double", "Negative": "double", "A": "float", "Before": "double", "S": "double"},
    }


def test_value_tables_become_valid_enumerations_whatever_they_hold():
    values = message_class("test.Whole", MESSAGES[0].schema).DESCRIPTOR.fields_by_name["State"].enum_type.values
    assert {v.number: v.name for v in values} == {0: "Value0", 1: "On", 2: "On_2", 5: "Not_here"}


@pytest.mark.parametrize(("length", "signal", "complaint"), [(8, "0|54@1+", "54 bits"), (9, "0|8@1+", "9 bytes")])
def test_what_the_log_cannot_hold_is_refused(length, signal, complaint):
    text = f'VERSION ""\nBU_: ECU\nBO_ 1 Odd: {length} ECU\n SG_ S : {signal} (1,0) [0|1] "" ECU\n'
    with pytest.raises(BadInput, match=complaint):
        signal_message("test", Codec.from_bytes(text.encode(), "odd.dbc"), "Odd")
