"""Events in the log: what happened comes back by kind and fields, also from logs that had nothing but its text."""

import json
from collections.abc import Mapping
from pathlib import Path

import pytest
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Log_pb2 import Log
from mcap.reader import make_reader
from mcap.writer import Writer

from bench import events
from bench.bus.codec import Codec
from bench.errors import BadInput
from bench.record import event as event_record
from bench.record import foxglove
from bench.record.event import Event
from bench.record.old_events import kind_and_fields
from bench.record.reader import Run
from bench.resim.history import read_history

from .conftest import open_writer
from .test_writer import decoded_messages

OLD_LOG = Path(__file__).with_name("old_events.mcap")
"""The events of a run by a version whose logs had no kinds; all else of it is left out but scenario and metadata."""

BURSTS = {"to_bad": 0.1, "to_good": 0.3, "loss_good": 0.0, "loss_bad": 1.0}
MISSED_S = "in cycle 20 (t = 0.20 s) veh2.tracker (process 7) was killed by SIGSEGV; its last words:\nreading address 0"

OLD: list[tuple[events.Event, str, str, str]] = [
    (
        events.FaultBegins("ecu_crash", {"ecu": "veh2.tracker"}, 0.3),
        *("warning", "fault", "ecu_crash: ecu veh2.tracker begins, until 0.3 s"),
    ),
    (
        events.FaultBegins("frame_loss", {"bus": "v2v", "probability": 1.0, "bursts": BURSTS}, None),
        *("warning", "fault", f"frame_loss: bus v2v, probability 1.0, bursts {BURSTS} begins, until the end"),
    ),
    (events.FaultBegins("v2v_outage", {}, None), "warning", "fault", "v2v_outage begins, until the end"),
    (
        events.FaultEnds("actuator_stuck", {"vehicle": 1, "actuator": "steering", "value": 0.02}),
        *("warning", "fault", "actuator_stuck: vehicle 1, actuator steering, value 0.02 ends"),
    ),
    (
        events.FaultRequested({"at_s": 0.12, "kind": "ice_patch", "vehicle": 1, "mu": 0.3}),
        *("info", "conductor"),
        'asked for while running: {"at_s": 0.12, "kind": "ice_patch", "vehicle": 1, "mu": 0.3}',
    ),
    (events.StateChange("info", "veh1.planner", "init", "run"), "info", "veh1.planner", "init -> run"),
    (events.StateChange("info", "veh1.actuators", "hold", "active"), "info", "veh1.actuators", "hold -> active"),
    (
        events.StateChange("warning", "veh3.tracker", "run", "degraded", "ReferenceDegraded"),
        *("warning", "veh3.tracker", "run -> degraded (ReferenceDegraded)"),
    ),
    (events.StateChange("warning", "veh3.tracker", "init", "5"), "warning", "veh3.tracker", "init -> 5"),
    (
        events.EcuFailed(["veh2.tracker", "veh1.planner"], MISSED_S),
        *("error", "conductor", f"{MISSED_S}; the run goes on without veh2.tracker, veh1.planner"),
    ),
    (
        events.ReceptionErrors("veh3", "TrackerBusHealth", 8, 28),
        *("warning", "veh3", "TrackerBusHealth: FramesLost 8, E2EErrors 28"),
    ),
    (
        events.StrayFrame("veh3", 0x104),
        *("warning", "conductor", "frame 0x104 on veh3 is not due in the cycle it came in, or came twice"),
    ),
    (events.ProcessOutput("veh1.tracker", "a line\nand -> b\n"), "warning", "veh1.tracker", "a line\nand -> b\n"),
    (events.DeadlineMissed("veh1.plant", 1.5), "warning", "veh1.plant", "missed its deadline: was 1.50 ms late"),
    (events.DeadlineMissed("veh1.plant", None), "warning", "veh1.plant", "missed its deadline: sent nothing"),
    (events.DeadlineMet("veh1.tracker", 3), "info", "veh1.tracker", "in time again after 3 missed deadlines"),
    (
        events.ResponseBeyondPeriod("veh1", "PlantTiming", 0x5F2, 10.25, 10.0, 310_000),
        *("warning", "bus", "bus veh1: in the worst case PlantTiming (0x5F2) takes up to 10.25 ms at 310 kbit/s, "),
    ),
    (
        events.ResponseBeyondPeriod("v2v", "V2VMotion_1", 0x120, None, 10.0, 62_500),
        *("warning", "bus", "bus v2v: in the worst case V2VMotion_1 (0x120) takes without bound at 62.5 kbit/s, "),
    ),
    (
        events.Scheduling(fifo=True, own_cores=True, processes=None, cores=None),
        *("info", "conductor", "SCHED_FIFO, each on a core of its own"),
    ),
    (
        events.Scheduling(fifo=False, own_cores=False, processes=8, cores=2),
        *("warning", "conductor"),
        "no SCHED_FIFO (it takes root, CAP_SYS_NICE or a limit set with ulimit -r), 8 processes share 2 cores",
    ),
    (
        events.StolenTime(0.01),
        *("info", "conductor"),
        "the host of this virtual machine took 0.01 s of processor time from it meanwhile",
    ),
    (events.RunEnded("interrupted", "interrupted by SIGINT"), "fatal", "conductor", "interrupted by SIGINT"),
    (events.RunEnded("failed", MISSED_S), "fatal", "conductor", MISSED_S),
]
"""An event of each kind, and level, source and text of what logs without kinds had for it."""

