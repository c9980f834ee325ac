"""The DBC files themselves: complete, consistent, fine enough, and in the order of a cycle."""

import logging
import re
import warnings
from collections import Counter
from pathlib import Path

import cantools
import pytest

import bench
from bench.bus import e2e
from bench.bus.codec import DBC_DIR, MAX_VEHICLES, Codec
from bench.bus.reception import ReceptionState
from bench.bus.states import (
    ActuatorState,
    BenchCommand,
    Cause,
    CommandState,
    EcuState,
    Manoeuvre,
    ReferenceState,
)
from bench.control.outcome import GainSource, Limit, SolverStatus

FILES = ("vehicle.dbc", "v2v.dbc")
CODECS = {file: Codec(DBC_DIR / file) for file in FILES}
MESSAGES = [(file, message) for file in FILES for message in CODECS[file].database.messages]
SIGNALS = [(file, message, signal) for file, message in MESSAGES for signal in message.signals]

FINEST_NEEDED = {"m": 1e-3, "m/s": 1e-3, "rad": 1e-5, "rad/s": 1e-4, "Nm": 1.0}
"""Quantisation must be below this for everything that drives something."""

ENUMERATIONS = {
    "Command": BenchCommand,
    "ActuatorState": ActuatorState,
    "ReferenceState": ReferenceState,
    "CommandState": CommandState,
    "State": EcuState,
    "Limit": Limit,
    "SolverStatus": SolverStatus,
    "GainSource": GainSource,
    "Cause": Cause,
    "Manoeuvre": Manoeuvre,
}
"""The enumeration of every signal with a value table; those that show a reception have `ReceptionState`."""

NOT_ON_A_BUS = {"bench.bus.control_channel.Kind", "bench.faults.base.Condition", "bench.vcan.wire.Kind"}
"""Enumerations of other formats than CAN."""

PLANNED = {
    *("PlannerTarget", "TrackerDisturbance", "TrackerReferenceState", "TrackerReferenceInput", "TrackerTarget"),
    *("PlannerTiming", "TrackerTiming", "PlantTiming"),
}
"""Diagnostics that no ECU uses, nor an event depends on: every 50 ms, as often as the planner optimises."""

SLOWER = {"PlantBusHealth", "PlannerPotential", "PlannerGains", "PlannerBusHealth", "TrackerBusHealth"}
"""Diagnostics that change slowly or are only counts: every 100 ms."""

CYCLE_TIMES = dict.fromkeys(PLANNED, 50) | dict.fromkeys(SLOWER, 100)

BENCH_ONLY = "BenchAbsent"
"""Announces frames that will not come in virtual time: not cyclic, and no load of any bus."""


BIT_RATES = {"vehicle.dbc": 500_000, "v2v.dbc": 1_000_000}


def name_of(value):
    return getattr(value, "name", value)


def enumeration_of(signal):
    return ReceptionState if signal.name.endswith("Reception") else ENUMERATIONS.get(signal.name)


def enumerations_in(package):
    """The full name of every class in a package that is an IntEnum, also of what no test imports."""
    for path in sorted(package.rglob("*.py")):
        module = ".".join(path.relative_to(package.parent).with_suffix("").parts)
        for name in re.findall(r"^class (\w+)\((?:enum\.)?IntEnum\)", path.read_text(), re.MULTILINE):
            yield f"{module}.{name}"


def attribute(described, name):
    found = described.dbc.attributes.get(name)
    return 0 if found is None else found.value


@pytest.mark.parametrize("file", FILES)
def test_cantools_loads_it_strictly_without_a_warning(file, caplog):
    with warnings.catch_warnings(), caplog.at_level(logging.INFO):
        warnings.simplefilter("error")
        database = cantools.database.load_file(DBC_DIR / file, strict=True)
    assert not caplog.records
    assert database.buses[0].comment
    assert database.dbc.attributes["BusType"].value == "CAN"
    assert database.dbc.attributes["Baudrate"].value == BIT_RATES[file]
    assert all(node.comment for node in database.nodes)


@pytest.mark.parametrize(("file", "message"), MESSAGES, ids=name_of)
def test_message_is_complete(file, message):
    nodes = {node.name for node in CODECS[file].database.nodes}
    assert message.comment
    assert message.frame_id < 2**11
    assert not message.is_extended_frame
    assert message.length == 8
    assert len(message.senders) == 1
    assert set(message.senders) <= nodes
    if message.name == BENCH_ONLY:
        assert (message.cycle_time, message.send_type) == (None, "Spontaneous")
    else:
        assert message.cycle_time == CYCLE_TIMES.get(message.name, 10)
        # Inputs and commands are those with E2E protection.
        assert message.cycle_time == 10 or not CODECS[file].data_id(message.name)
        assert message.send_type == "Cyclic"
    receivers = set().union(*(signal.receivers for signal in message.signals))
    assert receivers
    assert receivers <= nodes - set(message.senders)


@pytest.mark.parametrize(("file", "message"), MESSAGES, ids=name_of)
def test_no_two_signals_share_a_bit(file, message):  # noqa: ARG001
    bits = Counter(bit for s in message.signals for bit in range(s.start, s.start + s.length))
    assert max(bits) < 64
    assert set(bits.values()) == {1}


