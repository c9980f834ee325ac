"""A real run's log seen by us and by mcap's own reader with google.protobuf: the same numbers, topic by topic."""

from collections import defaultdict

import numpy as np
import pytest
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

from bench.record import Run

from .test_writer import decoded_messages

FOXGLOVE = {"/tf": FrameTransforms, "/scene": SceneUpdate, "/events": Log}


@pytest.fixture(scope="module")
def theirs(real_log):
    """topic -> (record, protobuf message) in the order of the file, decoded from nothing but what is in it."""
    found = defaultdict(list)
    for topic, record, message in decoded_messages(real_log):
        found[topic].append((record, message))
    return found


def test_every_value_of_every_table_is_the_same(real_log, theirs):
    log = Run(real_log).log
    assert set(log.topics) == set(theirs)
    tables = {topic for topic in theirs if topic.startswith(("/signals/", "/truth/", "/processes/"))}
    assert len(tables) > 80
    assert set(log.tables(sorted(tables))) == tables
    for topic, columns in log.tables(sorted(tables)).items():
        assert columns.time_ns.tolist() == [record.log_time for record, _ in theirs[topic]]
        names = [field.name for field in theirs[topic][0][1].DESCRIPTOR.fields]
        assert list(columns) == ["t", *names]
        for name in names:
            np.testing.assert_array_equal(columns[name], [getattr(message, name) for _, message in theirs[topic]])


def test_every_frame_is_the_same(real_log, theirs):
    run = Run(real_log)
    assert run.buses == ["v2v", "veh1", "veh2", "veh3"]
    for bus in run.buses:
        wanted = [
            (r.log_time, m.id, m.data, m.receive_time, m.wire_time, m.response_time) for r, m in theirs[f"/can/{bus}"]
        ]
        frames = [frame for frame in run.frames() if frame.bus == bus]
        found = [(f.time_ns, f.can_id, f.data, f.receive_ns, f.wire_ns, f.response_ns) for f in frames]
        assert found == wanted
        table = run.frame_table(bus)
        assert table["can_id"].tolist() == [m.id for _, m in theirs[f"/can/{bus}"]]
        assert [row["data"].tobytes()[: row["length"]] for row in table] == [m.data for _, m in theirs[f"/can/{bus}"]]


def test_foxgloves_messages_are_the_same_by_its_own_classes(real_log, theirs):
    log = Run(real_log).log
    kinds = FOXGLOVE | {topic: PosesInFrame for topic in theirs if topic.startswith("/plan/")}
    assert len(kinds) == 6
    for topic, kind in kinds.items():
        payloads = [payload for group in log.parts([topic]) for _, part in group for payload in part.payloads()]
        assert [kind.FromString(payload) for payload in payloads] == [
            kind.FromString(record.data) for record, _ in theirs[topic]
        ]
        # The schema in the file says the same of them as Foxglove's own.
        for payload, (_, message) in zip(payloads, theirs[topic], strict=True):
            assert str(kind.FromString(payload)) == str(message)
    events = [(r.log_time / 1e9, m.name, m.message) for r, m in theirs["/events"]]
    assert [(event.time_s, event.source, event.text) for event in Run(real_log).events] == events


def test_counts_and_times_of_the_index_are_those_of_the_messages(real_log, theirs):
    log = Run(real_log).log
    for topic, messages in theirs.items():
        times = [record.log_time for record, _ in messages]
        assert log.count(topic) == len(messages)
        assert log.span(topic) == (min(times), max(times) + 1)
