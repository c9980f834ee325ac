"""Frames decoded by numpy against cantools, for layouts that the bench's own DBC does not have."""

import cantools
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.errors import BadInput
from bench.record.layout import message_class
from bench.record.signals import SignalTable, signal_message

DBC = """
VERSION ""
BS_:
BU_: ECU
BO_ 1 Intel: 8 ECU
 SG_ Whole : 0|12@1+ (1,0) [0|0] "" ECU
 SG_ Signed : 12|13@1- (0.25,-3) [0|0] "m" ECU
 SG_ Wide : 25|32@1- (1,0) [0|0] "" ECU
 SG_ State : 57|3@1+ (1,0) [0|7] "" ECU
BO_ 2 Motorola: 8 ECU
 SG_ High : 7|12@0+ (0.5,10) [0|0] "" ECU
 SG_ Low : 11|20@0- (0.001,0) [0|0] "" ECU
 SG_ Mixed : 40|9@1- (2,1) [0|0] "" ECU
BO_ 3 Floats: 8 ECU
 SG_ A : 0|32@1- (1,0) [0|0] "" ECU
 SG_ B : 32|32@1- (1,0) [0|0] "" ECU
BO_ 4 Double: 8 ECU
 SG_ D : 0|64@1- (1,0) [0|0] "" ECU
BO_ 5 Short: 3 ECU
 SG_ S : 3|17@1+ (0.1,0) [0|0] "" ECU
SIG_VALTYPE_ 3 A : 1;
SIG_VALTYPE_ 3 B : 1;
SIG_VALTYPE_ 4 D : 2;
VAL_ 1 State 1 "On" 2 "On" 5 "Not here" ;
"""
DATABASE = cantools.database.load_string(DBC, database_format="dbc")
MESSAGES = [signal_message("test", message, wall_clock=False) for message in DATABASE.messages]
TABLE = SignalTable(MESSAGES)


@settings(deadline=None)
@given(st.lists(st.tuples(st.integers(0, len(MESSAGES) - 1), st.binary(min_size=8, max_size=8)), max_size=20))
def test_any_mix_of_frames_is_decoded_as_cantools_decodes_it(frames):
    data = np.frombuffer(b"".join(d for _, d in frames), np.uint8).reshape(-1, 8)
    rows, signals, values = TABLE.decode(data, np.array([number for number, _ in frames], np.int64))
    names = [(m.name, name) for m in MESSAGES for name in m.layout.values]
    found = {}
    for row, signal, value in zip(rows.tolist(), signals.tolist(), values.tolist(), strict=True):
        found.setdefault(row, {})[names[signal]] = value
    for row, (number, raw) in enumerate(frames):
        message = MESSAGES[number]
        wanted = DATABASE.decode_message(message.can_id, raw[: message.length], decode_choices=False)
        assert found[row].keys() == {(message.name, name) for name in wanted}
        for name, value in wanted.items():
            np.testing.assert_equal(found[row][message.name, name], float(value))


def test_kinds_follow_scale_sign_and_value_table():
    kinds = {field.name: field.kind for message in MESSAGES for field in message.layout.fields}
    assert kinds == {
        **{"Whole": "fixed32", "Signed": "double", "Wide": "sfixed32", "State": "enum"},
        **{"High": "double", "Low": "double", "Mixed": "double", "A": "float", "B": "float", "D": "double"},
        "S": "double",
    }


def test_value_tables_become_valid_enumerations_whatever_they_hold():
    values = message_class("test.Intel", MESSAGES[0].schema).DESCRIPTOR.fields_by_name["State"].enum_type.values
    assert {v.number: v.name for v in values} == {0: "Value0", 1: "On", 2: "On_2", 5: "Not_here"}


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ('SG_ S : 0|54@1+ (1,0) [0|0] "" ECU', "54 bits"),
        ('SG_ M M : 0|4@1+ (1,0) [0|0] "" ECU\n SG_ S m0 : 8|8@1+ (1,0) [0|0] "" ECU', "multiplexed: True"),
    ],
)
def test_what_the_log_cannot_hold_is_refused(line, message):
    database = cantools.database.load_string(f'VERSION ""\nBU_: ECU\nBO_ 1 Odd: 8 ECU\n {line}\n')
    with pytest.raises(BadInput, match=message):
        signal_message("test", database.messages[0], wall_clock=False)
