"""`platoon log export --events`: all events of a log as a table that a spreadsheet opens."""

import csv
import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import polars as pl
import pytest

from bench import events
from bench.bus.codec import Codec
from bench.errors import BadInput
from bench.record import event as event_record
from bench.record.event import Event
from bench.record.exchange.events import MOST_FIELDS, EventFormat, export_events
from bench.record.reader import Run

from .conftest import open_writer
from .test_events import EVENTS, OLD_LOG, data_of, log_of

FIXED = ["t", "kind", "level", "source", "vehicle", "ecu", "text"]
REFERENCES = Path(__file__).parents[1] / "reference"


def log_with(folder: Path, codecs: Mapping[str, Codec], told: Sequence[events.Event]) -> Path:
    with open_writer(folder / "run.mcap", codecs) as writer:
        for number, event in enumerate(told):
            writer.event(number * 10_000_000, event)
    return folder / "run.mcap"


def exported(log: Path, kind: EventFormat, **times: float) -> list[dict[str, object]]:
    """The events in a file of that format, as rows."""
    target = log.with_name(f"out{kind.suffix}")
    count = export_events(log, target, kind, **times)
    match kind:
        case EventFormat.CSV:
            with target.open(newline="", encoding="utf-8") as stream:
                rows: list[dict[str, object]] = [dict(row) for row in csv.DictReader(stream)]
        case EventFormat.PARQUET:
            rows = pl.read_parquet(target).to_dicts()
        case EventFormat.JSON:
            rows = json.loads(target.read_text(encoding="utf-8"))
    target.unlink()
    assert len(rows) == count
    return rows


def test_events_of_every_kind_come_with_all_their_fields(tmp_path: Path, codecs: Mapping[str, Codec]) -> None:
    log = log_with(tmp_path, codecs, EVENTS)
    table, whole, texts = (exported(log, kind) for kind in (EventFormat.PARQUET, EventFormat.JSON, EventFormat.CSV))
    for number, (event, row, each, text) in enumerate(zip(EVENTS, table, whole, texts, strict=True)):
        fields = json.loads(json.dumps(event.fields))
        assert list(row)[:7] == list(each)[:7] == FIXED
        assert (row["t"], row["kind"], row["level"]) == (number / 100, event.kind, event.level)
        assert (row["source"], row["text"]) == (event.source, event.text)
        assert (each["fields"], {name: row[name] for name in FIXED}) == (
            fields,
            {name: each[name] for name in FIXED},
        )
        for name, value in fields.items():
            shown = row[name]
            # A column with values of several kinds is text.
            is_text = isinstance(shown, str) and not isinstance(value, str)
            assert (json.loads(str(shown)) if is_text else shown) == value
        assert float(str(text["t [s]"])) == number / 100
        assert text["text"] == event.text
        assert text["vehicle"] == ("" if row["vehicle"] is None else str(row["vehicle"]))


@pytest.mark.parametrize(
    ("event", "vehicle", "ecu"),
    [
        (events.StateChange("info", "veh3.planner", "init", "run"), 3, "veh3.planner"),
        (events.StateChange("info", "veh3.actuators", "init", "active"), 3, None),
        (events.CauseChange("warning", "veh12.tracker", "run", "SensorLost", ""), 12, "veh12.tracker"),
        (events.FaultBegins("ecu_crash", {"ecu": "veh2.tracker"}, 1.0), 2, "veh2.tracker"),
        (events.FaultBegins("bus_off", {"node": "veh2.planner"}, 1.0), 2, "veh2.planner"),
        (events.FaultEnds("actuator_stuck", {"vehicle": 1, "actuator": "steering"}), 1, None),
        (events.FaultBegins("frame_loss", {"bus": "veh2", "message": "Reference"}, None), 2, None),
        (events.FaultBegins("v2v_outage", {}, None), None, None),
        (events.FaultRequested({"kind": "ecu_hang", "ecu": "veh1.planner"}), 1, "veh1.planner"),
        (events.EcuFailed(["veh2.tracker"], "it crashed"), 2, "veh2.tracker"),
        (events.EcuFailed(["veh2.tracker", "veh1.planner"], "they crashed"), None, None),
        (events.StrayFrame("veh3", 1), 3, None),
        (events.StrayFrame("v2v", 1), None, None),
        (events.DeadlineMissed("veh1.plant", 1.0), 1, None),
        (events.ProcessOutput("veh2.tracker", "nan"), 2, "veh2.tracker"),
        (events.RunEnded("failed", "why"), None, None),
    ],
)
def test_vehicle_and_ecu_are_those_that_the_event_is_about(
    tmp_path: Path, codecs: Mapping[str, Codec], event: events.Event, vehicle: int | None, ecu: str | None
) -> None:
    (row,) = exported(log_with(tmp_path, codecs, [event]), EventFormat.PARQUET)
    assert (row["vehicle"], row["ecu"]) == (vehicle, ecu)


