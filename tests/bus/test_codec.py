"""The codec against cantools' own, over every message, values dense at the limits."""

import math
import subprocess
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.bus import e2e
from bench.bus.codec import DBC_DIR, Codec, DecodeError, EncodeError, bus_names, load_codecs
from bench.errors import BadInput

CODECS = load_codecs(1)
MESSAGES = [(bus, name) for bus, codec in CODECS.items() for name in codec.names]
FRAME_BYTES = st.binary(min_size=8, max_size=8)

MOTION = {"VelocityX": 20.0, "VelocityY": -0.5, "YawRate": 0.1}

ONE_MESSAGE = """VERSION ""
BU_: A B
BO_ 5 M: 8 A
 SG_ {signal} "" B
BA_DEF_ BO_ "E2EDataId" INT 0 65535;
BA_DEF_DEF_ "E2EDataId" 0;
{more}
"""


def values_of(signal):
    """Physical values of a signal, those at and next to both ends of its range and at rounding ties often."""
    low, high = float(signal.minimum), float(signal.maximum)
    if signal.is_float:
        return st.floats(low, high, width=32)
    steps = st.integers(round(low / signal.scale), round(high / signal.scale))
    near = st.sampled_from([0, 0.25, 0.49999, 0.5, 0.50001, 1, 1.5, -0.5])
    at_ends = st.builds(lambda end, k: end + k * float(signal.scale), st.sampled_from([low, 0.0, high]), near)
    ties = st.builds(lambda step, k: (step + k) * float(signal.scale), steps, near)
    return (st.floats(low, high) | at_ends | ties).map(lambda value: min(max(value, low), high))


@st.composite
def coded(draw):
    """One message of either bus with a value for each of its signals and a counter."""
    bus, name = draw(st.sampled_from(MESSAGES))
    message = CODECS[bus].message(name)
    values = {s.name: draw(values_of(s)) for s in message.signals if s.name not in ("CRC", "AliveCounter")}
    return CODECS[bus], message, values, draw(st.integers(0, 10_000))


@given(coded())
def test_encode_gives_cantools_bytes(case):
    codec, message, values, counter = case
    can_id, data = codec.encode(message.name, values, counter)
    assert can_id == message.frame_id
    expected = dict(values)
    if codec.is_protected(can_id):
        expected |= {"AliveCounter": counter % 15, "CRC": data[0]}
        assert e2e.check(data, codec.data_id(message.name))
    assert data == message.encode(expected, strict=True)


@given(st.sampled_from(MESSAGES), FRAME_BYTES)
def test_decode_gives_cantools_values_for_any_bytes(bus_and_name, data):
    bus, name = bus_and_name
    message = CODECS[bus].message(name)
    decoded, values = CODECS[bus].decode(message.frame_id, data)
    assert decoded == name
    expected = message.decode(data, decode_choices=False)
    assert set(values) == set(expected)
    for signal, value in expected.items():
        assert values[signal] == value or (math.isnan(value) and math.isnan(values[signal]))


@given(coded())
def test_what_is_decoded_is_what_was_encoded_to_half_a_step(case):
    codec, message, values, counter = case
    _, decoded = codec.decode(*codec.encode(message.name, values, counter))
    for signal in message.signals:
        if signal.name in values:
            half_step = 0 if signal.is_float else 0.5 * float(signal.scale)
            assert abs(decoded[signal.name] - values[signal.name]) <= half_step + 1e-12 * abs(values[signal.name])


@given(coded())
def test_coding_a_second_time_changes_nothing(case):
    codec, message, values, counter = case
    frame = codec.encode(message.name, values, counter)
    assert codec.encode(message.name, codec.decode(*frame)[1], counter) == frame


@pytest.mark.parametrize(("bus", "name"), MESSAGES)
@pytest.mark.parametrize("beyond", [1e-9, 1.0, 1e300, math.inf])
def test_values_outside_the_range_become_its_nearest_end_and_are_counted(bus, name, beyond):
    codec = load_codecs(1)[bus]
    signals = [s for s in codec.message(name).signals if s.name not in ("CRC", "AliveCounter")]
    for end, sign in (("maximum", 1), ("minimum", -1)):
        ends = {s.name: float(getattr(s, end)) for s in signals}
        outside = {name: value + sign * max(beyond, abs(value) * 1e-12) for name, value in ends.items()}
        assert codec.encode(name, outside, 1) == codec.encode(name, ends, 1)
    assert codec.saturated == 2 * len(signals)
    assert codec.not_numbers == 0


