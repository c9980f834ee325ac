"""Logs of other tools: what goes out comes back exactly, and others read it; what comes in is taken or refused."""

import importlib
import random
import re
import shutil
import subprocess
import sys
from contextlib import suppress

import can
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.bus.codec import DBC_DIR
from bench.errors import BadInput
from bench.record import Run, RunWriter, diff
from bench.record.exchange import Format, export_log, import_logs
from bench.record.exchange.formats import EXTENDED_FLAG, EXTENDED_MAX, LONGEST_NS, STANDARD_MAX

FORMATS = list(Format)
CHANNELS = {"v2v": 1, "veh1": 2, "veh2": 3}
UNIX_S = 1_700_000_000


def write_frames(path, codecs, frames):
    """Write (time_ns, bus, log_id, data) to a log."""
    with RunWriter(path, codecs=codecs, truth_names=(), vehicles=2, metadata={}, attachments={}) as writer:
        for time_ns, bus, log_id, data in frames:
            writer.frame(bus, time_ns, log_id, data, 5)
    return path


def frames_of(log):
    return [(frame.time_ns, frame.bus, frame.can_id, frame.data) for frame in Run(log).frames()]


def asammdf():
    """The library, which the bench lets in only where it is needed."""
    Format.MF4.check_available()
    return importlib.import_module("asammdf")


def left_over(folder):
    return [path.name for path in folder.iterdir() if ".part" in path.name]


@pytest.fixture(params=FORMATS, ids=str)
def kind(request):
    return request.param


@pytest.fixture(scope="module")
def exported(recorded, tmp_path_factory):
    """The recorded log, exported in every format."""
    folder = tmp_path_factory.mktemp("exported")
    files = {kind: folder / f"run{kind.suffix}" for kind in FORMATS}
    for kind, file in files.items():
        export_log(recorded.path, file, kind)
    return files


# Out and in again


def test_a_run_comes_back_with_the_same_frames_and_signals(recorded, exported, kind, tmp_path):
    back = tmp_path / "back.mcap"
    done = import_logs([exported[kind]], back)
    assert diff(recorded.path, back).same
    assert done.frames == {bus: len(Run(recorded.path).frame_table(bus)) for bus in CHANNELS}
    # Also those messages that the comparison leaves out, and the order across buses.
    assert frames_of(back) == [frame[:4] for frame in recorded.frames]
    times, rates = Run(back).signal("veh1", "VehicleMotion", "YawRate")
    expected = Run(recorded.path).signal("veh1", "VehicleMotion", "YawRate")
    assert np.array_equal(times, expected[0])
    assert np.array_equal(rates, expected[1])


IDENTIFIERS = st.one_of(
    st.integers(0, STANDARD_MAX),
    st.integers(STANDARD_MAX + 1, EXTENDED_MAX),
    st.integers(0, STANDARD_MAX).map(lambda can_id: can_id | EXTENDED_FLAG),
)
FRAMES = st.lists(
    st.tuples(st.integers(0, LONGEST_NS), st.sampled_from(list(CHANNELS)), IDENTIFIERS, st.binary(max_size=8)),
    min_size=1,
    max_size=20,
)


def test_any_frame_at_any_nanosecond_comes_back_exactly(codecs, kind, tmp_path_factory, tries):
    @settings(max_examples=tries(10, 40), deadline=None)
    @given(frames=FRAMES)
    def comes_back(frames):
        folder = tmp_path_factory.mktemp("any")
        frames = sorted(frames, key=lambda frame: frame[0])
        log = write_frames(folder / "a.mcap", codecs, frames)
        export_log(log, folder / f"a{kind.suffix}", kind)
        import_logs([folder / f"a{kind.suffix}"], folder / "b.mcap")
        assert frames_of(folder / "b.mcap") == frames

    comes_back()