@pytest.mark.parametrize("kind", EventFormat, ids=str)
def test_a_time_range_begins_with_its_start_and_stops_before_its_end(
    tmp_path: Path, codecs: Mapping[str, Codec], kind: EventFormat
) -> None:
    log = log_with(tmp_path, codecs, EVENTS)
    times = [float(str(row.get("t", row.get("t [s]")))) for row in exported(log, kind, start_s=0.02, end_s=0.05)]
    assert times == [0.02, 0.03, 0.04]


@pytest.mark.parametrize("kind", EventFormat, ids=str)
def test_logs_of_older_versions_are_exported(tmp_path: Path, kind: EventFormat) -> None:
    (tmp_path / "old.mcap").write_bytes(OLD_LOG.read_bytes())
    rows = exported(tmp_path / "old.mcap", kind)
    assert [row["text"] for row in rows] == [event.text for event in Run(OLD_LOG).events]
    assert [str(row["vehicle"]) for row in rows[:6]] == ["1", "1", "2", "2", "1", "2"]
    (tmp_path / "reference.mcap").write_bytes((REFERENCES / "faults.mcap").read_bytes())
    assert exported(tmp_path / "reference.mcap", kind) == []


@pytest.mark.parametrize("kind", EventFormat, ids=str)
def test_whatever_another_log_says_is_exported(tmp_path: Path, codecs: Mapping[str, Codec], kind: EventFormat) -> None:
    fields = [
        {"t": "yesterday", "kind": 1, "vehicle": "three", "ecu": ["x"], "huge": 10**30, "mixed": 1, "parameters": 7},
        {"mixed": "text", "vehicle": 10**30, "ecus": [3], "fault": {"ecu": 4, "vehicle": True, "bus": []}},
        {"mixed": [1, {"a": None}], "huge": 1.5, "flag": True},
        {"deep": json.loads("[" * 900 + "]" * 900)},
    ]
    source = f"veh{'9' * 5000}"
    told = [Event(0.0, "warning", source, "=1+1\n\x1b[31m\u202e", "strange", each) for each in fields]
    rows = exported(log_with(tmp_path, codecs, told), kind)
    assert [row["kind"] for row in rows] == ["strange"] * 4
    assert {row["source"] for row in rows} == {source}
    if kind is EventFormat.CSV:
        assert {row["text"] for row in rows} == {"'=1+1\n\x1b[31m\u202e"}
        assert [row["mixed"] for row in rows] == ["1", "text", '[1, {"a": null}]', ""]
        assert rows[0]["fields.t"] == "yesterday"


@pytest.mark.parametrize("kind", EventFormat, ids=str)
def test_what_is_neither_json_nor_utf_8_is_replaced(tmp_path: Path, kind: EventFormat) -> None:
    fields = '{"a": "\\ud800", "b": [NaN, -Infinity], "c": 1e999}'
    log = log_of(tmp_path, event_record.TOPIC, event_record.NAME, event_record.SCHEMA, data_of(fields)).path
    (row,) = exported(log, kind)
    if kind is EventFormat.JSON:
        assert row["fields"] == {"a": "?", "b": [None, None], "c": None}
    else:
        assert (row["a"], row["b"], row["c"] or None) == ("?", "[null, null]", None)


def test_more_fields_than_a_table_has_columns_are_for_json(tmp_path: Path, codecs: Mapping[str, Codec]) -> None:
    many = Event(0.0, "info", "x", "y", "z", {f"field {number}": number for number in range(MOST_FIELDS + 1)})
    log = log_with(tmp_path, codecs, [many])
    for kind in (EventFormat.CSV, EventFormat.PARQUET):
        with pytest.raises(BadInput, match=f"{MOST_FIELDS + 1} different fields; .* use json"):
            exported(log, kind)
    assert len(exported(log, EventFormat.JSON)) == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run.mcap"]