@pytest.mark.parametrize(("bus", "name"), MESSAGES)
def test_nan_becomes_the_start_value_and_is_counted(bus, name):
    codec = load_codecs(1)[bus]
    start = codec.start_values(name)
    frame = codec.encode(name, dict.fromkeys(start, math.nan), 3)
    assert codec.not_numbers == len(start)
    assert frame == codec.encode(name, start, 3)
    assert codec.decode(*frame)[1].items() >= start.items()
    assert codec.saturated == 0


def test_start_values_are_those_of_the_dbc():
    assert CODECS["veh1"].start_values("TrackerStatus") == {
        "State": 0,
        "SolverStatus": 6,
        "GainSource": 3,
        "Iterations": 0,
        "Cause": 0,
        "Tau": 0,
    }


def test_a_missing_signal_is_named():
    with pytest.raises(EncodeError, match=r"VehicleMotion.*'YawRate'.*VelocityX, VelocityY"):
        CODECS["veh1"].encode("VehicleMotion", {"VelocityX": 1.0, "VelocityY": 0.0})


def test_values_of_other_names_are_left_aside():
    codec = CODECS["veh1"]
    more = MOTION | {"CRC": 77.0, "AliveCounter": 9.0, "Colour": 1.0}
    assert codec.encode("VehicleMotion", more, 4) == codec.encode("VehicleMotion", MOTION, 4)


@pytest.mark.parametrize("method", ["message", "can_id", "data_id", "start_values"])
def test_an_unknown_message_is_named_with_those_there_are(method):
    with pytest.raises(EncodeError, match=r"'Speed' is not in the DBC; it has BenchSync, BenchAbsent, VehiclePosition"):
        getattr(CODECS["veh1"], method)("Speed")


def test_encoding_an_unknown_message_is_refused():
    with pytest.raises(EncodeError, match="'Speed'"):
        CODECS["veh1"].encode("Speed", {})


def test_every_identifier_that_is_not_in_the_dbc_is_refused():
    for codec in CODECS.values():
        known = {codec.can_id(name) for name in codec.names}
        for can_id in (*range(0x800), 0x80000100, -1):
            if can_id in known:
                assert codec.decode(can_id, bytes(8))[0] in codec.names
            else:
                with pytest.raises(DecodeError, match="not in the DBC"):
                    codec.decode(can_id, bytes(8))


@pytest.mark.parametrize("length", [0, 1, 7, 9])
def test_a_frame_of_wrong_length_is_refused(length):
    with pytest.raises(DecodeError, match=rf"VehicleMotion: {length} bytes instead of 8"):
        CODECS["veh1"].decode(0x102, bytes(length))


def test_only_timing_messages_are_wall_clock():
    codec = CODECS["veh1"]
    marked = {name for name in codec.names if codec.is_wall_clock(codec.can_id(name))}
    assert marked == {"PlannerTiming", "TrackerTiming", "PlantTiming"}
    assert not codec.is_wall_clock(0x7FF)
    assert not codec.is_protected(0x7FF)


def test_a_receiver_takes_the_frames_of_its_message_only():
    codec = CODECS["veh1"]
    can_id, data = codec.encode("VehicleMotion", MOTION, 0)
    assert codec.receiver(can_id).check(data) is e2e.Status.OK
    assert codec.receiver(0x103).check(data) is e2e.Status.ERROR
    with pytest.raises(DecodeError, match="not a protected message"):
        codec.receiver(0x5F0)


def test_buses_count_on_their_own():
    codecs = load_codecs(2)
    assert tuple(codecs) == bus_names(2) == ("v2v", "veh1", "veh2")
    codecs["veh1"].encode("VehicleMotion", MOTION | {"YawRate": math.nan})
    assert [codecs[bus].not_numbers for bus in codecs] == [0, 1, 0]


@pytest.mark.parametrize("vehicles", [0, 17, -1])
def test_more_vehicles_than_the_radio_has_messages_for_are_refused(vehicles):
    with pytest.raises(BadInput, match="1 to 16"):
        load_codecs(vehicles)


