"""What the writer writes, seen through mcap's own reader and google.protobuf alone."""

import itertools
import math
import signal
import subprocess
import sys
import textwrap
from collections import Counter
from pathlib import Path

import pytest
from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader

from bench.bus.codec import DBC_DIR, DecodeError
from bench.cycle import CYCLE_NS
from bench.errors import BadInput, RunFailed
from bench.events import RunEnded
from bench.record import Run
from bench.record.event import Event
from bench.record.process_usage import ProcessUsage
from bench.record.writer import RunWriter

from .conftest import TRUTH_NAMES, open_writer, same_double

ROOT = Path(__file__).parents[2]


def decoded_messages(path):
    """Give (topic, record, protobuf message), decoded from nothing but what is in the file."""
    classes = {}
    with path.open("rb") as stream:
        for schema, channel, record in make_reader(stream, validate_crcs=True).iter_messages(log_time_order=False):
            if schema.id not in classes:
                pool = descriptor_pool.DescriptorPool()
                for file in descriptor_pb2.FileDescriptorSet.FromString(schema.data).file:
                    pool.Add(file)
                classes[schema.id] = message_factory.GetMessageClass(pool.FindMessageTypeByName(schema.name))
            assert channel.message_encoding == schema.encoding == "protobuf"
            yield channel.topic, record, classes[schema.id].FromString(record.data)


@pytest.fixture(scope="module")
def messages(recorded):
    return list(decoded_messages(recorded.path))


def test_raw_frames_are_what_was_on_the_bus_in_that_order(recorded, messages):
    found = [
        (record.log_time, topic.removeprefix("/can/"), message.id, message.data, message.receive_time)
        for topic, record, message in messages
        if topic.startswith("/can/")
    ]
    assert found == recorded.frames


def test_every_message_of_the_dbc_is_decoded_as_the_codec_decodes_it(recorded, messages, codecs):
    found = {bus: iter([m for m in messages if m[0].startswith(f"/signals/{bus}/")]) for bus in codecs}
    seen = set()
    for time_ns, bus, can_id, data, _ in recorded.frames:
        name, values = codecs[bus].decode(can_id, data)
        topic, record, message = next(found[bus])
        assert (topic, record.log_time) == (f"/signals/{bus}/{name}", time_ns)
        assert {signal: getattr(message, signal) for signal in values} == values
        seen.add((bus, name))
    assert all(next(rest, None) is None for rest in found.values())
    assert len(seen) == len({(bus, can_id) for _, bus, can_id, _, _ in recorded.frames}) > 50


def test_states_are_enumerations_with_the_names_of_the_value_table(messages):
    message = next(m for topic, _, m in messages if topic == "/signals/veh1/TrackerStatus")
    names = {v.number: v.name for v in message.DESCRIPTOR.fields_by_name["GainSource"].enum_type.values}
    assert names == {0: "SDP", 1: "PreviousGain", 2: "LQR", 3: "None", 4: "Riccati"}


def test_truth_is_exact_and_in_order(recorded, messages):
    for vehicle, rows in recorded.truth.items():
        found = [(r.log_time, m) for topic, r, m in messages if topic == f"/truth/veh{vehicle}"]
        assert [(time, [getattr(m, name) for name in TRUTH_NAMES]) for time, m in found] == rows


def test_poses_follow_the_truth(recorded, messages):
    found = [m for topic, _, m in messages if topic == "/tf" and m.transforms[0].child_frame_id == "veh1"]
    assert len(found) == len(recorded.truth[1])
    for cycle, message in enumerate(found):
        assert [t.child_frame_id for t in message.transforms] == ["veh1", "veh2"]
        for vehicle, transform in enumerate(message.transforms, start=1):
            x, y, psi, phi = recorded.truth[vehicle][cycle][1][:4]
            q = transform.rotation
            assert (transform.translation.x, transform.translation.y) == (x, y)
            assert transform.timestamp.ToNanoseconds() == cycle * CYCLE_NS
            # The direction of the vehicle's x axis, and of its y axis, which roll lifts.
            assert 1 - 2 * (q.y**2 + q.z**2) == pytest.approx(math.cos(psi), abs=1e-12)
            assert 2 * (q.x * q.y + q.w * q.z) == pytest.approx(math.sin(psi), abs=1e-12)
            assert 2 * (q.y * q.z + q.w * q.x) == pytest.approx(math.sin(phi), abs=1e-12)


