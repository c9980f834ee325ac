"""Comparing runs: every byte counts, but for wall-clock messages and the host's own times."""

import pytest

from bench.bus.codec import DBC_DIR
from bench.bus.wire.timing import BusTimeline
from bench.errors import BadInput
from bench.record import Run, RunWriter, diff
from tests.reference import raw_log

from .conftest import open_writer


def flip_bit(frame, number=0):
    time_ns, bus, can_id, data, receive_ns = frame
    changed = bytearray(data)
    changed[number // 8] ^= 1 << number % 8
    return time_ns, bus, can_id, bytes(changed), receive_ns


def changed_at(cycle, bus, can_id, change):
    def apply(frame):
        return change(frame) if frame[:3] == (cycle * 10_000_000, bus, can_id) else frame

    return apply


def test_the_same_frames_are_the_same_whenever_they_came(make_log):
    a = make_log("a.mcap")
    b = make_log("b.mcap", change=lambda f: (*f[:4], f[4] + 12345))
    found = diff(a.path, b.path)
    assert found.same
    assert str(found).startswith("same: ")
    # All frames but the three timing messages of each vehicle in each cycle.
    assert found.frames == (len(a.frames) - 3 * 2 * 40,) * 2


def test_wall_clock_messages_are_left_out(make_log):
    a = make_log("a.mcap")
    b = make_log("b.mcap", change=lambda f: flip_bit(f, 3) if f[2] in (0x5F0, 0x5F1, 0x5F2) else f)
    assert diff(a.path, b.path).same


def test_a_single_bit_is_found_with_its_signal_and_time(make_log):
    # Bit 20 of VehicleMotion is bit 8 of VelocityX: 256 times 0.0005 m/s.
    a = make_log("a.mcap")
    b = make_log("b.mcap", change=changed_at(17, "veh2", 0x102, lambda f: flip_bit(f, 20)))
    found = diff(a.path, b.path)
    assert not found.same
    assert (found.first.time_s, found.first.bus) == (0.17, "veh2")
    (only,) = found.signals
    assert (only.bus, only.message, only.signal, only.first_s, only.count) == (
        *("veh2", "VehicleMotion", "VelocityX"),
        *(0.17, 1),
    )
    assert only.largest == pytest.approx(0.128)
    text = str(found)
    assert "first difference at 0.170 s on veh2" in text
    assert "VehicleMotion: CRC" in text
    assert "veh2 VehicleMotion.VelocityX: from 0.170 s, 1 value, by at most 0.128 m/s" in text


def test_a_crc_is_told_of_only_where_nothing_else_tells_why(codecs, tmp_path):
    """It follows from the rest of a frame; a wrong one does not."""

    def log(name, speed, crc=None):
        path = tmp_path / f"{name}.mcap"
        with open_writer(path, codecs) as writer:
            values = codecs["veh1"].start_values("VehicleMotion") | {"VelocityX": speed}
            can_id, data = codecs["veh1"].encode("VehicleMotion", values, 5)
            writer.frame("veh1", 50_000_000, can_id, data if crc is None else bytes([crc]) + data[1:], 0)
        return path

    a = log("a", 20.0)
    assert [s.signal for s in diff(a, log("b", 21.0)).signals] == ["VelocityX"]
    assert [s.signal for s in diff(a, log("c", 20.0, crc=0)).signals] == ["CRC"]


def test_a_bit_that_no_signal_covers_is_found(make_log):
    # BenchSync fills its frame; PlantBusHealth has two signals of 16 bits, the other half is spare.
    a = make_log("a.mcap")
    b = make_log("b.mcap", change=changed_at(5, "veh1", 0x107, lambda f: flip_bit(f, 60)))
    found = diff(a.path, b.path)
    assert not found.same
    assert found.first.time_s == 0.05
    assert found.signals == ()


def test_a_missing_frame_is_found(make_log):
    a = make_log("a.mcap")
    b = make_log("b.mcap", change=changed_at(39, "v2v", 0x201, lambda _: None))
    found = diff(a.path, b.path)
    assert not found.same
    assert found.first.time_s == 0.39
    assert "V2VMotion_1 on v2v: 40 frames in A, 39 in B" in found.notes


def test_a_shorter_run_differs_from_where_it_ends(make_log):
    a, b = make_log("a.mcap", cycles=10), make_log("b.mcap", cycles=8)
    found = diff(a.path, b.path)
    assert found.first.time_s == 0.08
    assert found.first.b is None
    assert "B: no frame" in str(found)
    # And not of every message that it has fewer frames.
    assert found.notes == tuple(f"{bus} ends at 0.090 s in A, at 0.070 s in B" for bus in ("v2v", "veh1", "veh2"))


def test_the_order_of_frames_counts(make_log):
    swapped = []

    def swap(frame):
        if frame[:3] == (0, "veh1", 0x100):
            swapped.append(frame)
            return None
        return frame

    a = make_log("a.mcap")
    b = make_log("b.mcap", change=swap)
    assert not diff(a.path, b.path).same
    assert len(swapped) == 1


def test_of_several_frames_of_a_message_in_one_cycle_the_one_that_differs_is_shown(codecs, tmp_path):
    paths = []
    for name, second in (("a", 0x200), ("b", 0x201)):
        paths.append(tmp_path / f"{name}.mcap")
        with open_writer(paths[-1], codecs) as writer:
            for identifier in (0x100, second):
                frame = codecs["veh1"].encode("BenchAbsent", {"Identifier": identifier, "Cycle": 5})
                writer.frame("veh1", 50_000_000, *frame, 0)
    first = diff(*paths).first
    assert "Identifier 512" in first.a
    assert "Identifier 513" in first.b


def test_when_a_log_was_flushed_makes_no_difference_on_an_overloaded_bus(codecs, tmp_path):
    paths = []
    for name, flushes in (("a", True), ("b", False)):
        paths.append(tmp_path / f"{name}.mcap")
        with open_writer(paths[-1], codecs, timeline=BusTimeline(codecs, {})) as writer:
            for cycle in range(8):
                time_ns = cycle * 10_000_000
                for n in range(60 if cycle < 4 else 5):
                    writer.frame("veh1", time_ns, 0x700 - n, bytes([cycle] * 8), 0)
                announced = {"Identifier": 0x200, "Cycle": cycle}
                writer.frame("veh1", time_ns, *codecs["veh1"].encode("BenchAbsent", announced), 0)
                if flushes:
                    writer.flush()
    assert diff(*paths).same


def test_nothing_to_compare_is_no_success(codecs, tmp_path, make_log):
    path = tmp_path / "empty.mcap"
    RunWriter(path, codecs=codecs, truth_names=(), vehicles=1, metadata={}, attachments={}).close({})
    with pytest.raises(BadInput, match="holds no frame"):
        diff(path, make_log("a.mcap").path)


def frames_only(source, target, *, dbc=False):
    """The raw frames of a log, with or without the DBC files that tell what they mean."""
    run = Run(source)
    attached = {name: (DBC_DIR / name).read_bytes() for name in ("v2v.dbc", "vehicle.dbc")} if dbc else {}
    raw_log.write(target, run.frames(), run.buses, "", {"run": {"vehicles": "2"}}, attached)
    return target


def test_frames_are_the_same_whether_or_not_a_log_has_decoded_them(make_log, tmp_path):
    a = make_log("a.mcap").path
    assert diff(a, frames_only(a, tmp_path / "b.mcap", dbc=True)).same
    assert diff(frames_only(a, tmp_path / "c.mcap", dbc=True), a).same


def test_signals_of_raw_frames_are_those_of_the_dbc_that_is_attached(make_log, tmp_path):
    a = make_log("a.mcap").path
    b = make_log("b.mcap", change=changed_at(17, "veh2", 0x102, lambda f: flip_bit(f, 20))).path
    decoded = diff(a, b)
    for dbc_of in ("a", "b"):
        raw = [frames_only(log, tmp_path / f"{log.stem}-{dbc_of}.mcap", dbc=log.stem == dbc_of) for log in (a, b)]
        found = diff(*raw)
        assert found.signals == decoded.signals
        assert found.first == decoded.first
        assert found.notes == ()


def test_where_nothing_tells_what_frames_mean_that_is_said(make_log, tmp_path):
    a = make_log("a.mcap").path
    b = make_log("b.mcap", change=changed_at(17, "veh2", 0x102, lambda f: flip_bit(f, 20))).path
    found = diff(*(frames_only(log, tmp_path / f"raw-{log.name}") for log in (a, b)))
    assert found.first.time_s == 0.17
    assert found.signals == ()
    assert found.notes == ("veh2: neither log tells what its frames mean, so no signals are compared",)


def test_values_have_their_units_and_states_their_names(make_log):
    change = changed_at(17, "veh2", 0x102, lambda f: flip_bit(f, 20))
    first = diff(make_log("a.mcap").path, make_log("b.mcap", change=change).path).first
    assert " m/s, " in first.a
    change = changed_at(17, "veh2", 0x500, lambda f: flip_bit(f, 40))
    first = diff(make_log("c.mcap").path, make_log("d.mcap", change=change).path).first
    assert "PlannerStatus: " in first.a
    assert "State Init" in first.a