def test_frames_of_a_whole_day_come_back_exactly(codecs, kind, tmp_path, tries):
    # Every 1.2345 s, or 10 times that, and a few ns: more decimals than a float keeps if it counts from 1970.
    count = tries(7_000, 70_000)
    step_ns = 86_415_000_490_000 // count
    frames = [(n * step_ns, "veh1", n % 0x800, bytes([n % 256] * (n % 9))) for n in range(count)]
    log = write_frames(tmp_path / "a.mcap", codecs, frames)
    export_log(log, tmp_path / f"a{kind.suffix}", kind)
    import_logs([tmp_path / f"a{kind.suffix}"], tmp_path / "b.mcap")
    assert frames_of(tmp_path / "b.mcap") == frames


def test_one_bus_alone_keeps_its_name_and_number(recorded, kind, tmp_path):
    done = export_log(recorded.path, tmp_path / f"a{kind.suffix}", kind, ["veh2"])
    assert done.channels == {"veh2": "veh2" if kind is Format.CANDUMP else "3"}
    import_logs([tmp_path / f"a{kind.suffix}"], tmp_path / "b.mcap")
    assert frames_of(tmp_path / "b.mcap") == [frame[:4] for frame in recorded.frames if frame[1] == "veh2"]


def test_what_a_format_does_not_carry_is_said(recorded, kind, tmp_path):
    done = export_log(recorded.path, tmp_path / f"a{kind.suffix}", kind)
    assert len(done.notes) == 1
    for what in ("decoded signals", "truth", "poses", "events", "attachments", "metadata", "receive and wire times"):
        assert what in done.notes[0]


@pytest.mark.parametrize("kind", [Format.CANDUMP, Format.ASC], ids=str)
def test_nanoseconds_in_text_are_said_to_be_unusual(codecs, kind, tmp_path):
    log = write_frames(tmp_path / "a.mcap", codecs, [(1_001, "veh1", 1, b"")])
    done = export_log(log, tmp_path / f"a{kind.suffix}", kind)
    assert "9 decimals" in done.notes[-1]
    assert "0.000001001" in (tmp_path / f"a{kind.suffix}").read_text()


def test_the_same_log_gives_the_same_text(recorded, exported, tmp_path):
    for kind in (Format.CANDUMP, Format.ASC, Format.BLF):
        export_log(recorded.path, tmp_path / f"b{kind.suffix}", kind)
        assert (tmp_path / f"b{kind.suffix}").read_bytes() == exported[kind].read_bytes()


# Others read what we write


def test_python_can_reads_it(recorded, exported, kind):
    with can.LogReader(exported[kind]) as reader:
        messages = list(reader)
    assert len(messages) == len(recorded.frames)
    # python-can counts the channels of ASC and BLF from 0.
    first = 1 if kind in (Format.ASC, Format.BLF) else 0
    for message, (time_ns, bus, can_id, data, *_) in zip(messages, recorded.frames, strict=True):
        assert message.timestamp == time_ns / 1e9
        assert (message.arbitration_id, message.is_extended_id) == (can_id, False)
        assert bytes(message.data) == data
        assert message.channel == (bus if kind is Format.CANDUMP else CHANNELS[bus] - first)


def test_asammdf_reads_it(recorded, exported):
    with asammdf().MDF(exported[Format.MF4]) as mdf:
        assert [str(channel.name) for channel in mdf.groups[0].channels if "ID" in str(channel.name)]
        identifiers = mdf.get("CAN_DataFrame.ID")
        channels = mdf.get("CAN_DataFrame.BusChannel").samples
        data = mdf.get("CAN_DataFrame.DataBytes").samples
    assert identifiers.samples.tolist() == [frame[2] for frame in recorded.frames]
    assert channels.tolist() == [CHANNELS[frame[1]] for frame in recorded.frames]
    assert np.array_equal(np.rint(identifiers.timestamps * 1e9), [frame[0] for frame in recorded.frames])
    assert [bytes(row[: len(frame[3])]) for row, frame in zip(data, recorded.frames, strict=True)] == [
        frame[3] for frame in recorded.frames
    ]