def test_the_scene_has_a_body_for_each_vehicle_and_the_scenarios_lanes(messages):
    (scene,) = [m for topic, _, m in messages if topic == "/scene"]
    entities = {entity.id: entity for entity in scene.entities}
    assert set(entities) == {"veh1", "veh1/slot", "veh2", "veh2/slot", "road"}
    assert entities["veh1"].texts[0].text == "veh1"
    assert entities["veh2"].frame_id == "veh2"
    assert entities["veh2"].frame_locked
    levels = sorted({point.y for line in entities["road"].lines for point in line.points})
    assert levels == [-1.75, 1.75, 5.25, 8.75]


def test_a_plan_is_where_the_planner_is_heading(recorded, messages, codecs):
    wanted = [
        codecs[bus].decode(can_id, data)[1]
        for _, bus, can_id, data, _ in recorded.frames
        if bus == "veh2" and can_id == codecs[bus].can_id("PlannerTarget")
    ]
    plans = [m.poses[0].position for topic, _, m in messages if topic == "/plan/veh2"]
    assert [(p.x, p.y) for p in plans] == [(v["TargetX"], v["TargetY"]) for v in wanted]
    transforms = [t for topic, _, m in messages if topic == "/tf" for t in m.transforms]
    slots = [t.translation for t in transforms if t.child_frame_id == "veh2/slot"]
    assert [(s.x, s.y) for s in slots] == [(p.x, p.y) for p in plans]


def test_processes_have_a_topic_each_from_their_first_sample_on(codecs, tmp_path):
    usages = [ProcessUsage(0.5 * n, 0.25, 1000 + n, n) for n in range(4)]
    with open_writer(tmp_path / "run.mcap", codecs) as writer:
        for n, usage in enumerate(usages):
            writer.process("veh1.planner", n * CYCLE_NS, usage)
            if n > 1:
                writer.process("plant", n * CYCLE_NS, usage)
            writer.flush()
    found = [(topic, r.sequence, m) for topic, r, m in decoded_messages(tmp_path / "run.mcap")]
    planner = [
        (sequence, ProcessUsage(m.cpu_time, m.cpu_share, m.memory, m.preemptions))
        for topic, sequence, m in found
        if topic == "/processes/veh1.planner"
    ]
    assert planner == list(enumerate(usages))
    assert [sequence for topic, sequence, _ in found if topic == "/processes/plant"] == [0, 1]


def test_events_metadata_and_attachments(recorded, messages):
    events = [(r.log_time, m.name, m.message) for topic, r, m in messages if topic == "/events"]
    assert events == [(time, event.source, event.text) for time, event in recorded.events]
    with recorded.path.open("rb") as stream:
        reader = make_reader(stream)
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
        attachments = {record.name: record.data for record in reader.iter_attachments()}
    assert metadata == {
        "run": {"vehicles": "2", "seed": "7"},
        "result": {"status": "completed", "cycles": "40"},
    }
    assert attachments["vehicle.dbc"] == (DBC_DIR / "vehicle.dbc").read_bytes()


def test_text_that_is_not_unicode_is_stored_as_an_escape(tmp_path):
    # As of a file name that is not UTF-8, in an exception or on the command line.
    metadata = {"command": "a\udc9b"}
    with RunWriter(
        tmp_path / "run.mcap", codecs={}, truth_names=[], vehicles=1, metadata=metadata, attachments={}
    ) as writer:
        writer.event(0, RunEnded("failed", "why\ud800"))
        writer.close({"reason": "why\ud800"})
    run = Run(tmp_path / "run.mcap")
    assert (run.metadata["command"], run.metadata["reason"]) == ("a\\udc9b", "why\\ud800")
    (event,) = run.events
    assert event.text.endswith("why\\ud800")
    assert event.fields["reason"] == "why\ud800"


def test_the_summary_counts_what_is_there(recorded, messages):
    with recorded.path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
    counts = Counter(topic for topic, _, _ in messages)
    assert {summary.channels[n].topic: c for n, c in summary.statistics.channel_message_counts.items()} == counts
    assert summary.statistics.chunk_count == len(summary.chunk_indexes) > 5
    # The last chunk may be small; none is much above 64 KiB.
    assert max(index.uncompressed_size for index in summary.chunk_indexes) < 2 * 64 * 1024