NEW: list[events.Event] = [
    events.StateChange("warning", "veh3.planner", "degraded", "safe", "OwnMotionLost", "SensorLost"),
    events.CauseChange("warning", "veh3.planner", "degraded", "PeerLost", "PeerMissing"),
    events.HardBraking("info", "veh2.planner", True),
    events.HardBraking("info", "veh2.planner", False),
    events.Uncomfortable("info", "veh2.planner", True),
    events.Uncomfortable("info", "veh2.planner", False),
    events.StrayFrame("veh1", 0x107, "wrong_length", 1),
    events.StrayFrame("v2v", None, "malformed"),
    events.FramesRefused("veh1", {"wrong_length": 3}, {"wrong_length": {"0x107": 3}}),
    events.FramesLost("veh1", 7),
    events.NotANumber("veh1.tracker", 20, "SteeringCommand", "SteeringAngle", "nan", command=True),
    events.NumberAgain("veh1.tracker", 25, "SteeringCommand", "SteeringAngle", 5),
    events.Clipped("veh1.tracker", 20, "SteeringCommand", "SteeringAngle", 2.0, 1.0),
]
"""What logs without kinds did not have."""

EVENTS = [event for event, *_ in OLD] + NEW


def all_kinds(kind: type = events._Kind) -> set[str]:
    below = [name for each in kind.__subclasses__() for name in all_kinds(each)]
    return {kind.kind, *below} if "kind" in vars(kind) else set(below)


def test_every_kind_of_event_comes_back(tmp_path: Path, codecs: Mapping[str, Codec]) -> None:
    assert {event.kind for event in EVENTS} == all_kinds()
    with open_writer(tmp_path / "run.mcap", codecs) as writer:
        for number, event in enumerate(EVENTS):
            writer.event(number, event)
    assert Run(tmp_path / "run.mcap").events == [
        Event(number / 1e9, event.level, event.source, event.text, event.kind, event.fields)
        for number, event in enumerate(EVENTS)
    ]


def test_an_event_is_whole_on_one_topic_and_a_foxglove_log_on_another(
    tmp_path: Path, codecs: Mapping[str, Codec]
) -> None:
    with open_writer(tmp_path / "run.mcap", codecs) as writer:
        for number, event in enumerate(EVENTS):
            writer.event(number, event)
    with (tmp_path / "run.mcap").open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    schema = next(schema for schema in summary.schemas.values() if schema.name == "foxglove.Log")
    assert (schema.name, schema.data) == foxglove.schema(Log)
    found = list(decoded_messages(tmp_path / "run.mcap"))
    logs = [(r.log_time, m.name, m.message) for topic, r, m in found if topic == "/events"]
    assert logs == [(number, event.source, event.text) for number, event in enumerate(EVENTS)]
    data = [(r.log_time, m.source, m.kind, json.loads(m.fields)) for topic, r, m in found if topic == "/events/data"]
    assert data == [(number, event.source, event.kind, event.fields) for number, event in enumerate(EVENTS)]


def test_a_kind_of_another_version_goes_through_reading_and_writing(
    tmp_path: Path, codecs: Mapping[str, Codec]
) -> None:
    strange = Event(0.25, "debug", "veh1", "a wheel was changed", "wheel_changed", {"wheel": ["fl", 1, None]})
    with open_writer(tmp_path / "run.mcap", codecs) as writer:
        writer.event(250_000_000, strange)
    assert Run(tmp_path / "run.mcap").events == [strange]