@pytest.mark.parametrize(("file", "message", "signal"), SIGNALS, ids=name_of)
def test_signal_is_complete(file, message, signal):  # noqa: ARG001
    assert signal.comment
    assert signal.byte_order == "little_endian"
    assert signal.raw_initial is not None
    assert signal.minimum <= signal.raw_initial * signal.scale <= signal.maximum
    if signal.scale != 1 and signal.name != "BoundaryMargin":
        assert signal.unit
    assert bool(signal.choices) == (enumeration_of(signal) is not None)


@pytest.mark.parametrize(("file", "message", "signal"), SIGNALS, ids=name_of)
def test_range_fits_into_the_bits(file, message, signal):  # noqa: ARG001
    if signal.is_float:
        assert signal.length == 32
        return
    low = -(1 << signal.length - 1) if signal.is_signed else 0
    high = low + (1 << signal.length) - 1
    lowest, highest = (round((end - signal.offset) / signal.scale) for end in (signal.minimum, signal.maximum))
    assert low <= lowest < highest <= high


@pytest.mark.parametrize(("file", "message"), MESSAGES, ids=name_of)
def test_what_drives_something_is_protected_and_fine_enough(file, message):
    if message.frame_id >= 0x500 or message.name == "PlantBusHealth":
        assert not CODECS[file].is_protected(message.frame_id)
        return
    assert CODECS[file].is_protected(message.frame_id)
    assert [(s.name, s.start, s.length) for s in message.signals[:2]] == [
        ("CRC", 0, 8),
        ("AliveCounter", 8, 4),
    ]
    for signal in message.signals:
        if signal.unit in FINEST_NEEDED:
            assert signal.scale < FINEST_NEEDED[signal.unit]


@pytest.mark.parametrize(("file", "message"), MESSAGES, ids=name_of)
def test_every_protected_message_but_the_bench_protocol_has_a_timeout(file, message):
    timeout = attribute(message, "GenMsgTimeoutTime")
    if message.senders == ["Conductor"] or not CODECS[file].is_protected(message.frame_id):
        assert timeout == 0
    else:
        assert timeout in (50, 100)
        assert CODECS[file].timeout_cycles(message.name) == timeout // 10


@pytest.mark.parametrize(("file", "message", "signal"), SIGNALS, ids=name_of)
def test_what_has_inertia_has_a_greatest_rate(file, message, signal):  # noqa: ARG001
    kinds = ("VehiclePosition", "VehicleAttitude", "VehicleMotion", "V2VPosition", "V2VMotion")
    moving = message.name.startswith(kinds) and signal.unit in {"m", "rad", "m/s", "rad/s"}
    rate = attribute(signal, "GenSigRateMax")
    # A course jumps where the vehicle all but stands.
    assert (rate > 0) == (moving and signal.name != "Course")


@pytest.mark.parametrize(
    ("file", "message", "signal"), [each for each in SIGNALS if each[2].choices or enumeration_of(each[2])], ids=name_of
)
def test_value_table_has_the_names_and_values_of_its_enumeration(file, message, signal):  # noqa: ARG001
    names = {member.value: member.name.replace("_", "").lower() for member in enumeration_of(signal)}
    assert {int(value): str(text).lower() for value, text in signal.choices.items()} == names
    assert (signal.minimum, signal.maximum) == (min(names), max(names))


def test_every_enumeration_of_numbers_in_the_code_is_a_value_table():
    tabled = {enumeration_of(signal) for _, _, signal in SIGNALS if signal.choices}
    names = {f"{each.__module__}.{each.__name__}" for each in tabled}
    assert tabled == {*ENUMERATIONS.values(), ReceptionState}
    assert {signal.name for _, _, signal in SIGNALS} >= ENUMERATIONS.keys()
    assert set(enumerations_in(Path(bench.__file__).parent)) == names | NOT_ON_A_BUS


def test_data_ids_are_unique_and_no_crc_takes_one_for_another():
    """CRC-8 maps 65536 data ids onto 256 values; with equal ones a frame could pass for another message."""
    data_ids = {(m.name, m.frame_id): CODECS[f].data_id(m.name) for f, m in MESSAGES}
    protected = [data_id for data_id in data_ids.values() if data_id]
    assert len(protected) > 40
    assert len(set(protected)) == len(protected)
    assert len({e2e.crc_of_id(data_id) for data_id in protected}) == len(protected)


def test_identifier_order_is_the_order_of_a_cycle():
    codec = CODECS["vehicle.dbc"]
    order = sorted(codec.database.messages, key=lambda m: m.frame_id)
    driving = [m.senders[0] for m in order if codec.is_protected(m.frame_id)]
    assert list(dict.fromkeys(driving)) == ["Conductor", "Plant", "Planner", "Tracker"]
    timing = [m.name for m in order if codec.is_wall_clock(m.frame_id)]
    assert timing == ["PlannerTiming", "TrackerTiming", "PlantTiming"]
    assert [m.name for m in order[-3:]] == timing


def test_every_vehicle_has_its_radio_messages():
    codec = CODECS["v2v.dbc"]
    assert not any(codec.is_wall_clock(codec.can_id(name)) for name in codec.names)
    for vehicle in range(1, MAX_VEHICLES + 1):
        for kind, base in (("Position", 0x100), ("Motion", 0x200), ("Status", 0x300)):
            message = codec.message(f"V2V{kind}_{vehicle}")
            assert message.frame_id == base + vehicle
            assert message.senders == [f"Vehicle{vehicle}"]
    assert len(codec.names) == 2 + 3 * MAX_VEHICLES
