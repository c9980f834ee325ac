"""Reading logs back: whole, cut off, damaged, and written by others."""

import random
import warnings

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from bench.errors import BadInput
from bench.mcap.container import MAGIC
from bench.record import LogDamaged, Run, can_frame
from bench.record.can_frame import Frame
from bench.record.layout import message_class

from .conftest import TRUTH_NAMES


def read_all(run):
    """Read everything of a run; return its frames."""
    for bus in run.buses:
        for name in run.messages(bus):
            run.message(bus, name)
        if len(run.frame_table(bus)):
            run.wall_clock_ids(bus)
    for vehicle in (1, 2):
        if f"/truth/veh{vehicle}" in run.topics:
            run.truth(vehicle)
    _ = run.events, run.metadata, run.attachments
    return [(f.time_ns, f.bus, f.can_id, f.data, f.receive_ns) for f in run.frames()]


def read_quietly(path):
    """Return all frames and the warnings that reading everything gave."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        return read_all(Run(path)), caught


def test_a_whole_log_comes_back_without_a_warning(recorded):
    frames, caught = read_quietly(recorded.path)
    assert frames == recorded.frames
    assert caught == []


def test_signals_by_name_with_times(recorded, codecs):
    run = Run(recorded.path)
    can_id = codecs["veh2"].can_id("VehicleMotion")
    wanted = [
        (time_ns / 1e9, codecs["veh2"].decode(can_id, data)[1]["YawRate"])
        for time_ns, bus, number, data, _ in recorded.frames
        if (bus, number) == ("veh2", can_id)
    ]
    t, values = run.signal("veh2", "VehicleMotion", "YawRate")
    assert list(zip(t.tolist(), values.tolist(), strict=True)) == wanted
    assert t[1] == 0.01


def test_truth_by_name(recorded):
    truth = Run(recorded.path).truth(2)
    assert list(truth) == ["t", *TRUTH_NAMES]
    assert truth["F_z_fl"].tolist() == [row[-1] for _, row in recorded.truth[2]]


def test_what_describes_the_run(recorded):
    run = Run(recorded.path)
    assert run.vehicles == 2
    assert run.buses == ["v2v", "veh1", "veh2"]
    assert run.metadata["seed"] == "7"
    assert run.result["status"] == "completed"
    assert [e.text for e in run.events] == [event.text for _, event in recorded.events]
    assert run.events[0].level == "warning"
    assert run.messages("veh1")[:3] == ["BenchSync", "BenchAbsent", "VehiclePosition"]
    assert run.wall_clock_ids("veh1") == {0x5F0, 0x5F1, 0x5F2}


@pytest.mark.parametrize(
    ("ask", "answer"),
    [
        (lambda run: run.signal("veh1", "VehicleMotion", "Speed"), "VehicleMotion has no 'Speed'; it has CRC, AliveC"),
        (lambda run: run.signal("veh1", "VehicleSpeed", "x"), "no topic /signals/veh1/VehicleSpeed; recorded are /sig"),
        (
            lambda run: run.message("veh1", "TrackerTimin"),
            r"TrackerTimin; recorded are /signals/veh1/TrackerTiming, /s",
        ),
        (lambda run: run.truth(3), "no topic /truth/veh3; recorded are /truth/veh1, /truth/veh2"),
        (lambda run: run.can_id("veh9", "X"), r"no topic /signals/veh9/X; recorded are /can/v2v, .* and \d\d more$"),
        (lambda run: run.frame_table("veh9"), "no topic /can/veh9"),
        (lambda run: run.scenario, "the scenario attached to it cannot be read"),
    ],
)
def test_what_is_not_there_is_named(recorded, ask, answer):
    with pytest.raises(BadInput, match=answer):
        ask(Run(recorded.path))


@pytest.mark.parametrize("content", [b"hello", MAGIC[:5], b"\0" * 100])
def test_what_is_no_log_is_refused(tmp_path, content):
    path = tmp_path / "x.mcap"
    path.write_bytes(content)
    with pytest.raises(BadInput, match="is not an MCAP file"):
        Run(path)


def test_an_empty_file_is_refused_as_such(tmp_path):
    (tmp_path / "x.mcap").touch()
    with pytest.raises(BadInput, match=r"x\.mcap is empty"):
        Run(tmp_path / "x.mcap")


@pytest.mark.parametrize("name", ["none.mcap", "."])
def test_what_cannot_be_read_is_refused(tmp_path, name):
    with pytest.raises(BadInput, match="cannot read the log"):
        Run(tmp_path / name)


def test_a_log_cut_anywhere_is_read_up_to_its_last_whole_chunk_after_one_warning(recorded, tmp_path, tries):
    whole = recorded.path.read_bytes()
    with recorded.path.open("rb") as stream:
        chunks = make_reader(stream).get_summary().chunk_indexes
    ends = [index.chunk_start_offset + index.chunk_length for index in chunks]
    log = Run(recorded.path).log
    raw = [log.topics[topic].id for topic in log.topics if topic.startswith("/can/")]
    frames_until = [0]
    for number in range(len(chunks)):
        messages = log._file.messages(number, log._file.chunk(number))
        frames_until.append(frames_until[-1] + sum(len(messages.get(channel, ())) for channel in raw))
    frames_until = frames_until[1:]
    assert frames_until[0] < frames_until[-1] == len(recorded.frames)
    generator = random.Random(5)
    cuts = {len(MAGIC), *(generator.randrange(len(MAGIC), len(whole) - 1) for _ in range(tries(15, 60)))}
    cuts |= {end + shift for end in ends for shift in (-1, 0, 1, 30)}
    path = tmp_path / "cut.mcap"
    for cut in sorted(cuts):
        path.write_bytes(whole[:cut])
        frames, caught = read_quietly(path)
        kept = max((count for end, count in zip(ends, frames_until, strict=True) if end <= cut), default=0)
        assert frames == recorded.frames[:kept], cut
        assert [warning.category for warning in caught] == [LogDamaged], cut


def test_flipped_bytes_never_give_wrong_data_nor_a_traceback(recorded, tmp_path, tries):
    whole = recorded.path.read_bytes()
    known = set(recorded.frames)
    generator = random.Random(6)
    path = tmp_path / "flipped.mcap"
    count, refused = tries(40, 150), 0
    for _ in range(count):
        damaged = bytearray(whole)
        for _ in range(generator.choice([1, 1, 5, 50])):
            damaged[generator.randrange(len(damaged))] ^= 1 << generator.randrange(8)
        path.write_bytes(damaged)
        try:
            frames, caught = read_quietly(path)
        except BadInput:
            refused += 1
            continue
        # Topics and schemas are not covered by a checksum: a bus may come back under another name, its bytes may not.
        assert {frame[2:] for frame in frames} <= {frame[2:] for frame in known}
        assert len(caught) <= 1
    assert refused < count // 2


def test_lengths_in_the_file_are_not_believed(recorded, tmp_path):
    whole = bytearray(recorded.path.read_bytes())
    with recorded.path.open("rb") as stream:
        first = make_reader(stream).get_summary().chunk_indexes[0]
    path = tmp_path / "long.mcap"
    # Uncompressed size (after opcode, length and two times), then the length of the record itself.
    for place in (first.chunk_start_offset + 25, first.chunk_start_offset + 1):
        damaged = bytearray(whole)
        damaged[place : place + 8] = (2**62).to_bytes(8, "little")
        path.write_bytes(damaged)
        frames, caught = read_quietly(path)
        assert len(frames) < len(recorded.frames)
        assert len(caught) == 1


def test_without_true_message_indexes_the_records_are_walked(recorded, tmp_path):
    damaged = bytearray(recorded.path.read_bytes())
    with recorded.path.open("rb") as stream:
        for index in make_reader(stream).get_summary().chunk_indexes:
            place = min(index.message_index_offsets.values())
            # The first entry's offset: after opcode, length, channel, array length and time.
            damaged[place + 23 : place + 31] = (7).to_bytes(8, "little")
    path = tmp_path / "unindexed.mcap"
    path.write_bytes(damaged)
    frames, _ = read_quietly(path)
    assert frames == recorded.frames


@pytest.mark.parametrize("compression", list(CompressionType))
def test_a_log_that_another_writer_encoded_reads_the_same(recorded, tmp_path, compression):
    """mcap's own writer, one chunk, protobuf without the fields that are zero."""
    path = tmp_path / "other.mcap"
    with recorded.path.open("rb") as source, path.open("wb") as target:
        reader = make_reader(source)
        writer = Writer(target, compression=compression)
        writer.start("", "other")
        schemas, channels = {}, {}
        for schema, channel, record in reader.iter_messages(log_time_order=False):
            kind = message_class(schema.name, schema.data)
            if channel.id not in channels:
                if schema.id not in schemas:
                    schemas[schema.id] = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(
                    channel.topic, "protobuf", schemas[schema.id], channel.metadata
                )
            data = kind.FromString(record.data).SerializeToString()
            writer.add_message(channels[channel.id], record.log_time, data, record.publish_time)
        writer.finish()
    ours, others = Run(recorded.path), Run(path)
    for bus in ours.buses:
        assert others.messages(bus) == ours.messages(bus)
        for name in ours.messages(bus):
            for signal, values in ours.message(bus, name).items():
                np.testing.assert_array_equal(others.message(bus, name)[signal], values)
    for signal, values in ours.truth(1).items():
        np.testing.assert_array_equal(others.truth(1)[signal], values)


def test_a_time_beyond_64_signed_bits_is_the_same_in_each_encoding(tmp_path):
    """A damaged log may have any: that such a frame is encoded in another way than ours must not make it unreadable."""
    kind = message_class(can_frame.NAME, can_frame.SCHEMA)
    head = kind(receive_time=(1 << 63) + 5, id=0x123, wire_time=(1 << 64) - 1, response_time=7)
    # Fields at zero are left out by protobuf and stand in ours, so the first message is in our form and the second not.
    messages = [kind(data=b"ab"), kind(data=b"")]
    found = []
    for number, message in enumerate(messages):
        message.MergeFrom(head)
        path = tmp_path / f"{number}.mcap"
        with path.open("wb") as target:
            writer = Writer(target)
            writer.start("", "other")
            schema = writer.register_schema(can_frame.NAME, "protobuf", can_frame.SCHEMA)
            channel = writer.register_channel("/can/veh1", "protobuf", schema, {})
            writer.add_message(channel, 0, message.SerializeToString(), 0)
            writer.finish()
        found.extend(Run(path).frames())
    assert found == [Frame(0, "veh1", 0x123, data, 5 - (1 << 63), -1, 7) for data in (b"ab", b"")]