@pytest.mark.parametrize(
    ("event", "text"),
    [
        (events.FaultBegins("v2v_outage", {"vehicle": 3}, 4.5), "v2v_outage begins: vehicle 3, until 4.5 s"),
        (events.FaultBegins("v2v_outage", {}, None), "v2v_outage begins: until the end"),
        (events.FaultEnds("v2v_outage", {"vehicle": 3}), "v2v_outage ends: vehicle 3"),
        (events.FaultEnds("v2v_outage", {}), "v2v_outage ends"),
        (
            events.FaultRequested({"at_s": 1.5, "for_s": 2.0, "bus": "veh2", "kind": "frame_loss", "bursts": None}),
            "frame_loss is injected: bus veh2, from 1.5 s for 2 s",
        ),
        (
            events.FaultRequested({"at_s": 0.12, "for_s": None, "kind": "v2v_outage", "vehicle": 1}),
            "v2v_outage is injected: vehicle 1, from 0.12 s to the end",
        ),
        (events.DeadlineMet("veh1.tracker", 1), "in time again after 1 missed deadline"),
        (events.FramesLost("veh1", 1), "1 frame on veh1 came faster than it could be read, and is not in the log"),
        (
            events.FramesLost("veh1", 20_000),
            "20,000 frames on veh1 came faster than they could be read, and are not in the log",
        ),
    ],
)
def test_an_event_is_a_sentence(event: events.Event, text: str) -> None:
    assert event.text == text


@pytest.mark.parametrize(("event", "level", "source", "text"), OLD)
def test_old_texts_are_understood(event: events.Event, level: str, source: str, text: str) -> None:
    if event.kind == events.ResponseBeyondPeriod.kind:
        text += "longer than its period of 10 ms"
    assert kind_and_fields(level, source, text) == (event.kind, event.fields)


@pytest.mark.parametrize(
    ("level", "source", "text"),
    [
        ("warning", "conductor", "something that nobody knows"),
        ("info", "veh1.tracker", "hello"),
        ("warning", "fault", "begins, until the end"),
        ("info", "conductor", "asked for while running: {no JSON}"),
        ("warning", "fault", "init -> run"),
        ("info", "", ""),
    ],
)
def test_old_texts_that_say_nothing_known_are_kept_as_they_are(level: str, source: str, text: str) -> None:
    assert kind_and_fields(level, source, text) == (events.OTHER, {})


def test_an_old_log_tells_what_happened() -> None:
    run = Run(OLD_LOG)
    kinds = [event.kind for event in run.events]
    assert {kind: kinds.count(kind) for kind in kinds} == {
        **{"state_change": 16, "fault_begins": 4, "fault_ends": 3, "reception_errors": 3, "stray_frame": 7},
        **{"fault_requested": 1, "ecu_failed": 1},
    }
    history = read_history(run)
    assert [fault.kind for fault in history.faults] == ["frame_loss", "frame_corrupt", "v2v_outage", "ice_patch"]
    assert (history.untold, history.ended) == (0, {"veh2.planner": 20})


@pytest.mark.parametrize("fields", ["[1]", "{", "", "7"])
def test_fields_that_are_no_json_object_are_an_error_that_names_the_topic(tmp_path: Path, fields: str) -> None:
    damaged = log_of(tmp_path, event_record.TOPIC, event_record.NAME, event_record.SCHEMA, data_of(fields))
    with pytest.raises(BadInput, match="topic /events/data has messages that are not events"):
        _ = damaged.events


def test_another_schema_on_the_topic_is_an_error_that_names_it(tmp_path: Path) -> None:
    for topic in ("/events", event_record.TOPIC):
        strange = log_of(tmp_path, topic, *foxglove.schema(FrameTransforms), b"")
        with pytest.raises(BadInput, match=f"topic {topic} has messages that are not events"):
            _ = strange.events


def data_of(fields: str) -> bytes:
    """An event whose fields are this text, as protobuf: field 5, of bytes."""
    return b"\x2a" + bytes([len(fields)]) + fields.encode()


def log_of(folder: Path, topic: str, name: str, schema: bytes, message: bytes) -> Run:
    """A log with one message."""
    with (folder / "strange.mcap").open("wb") as stream:
        writer = Writer(stream)
        writer.start("test")
        channel = writer.register_channel(topic, "protobuf", writer.register_schema(name, "protobuf", schema))
        writer.add_message(channel, 0, message, 0)
        writer.finish()
    return Run(folder / "strange.mcap")