def test_sequence_numbers_count_each_channel_without_a_gap(messages):
    numbers = {}
    for topic, record, _ in messages:
        numbers.setdefault(topic, []).append(record.sequence)
    assert all(found == list(range(len(found))) for found in numbers.values())


def test_a_chunk_holds_one_group_of_topics(recorded):
    groups = []
    with recorded.path.open("rb") as stream:
        summary = make_reader(stream).get_summary()
        for index in summary.chunk_indexes:
            topics = {summary.channels[number].topic for number in index.message_index_offsets}
            groups.append({"/".join(topic.split("/")[: 3 if topic.startswith("/signals/") else 2]) for topic in topics})
    parts = [{"/can"}, {"/signals/v2v"}, {"/signals/veh1"}, {"/signals/veh2"}, {"/truth"}]
    assert all(group in parts or group <= {"/tf", "/scene", "/plan", "/events"} for group in groups)
    assert all(part in groups for part in parts)


def test_log_times_rise_through_what_is_read_in_order(recorded, messages):
    with recorded.path.open("rb") as stream:
        times = [record.log_time for _, _, record in make_reader(stream).iter_messages()]
    assert len(times) == len(messages)
    assert all(a <= b for a, b in itertools.pairwise(times))
    raw = [record.log_time for topic, record, _ in messages if topic.startswith("/can/")]
    assert raw == sorted(raw)


def test_channels_say_unit_identifier_and_wall_clock(recorded):
    run = Run(recorded.path)
    assert run.unit("/signals/veh1/VehicleMotion", "YawRate") == "rad/s"
    assert run.unit("/truth/veh2", "psi") == "rad"
    assert run.topics["/signals/veh1/TrackerTiming"].metadata["wall_clock"] == "yes"
    assert run.topics["/signals/veh1/VehicleMotion"].metadata["can_id"] == "0x102"


def test_the_same_run_gives_the_same_bytes(make_log):
    a, b = (make_log(name, seed=3, cycles=12).path for name in ("a.mcap", "b.mcap"))
    assert a.read_bytes() == b.read_bytes()


frames = st.lists(
    st.tuples(
        st.sampled_from(["v2v", "veh1", "veh2"]),
        st.one_of(st.integers(0, 0x7FF), st.sampled_from([0x10, 0x100, 0x104, 0x500, 0x510, 0x511, 0x5F0])),
        st.binary(max_size=8),
        st.integers(0, 2**63 - 1),
    ),
    max_size=60,
)
truth_rows = st.lists(st.lists(st.floats(width=64), min_size=8, max_size=8), max_size=5)


def test_any_frames_and_any_truth_come_back(codecs, tmp_path_factory, tries):
    @settings(deadline=None, max_examples=tries(20, 60))
    @given(frames=frames, rows=truth_rows)
    def come_back(frames, rows):
        assert_come_back(frames, rows, codecs, tmp_path_factory)

    come_back()


def assert_come_back(frames, rows, codecs, tmp_path_factory):
    path = tmp_path_factory.mktemp("any") / "run.mcap"
    writer = open_writer(path, codecs)
    for number, (bus, can_id, data, receive_ns) in enumerate(frames):
        writer.frame(bus, number, can_id, data, receive_ns)
    for number, row in enumerate(rows):
        writer.truth(1, number, row)
    writer.close({})
    run = Run(path)
    assert [(f.bus, f.can_id, f.data, f.receive_ns) for f in run.frames()] == frames
    expected = {}
    for bus, can_id, data, _ in frames:
        try:
            name, values = codecs[bus].decode(can_id, data)
        except DecodeError:
            continue
        expected.setdefault((bus, name), []).append(values)
    assert {(bus, name) for bus in codecs for name in run.messages(bus)} == set(expected)
    for (bus, name), wanted in expected.items():
        columns = run.message(bus, name)
        for signal_name in wanted[0]:
            pairs = zip(columns[signal_name].tolist(), (v[signal_name] for v in wanted), strict=True)
            assert all(same_double(float(a), float(b)) for a, b in pairs)
    if rows:
        found = run.truth(1)
        for column, name in enumerate(TRUTH_NAMES):
            pairs = zip(found[name].tolist(), (row[column] for row in rows), strict=True)
            assert all(a == b or (math.isnan(a) and math.isnan(b)) for a, b in pairs)