def test_asammdf_decodes_it_with_our_dbc(recorded, exported):
    with asammdf().MDF(exported[Format.MF4]) as mdf:
        decoded = mdf.extract_bus_logging({"CAN": [(str(DBC_DIR / "vehicle.dbc"), CHANNELS["veh1"])]})
        yaw_rate = decoded.get(f"CAN{CHANNELS['veh1']}.VehicleMotion.YawRate")
    times, values = Run(recorded.path).signal("veh1", "VehicleMotion", "YawRate")
    assert np.allclose(yaw_rate.timestamps, times, rtol=0.0, atol=1e-9)
    assert np.allclose(yaw_rate.samples, values, rtol=0.0, atol=1e-9)


@pytest.mark.skipif(shutil.which("asc2log") is None, reason="can-utils is not installed")
def test_can_utils_read_the_asc(recorded, exported):
    done = subprocess.run(["asc2log", "-I", exported[Format.ASC]], capture_output=True, text=True, check=True)
    pattern = re.compile(r"\((\d+\.\d{6})\)\s+can(\d+)\s+(\w+)#(\w*)")
    found = [pattern.match(line) for line in done.stdout.splitlines()]
    assert [(int(m[2]), int(m[3], 16), bytes.fromhex(m[4])) for m in found] == [
        (CHANNELS[bus] - 1, can_id, data) for _, bus, can_id, data, _ in recorded.frames
    ]
    # It adds the present where it cannot read the date, in most locales.
    times_us = [round(float(match[1]) * 1e6) for match in found]
    assert [time - times_us[0] for time in times_us] == [frame[0] // 1000 for frame in recorded.frames]


@pytest.mark.skipif(shutil.which("log2asc") is None, reason="can-utils is not installed")
def test_can_utils_read_the_candump(codecs, tmp_path):
    # log2asc takes second 0 for a file's beginning again and again, so this one begins later.
    frames = [(10**9 + n * 10_000_000, "veh1", 0x100 + n, bytes(range(n % 9))) for n in range(50)]
    frames.append((2 * 10**9, "veh1", 0x1ABCDEF0, b"\x01"))
    log = write_frames(tmp_path / "a.mcap", codecs, frames)
    export_log(log, tmp_path / "a.log", Format.CANDUMP)
    command = ["log2asc", "-I", tmp_path / "a.log", "-O", tmp_path / "a.asc", "veh1"]
    subprocess.run(command, capture_output=True, check=True)
    import_logs([tmp_path / "a.asc"], tmp_path / "b.mcap", buses={"1": "veh1"})
    # Its times count from the first frame.
    assert frames_of(tmp_path / "b.mcap") == [(time_ns - 10**9, *rest) for time_ns, *rest in frames]


def test_cantools_decodes_the_candump(recorded, exported):
    command = [sys.executable, "-m", "cantools", "decode", "--single-line", DBC_DIR / "vehicle.dbc"]
    with exported[Format.CANDUMP].open() as stream:
        done = subprocess.run(command, stdin=stream, capture_output=True, text=True, check=True)
    found = re.findall(r"veh1 .*VehicleMotion\(.*YawRate: (\S+)", done.stdout)
    _, values = Run(recorded.path).signal("veh1", "VehicleMotion", "YawRate")
    assert np.allclose([float(value) for value in found], values, rtol=0.0, atol=1e-9)


# Files of others


def foreign_messages():
    """What a bus in the world has beside our frames."""
    time_s = UNIX_S + 0.25
    return [
        can.Message(timestamp=time_s, arbitration_id=0x123, is_extended_id=False, data=b"\x01\x02", channel=1),
        can.Message(timestamp=time_s + 0.001, arbitration_id=0x123, is_extended_id=True, data=b"\x03", channel=1),
        can.Message(timestamp=time_s + 0.002, arbitration_id=0x18FEF100, data=bytes(8), channel=2, is_rx=False),
        can.Message(
            timestamp=time_s + 0.003, arbitration_id=0x7, is_extended_id=False, is_remote_frame=True, channel=1
        ),
        can.Message(timestamp=time_s + 0.004, is_error_frame=True, channel=1),
        can.Message(
            timestamp=time_s + 0.005,
            arbitration_id=9,
            is_extended_id=False,
            is_fd=True,
            data=bytes(12),
            dlc=12,
            channel=1,
        ),
        can.Message(timestamp=time_s + 0.006, arbitration_id=0x7FF, is_extended_id=False, data=b"", channel=2),
    ]


# The number that python-can gives a channel 1 in a file of each format.
NUMBERS = {Format.CANDUMP: ("can1", "can2"), Format.ASC: ("2", "3"), Format.BLF: ("2", "3"), Format.MF4: ("1", "2")}


def test_a_file_of_python_cans_logger_is_taken(kind, tmp_path):
    file = tmp_path / f"foreign{kind.suffix}"
    with can.Logger(file) as logger:
        for message in foreign_messages():
            logger.on_message_received(message)
    one, two = NUMBERS[kind]
    done = import_logs([file], tmp_path / "a.mcap", buses={one: "left", two: "right"})
    run = Run(tmp_path / "a.mcap")
    assert run.buses == ["left", "right"]
    # An ASC file counts from its first frame; the others have the time of the calendar.
    start = 0 if kind is Format.ASC else 250_000_000
    expected = [
        (start, "left", 0x123, b"\x01\x02"),
        (start + 1_000_000, "left", 0x123 | EXTENDED_FLAG, b"\x03"),
        (start + 2_000_000, "right", 0x18FEF100, bytes(8)),
        (start + 6_000_000, "right", 0x7FF, b""),
    ]
    # python-can writes BLF and MF4 from float seconds since 1970, 240 ns apart.
    for frame, wanted in zip(frames_of(tmp_path / "a.mcap"), expected, strict=True):
        assert frame[1:] == wanted[1:]
        assert abs(frame[0] - wanted[0]) <= (500 if kind in (Format.BLF, Format.MF4) else 0)
    origin = 0 if kind is Format.ASC else UNIX_S
    assert run.metadata["origin_unix_s"] == str(origin)
    assert [frame.receive_ns - frame.time_ns for frame in run.frames()] == [origin * 10**9] * 4
    notes = "\n".join(done.notes)
    for what in ("1 remote frames", "1 error frames", "1 CAN FD frames", "1 frames were marked as sent"):
        assert what in notes
    assert "left: no DBC" in notes
    assert run.metadata["source"] == file.name


def test_channels_have_a_name_of_their_own_if_none_is_given(tmp_path):
    file = tmp_path / "a.log"
    file.write_text("(1.000001) vcan0 123#00\n(1.000002) can-x.1 123#01\n(1.000003) 7 123#02\n")
    import_logs([file], tmp_path / "a.mcap")
    assert Run(tmp_path / "a.mcap").buses == ["can7", "can_x_1", "vcan0"]


def test_candump_lines_of_all_kinds(tmp_path):
    file = tmp_path / "a.log"
    file.write_text(
        "(1436509052.249713) vcan0 044#2A366C2BBA\n(1436509052.449847123) vcan0 0000044#\n".replace(
            "0000044", "00000044"
        )
        + "(1436509052.650004) vcan0 6FD#R\n"
        "(1436509053.000000) vcan0 20000004#0004000000000000\n"
        "(1436509053.100000) vcan0 123##3112233\n"
        "\n"
        "(1436509053.850870) vcan0 0D1#80AFFD75\n"
    )
    done = import_logs([file], tmp_path / "a.mcap")
    assert frames_of(tmp_path / "a.mcap") == [
        (249_713_000, "vcan0", 0x44, bytes.fromhex("2A366C2BBA")),
        (449_847_123, "vcan0", 0x44 | EXTENDED_FLAG, b""),
        (1_850_870_000, "vcan0", 0xD1, bytes.fromhex("80AFFD75")),
    ]
    assert Run(tmp_path / "a.mcap").metadata["left out: error frames"] == "1"
    assert "left out: 1 CAN FD frames" in done.notes


def test_asc_lines_of_all_kinds(tmp_path):
    # No line `internal events logged`, decimal numbers, and events that are no frames.
    file = tmp_path / "a.asc"
    file.write_text(
        "date Sat Sep 30 10:06:13.191 PM 2017\n"
        "base dec  timestamps absolute\n"
        "// version 8.1.0\n"
        "  0.500000 1  291             Rx   d 2 16 255\n"
        "  0.600000 2  418120704x      Rx   d 1 1  Length = 0 BitCount = 0\n"
        "  0.650000 CAN 1 Status:chip status error active\n"
        "  0.700000 1  Statistic: D 10 R 0 XD 0 XR 0 E 0 O 0 B 2.50%\n"
        "  0.800000 1  ErrorFrame\n"
        "  0.9 1  15              Rx   r\n"
    )
    done = import_logs([file], tmp_path / "a.mcap")
    assert frames_of(tmp_path / "a.mcap") == [
        (500_000_000, "can1", 0x123, b"\x10\xff"),
        (600_000_000, "can2", 0x18EC0400, b"\x01"),
    ]
    for what in ("1 error frames", "1 remote frames", "2 other events"):
        assert f"left out: {what}" in done.notes


def test_a_dbc_for_all_or_for_one_bus(recorded, tmp_path):
    file = tmp_path / "a.log"
    export_log(recorded.path, file, Format.CANDUMP)
    text = file.read_text()
    file.write_text(text.replace(" veh1 ", " vcan1 ").replace(" veh2 ", " vcan2 "))
    vehicle_dbc = DBC_DIR / "vehicle.dbc"
    import_logs([file], tmp_path / "one.mcap", dbc=[f"vcan1={vehicle_dbc}"])
    one = Run(tmp_path / "one.mcap")
    assert one.has("vcan1", "VehicleMotion")
    assert not one.messages("vcan2")
    assert one.attachments["vehicle.dbc"] == vehicle_dbc.read_bytes()
    import_logs([file], tmp_path / "all.mcap", dbc=[str(vehicle_dbc)])
    assert Run(tmp_path / "all.mcap").has("vcan2", "VehicleMotion")
    expected = Run(recorded.path).signal("veh2", "VehicleMotion", "YawRate")[1]
    assert np.array_equal(Run(tmp_path / "all.mcap").signal("vcan2", "VehicleMotion", "YawRate")[1], expected)


def test_several_files_become_one_log_in_the_order_of_time(recorded, tmp_path):
    files = [tmp_path / "one.blf", tmp_path / "two.log"]
    export_log(recorded.path, files[0], Format.BLF, ["veh1"])
    export_log(recorded.path, files[1], Format.CANDUMP, ["v2v", "veh2"])
    import_logs(files, tmp_path / "both.mcap")
    assert diff(recorded.path, tmp_path / "both.mcap").same


# Refused


GOOD = "(1.000000) can0 123#00\n"


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("a.log", b"", "holds no candump frame"),
        ("a.log", b"  vcan0  123   [2]  01 02\n", "line 1"),
        ("a.log", GOOD.encode() + b"(1.0) can0 123#012\n", "line 2"),
        ("a.log", GOOD.encode() + b"(1.0) can0 123#0102030405060708AA\n", "9 data bytes"),
        ("a.log", b"(1.0) can0 FFF#00\n", "too large"),
        ("a.log", b"(1.0000000001) can0 0FF#00\n", "9 decimals"),
        ("a.log", b"(nan) can0 0FF#00\n", "line 1"),
        ("a.log", b"(1.0) can0 0FF##112\n", "only 1 CAN FD frames"),
        ("a.log", GOOD.encode() + b"(1700000000.0) can0 0FF#00\n", "calendar times"),
        ("a.log", bytes(range(256)), "line"),
        ("a.asc", b"hello\n", "holds no asc frame"),
        ("a.asc", b"base hex  timestamps relative\n 0.1 1 123 Rx d 1 00\n", "timestamps absolute"),
        ("a.asc", b"base hex  timestamps absolute\n// x\n// x\n 0.1 1 123 Rx d 8 00 01\n", "2 data bytes"),
        ("a.blf", b"", "not a whole blf file"),
        ("a.blf", b"LOGG" + bytes(200), "blf"),
        ("a.mf4", b"", "mf4"),
        ("a.mf4", b"MDF     4.10    " + bytes(200), "mf4"),
        ("a.txt", b"", "--format"),
    ],
)
def test_a_bad_file_is_refused_and_nothing_is_written(tmp_path, name, content, says):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(BadInput, match=re.escape(says)):
        import_logs([tmp_path / name], tmp_path / "out.mcap")
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_a_cut_file_is_refused_or_said_to_be_cut(exported, kind, tmp_path, tries):
    whole = exported[kind].read_bytes()
    generator = random.Random(3)
    refused = 0
    for number in range(tries(8, 25)):
        file = tmp_path / f"{number}{kind.suffix}"
        file.write_bytes(whole[: generator.randrange(len(whole))])
        try:
            done = import_logs([file], tmp_path / f"{number}.mcap")
        except BadInput:
            refused += 1
            continue
        assert kind in (Format.CANDUMP, Format.ASC)
        assert file.read_bytes().endswith(b"\n") or any("truncated" in note for note in done.notes)
    assert refused
    assert not left_over(tmp_path)