def test_a_codec_of_the_content_is_that_of_the_file():
    codec = Codec.from_bytes((DBC_DIR / "vehicle.dbc").read_bytes(), "vehicle.dbc")
    assert (codec.file_name, codec.dbc) == (CODECS["veh1"].file_name, CODECS["veh1"].dbc)
    assert codec.names == CODECS["veh1"].names
    assert codec.encode("VehicleMotion", MOTION, 7) == CODECS["veh1"].encode("VehicleMotion", MOTION, 7)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "cp1252"])
@pytest.mark.parametrize("line_end", ["\n", "\r\n"])
def test_a_dbc_is_read_in_either_encoding(tmp_path, encoding, line_end):
    more = 'CM_ SG_ 5 S "Öl\nund Luft";'
    text = ONE_MESSAGE.format(signal="S : 0|8@1+ (1,0) [0|255]", more=more).replace('"" B', '"°C" B')
    (tmp_path / "one.dbc").write_bytes(text.replace("\n", line_end).encode(encoding))
    signal = Codec(tmp_path / "one.dbc").message("M").get_signal_by_name("S")
    assert (signal.unit, signal.comment) == ("°C", "Öl\nund Luft")


def test_a_byte_that_neither_encoding_has_costs_only_itself():
    dbc = ONE_MESSAGE.format(signal="S : 0|8@1+ (1,0) [0|255]", more="").encode().replace(b'"" B', b'"\xb0\x81" B')
    assert Codec.from_bytes(dbc, "one.dbc").message("M").get_signal_by_name("S").unit == "°\N{REPLACEMENT CHARACTER}"


def test_a_dbc_that_is_not_there_or_no_dbc_is_bad_input(tmp_path):
    with pytest.raises(BadInput, match=r"missing\.dbc: cannot read the DBC file"):
        Codec(tmp_path / "missing.dbc")
    (tmp_path / "text.dbc").write_text("Dear Sir or Madam")
    with pytest.raises(BadInput, match=r"text\.dbc: not a valid DBC file"):
        Codec(tmp_path / "text.dbc")


@pytest.mark.parametrize(
    ("signal", "more", "complaint"),
    [
        ("S : 7|8@0+ (1,0) [0|255]", "", "Intel byte order"),
        ("S m0 : 8|8@1+ (1,0) [0|255]", "", "multiplexing"),
        ("S : 0|64@1- (1,0) [0|1]", "SIG_VALTYPE_ 5 S : 2;", "float of 64 bits"),
        ("S : 0|32@1- (2,0) [0|1]", "SIG_VALTYPE_ 5 S : 1;", "scale 1"),
        ("S : 0|8@1+ (0,0) [0|1]", "", "scale is 0"),
        ("S : 0|8@1+ (1,0) [0|0]", "", "range"),
        ("S : 0|8@1+ (1,0) [0|256]", "", "8 bits"),
        ("S : 16|8@1+ (1,0) [0|255]", 'BA_ "E2EDataId" BO_ 5 7;', "needs a signal CRC of 8 bits at bit 0"),
    ],
)
def test_what_the_codec_cannot_code_is_refused(signal, more, complaint):
    if "m0" in signal:
        signal += ' "" B\n SG_ X M : 0|8@1+ (1,0) [0|255]'
    with pytest.raises(BadInput, match=f"message M.*{complaint}"):
        Codec.from_bytes(ONE_MESSAGE.format(signal=signal, more=more).encode(), "one.dbc")


def test_scale_and_offset_are_those_of_cantools():
    dbc = ONE_MESSAGE.format(signal="S : 3|11@1- (0.25,-40) [-200|200]", more="")
    codec = Codec.from_bytes(dbc.encode(), "one.dbc")
    for value in (-200.0, -40.1, -40.0, -39.875, 0.0, 17.3, 200.0):
        can_id, data = codec.encode("M", {"S": value})
        assert data == codec.message("M").encode({"S": value})
        assert codec.decode(can_id, data)[1] == codec.message("M").decode(data)


def test_the_codec_imports_none_of_the_heavy_packages():
    heavy = "numpy scipy pandas pydantic cvxpy casadi"
    code = f"import sys, bench.bus.link.opening; print([m for m in {heavy.split()!r} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_a_message_is_known_by_its_identifier():
    codec = CODECS["veh1"]
    assert [codec.name_of(codec.can_id(name)) for name in codec.names] == list(codec.names)
    assert codec.name_of(0x7FF) is None