def test_a_log_is_never_written_over(recorded, codecs):
    with pytest.raises(BadInput, match=r"run\.mcap already exists"):
        open_writer(recorded.path, codecs)


def test_a_place_that_cannot_be_written_is_named(codecs):
    with pytest.raises(RunFailed, match=r"cannot write the log /proc/none/run\.mcap"):
        open_writer(Path("/proc/none/run.mcap"), codecs)


def test_what_cannot_be_recorded_is_refused(tmp_path, codecs):
    with open_writer(tmp_path / "run.mcap", codecs) as writer:
        with pytest.raises(ValueError, match="9 bytes, not 0 to 8"):
            writer.frame("veh1", 0, 0x100, bytes(9), 0)
        with pytest.raises(ValueError, match="truth row of 2 values, not 8"):
            writer.truth(1, 0, [1.0, 2.0])
        with pytest.raises(ValueError, match="event level 'loud': allowed are debug"):
            writer.event(0, Event(0.0, "loud", "test", "text", "other", {}))
    assert list(Run(tmp_path / "run.mcap").frames()) == []


def test_an_error_in_the_run_closes_the_log_as_failed(tmp_path, codecs):
    def interrupted():
        with open_writer(tmp_path / "run.mcap", codecs) as writer:
            writer.frame("veh1", 0, 0x100, bytes(8), 0)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    run = Run(tmp_path / "run.mcap")
    assert run.result == {"status": "failed"}
    assert len(list(run.frames())) == 1


def in_process(tmp_path, body):
    """Run `body` with an open writer in a process of its own, the log being run.mcap."""
    code = f"""
        import os, resource, signal, sys
        from pathlib import Path
        from bench.bus.codec import load_codecs
        from bench.record import RunWriter
        writer = RunWriter(Path("run.mcap"), codecs=load_codecs(1), truth_names=["X"], vehicles=1,
                           metadata={{}}, attachments={{}})
        def record(cycles):
            for cycle in range(cycles):
                for can_id in (0x100, 0x101, 0x102, 0x511):
                    writer.frame("veh1", cycle * 10_000_000, can_id, bytes(8), 0)
        {textwrap.dedent(body).strip().replace(chr(10), chr(10) + " " * 8)}
    """
    return subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code)],
        capture_output=True,
        text=True,
        check=False,
        cwd=tmp_path,
        env={"PYTHONPATH": str(ROOT)},
    )


def test_a_killed_run_keeps_all_but_its_last_chunk(tmp_path):
    done = in_process(tmp_path, "record(5000)\nos.kill(os.getpid(), signal.SIGKILL)")
    assert done.returncode == -signal.SIGKILL
    with pytest.warns(UserWarning, match="ends before its summary"):
        run = Run(tmp_path / "run.mcap")
    kept = len(run.frame_table("veh1"))
    # A chunk is at most 64 KiB, which is at least 400 of these frames.
    assert 20_000 - 1000 < kept <= 20_000


def test_what_is_flushed_is_kept_when_killed(tmp_path):
    done = in_process(tmp_path, "record(3)\nwriter.flush()\nos.kill(os.getpid(), signal.SIGKILL)")
    assert done.returncode == -signal.SIGKILL
    with pytest.warns(UserWarning, match="ends before its summary"):
        assert len(Run(tmp_path / "run.mcap").frame_table("veh1")) == 12


def test_a_full_disk_is_one_clear_error(tmp_path):
    # A limit on the file's size stands in for the disk's end; the system reports both the same way.
    body = """
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (250_000, 250_000))
    try:
        record(50_000)
    except Exception as error:
        print(type(error).__name__, error)
    """
    done = in_process(tmp_path, body)
    assert done.stdout == "RunFailed cannot write the log run.mcap: File too large\n", done.stderr
    assert (tmp_path / "run.mcap").stat().st_size <= 250_000
    with pytest.warns(UserWarning, match="ends before its summary"):
        assert len(Run(tmp_path / "run.mcap").frame_table("veh1")) > 0