def test_a_damaged_file_gives_a_message_never_a_traceback(exported, kind, tmp_path, tries):
    whole = exported[kind].read_bytes()
    generator = random.Random(4)
    count, taken = tries(12, 60), 0
    for number in range(count):
        damaged = bytearray(whole)
        for _ in range(generator.choice([1, 3, 30])):
            damaged[generator.randrange(len(damaged))] = generator.randrange(256)
        file = tmp_path / f"{number}{kind.suffix}"
        file.write_bytes(damaged)
        # Any other exception fails the test.
        with suppress(BadInput):
            import_logs([file], tmp_path / f"{number}.mcap")
            taken += 1
    assert taken < count
    assert not left_over(tmp_path)


def test_what_is_there_is_not_written_over(recorded, exported, kind, tmp_path):
    (tmp_path / f"a{kind.suffix}").write_text("mine")
    (tmp_path / "a.mcap").write_text("mine")
    with pytest.raises(BadInput, match="already exists"):
        export_log(recorded.path, tmp_path / f"a{kind.suffix}", kind)
    with pytest.raises(BadInput, match="already exists"):
        import_logs([exported[kind]], tmp_path / "a.mcap")
    assert {path.read_text() for path in tmp_path.iterdir()} == {"mine"}


def test_names_that_are_not_there_are_refused(recorded, exported, tmp_path):
    with pytest.raises(BadInput, match="it has v2v, veh1, veh2"):
        export_log(recorded.path, tmp_path / "a.log", Format.CANDUMP, ["veh9"])
    for buses, says in (({"7": "veh1"}, "the files have 1, 2, 3"), ({"1": "a b"}, "letters, digits")):
        with pytest.raises(BadInput, match=says):
            import_logs([exported[Format.BLF]], tmp_path / "a.mcap", buses=buses)
    for dbc, says in (("veh9=x.dbc", "there is no bus veh9"), ("veh1=x.dbc", "cannot read"), ("x.dbc", "cannot read")):
        with pytest.raises(BadInput, match=says):
            import_logs([exported[Format.BLF]], tmp_path / "a.mcap", dbc=[dbc])
    assert not list(tmp_path.iterdir())


def test_times_too_long_for_the_formats_are_refused(codecs, kind, tmp_path):
    log = write_frames(tmp_path / "a.mcap", codecs, [(0, "veh1", 1, b""), (LONGEST_NS + 1, "veh1", 1, b"")])
    with pytest.raises(BadInput, match="exactly up to"):
        export_log(log, tmp_path / f"a{kind.suffix}", kind)


def test_a_disk_that_is_full_leaves_nothing(recorded, kind, tmp_path):
    """Every writer's file refuses to grow, as a full disk does."""
    import resource
    import signal

    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2000, limits[1]))
    try:
        with pytest.raises(BadInput, match="cannot write"):
            export_log(recorded.path, tmp_path / f"a{kind.suffix}", kind)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, handler)
    assert not list(tmp_path.iterdir())
