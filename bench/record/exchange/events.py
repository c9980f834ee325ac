"""Exports the events of a log as a table: a row for each event, a column for each named field."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from enum import StrEnum
from pathlib import Path
from typing import Any

import polars as pl

from bench.bus.network import ROLES
from bench.errors import BadInput
from bench.files import check_new, written_aside
from bench.mcap.time_span import NS, Span
from bench.names import vehicle_of
from bench.record.event import Event
from bench.record.reader import Run

MOST_FIELDS = 200
"""Maximum number of columns for named fields; the bench's own kinds have fewer than 50 together."""

_LONGEST = 1 << 63

_LEVELS = 20
"""Objects and lists of a field nested deeper than this are left out; the bench's own have two levels."""

_SHARED = {"vehicle": pl.Int64, "ecu": pl.String}
"""These are named fields of some kinds; of the others they are what the source and the fault's parameters say."""

_COLUMNS = {
    **{"t": pl.Float64, "kind": pl.String, "level": pl.String, "source": pl.String},
    **_SHARED,
    "text": pl.String,
}

_FORMULA = r"^[=+\-@\t\r]"
"""The beginning of a text that a spreadsheet takes for a formula."""


class EventFormat(StrEnum):
    """A format of the events."""

    CSV = "csv"
    PARQUET = "parquet"
    JSON = "json"

    @property
    def suffix(self) -> str:
        """Suffix of its files."""
        return f".{self.value}"


def export_events(
    log: Path, target: Path, kind: EventFormat, *, start_s: float | None = None, end_s: float | None = None
) -> int:
    """Write the events of `log`, in order, to the new file `target`; return their number.

    CSV and Parquet have the columns t (s), kind, level, source, vehicle, ecu and text, then one for each named field of
    these events; a list or an object is JSON. In CSV, a text that a spreadsheet would take for a formula begins with an
    apostrophe. JSON has a list of objects with the same keys, and the named fields in `fields`.

    Args:
        log: the log.
        target: the file.
        kind: its format.
        start_s: only events of this time or later.
        end_s: only events of an earlier time.

    Raises:
        BadInput: the log cannot be read, its events have too many different fields for a table, the times are an empty
            range, or the file cannot be written.
    """
    check_new(target, kind.suffix)
    span = Span.of(start_s, end_s)
    rows = [_row(event) for event in Run(log).events if span.start_ns <= round(event.time_s * NS) < span.end_ns]
    if kind is EventFormat.JSON:
        text = json.dumps(rows, ensure_ascii=False, allow_nan=False, indent=1)
        with written_aside(target, new=True) as path:
            path.write_text(f"{text}\n", encoding="utf-8")
        return len(rows)
    table = _table(log, rows)
    with written_aside(target, new=True) as path:
        if kind is EventFormat.CSV:
            safe = table.with_columns(pl.col(pl.String).str.replace(_FORMULA, "'${0}"))
            safe.rename({"t": "t [s]"}).write_csv(path)
        else:
            table.write_parquet(path)
    return len(rows)


def _row(event: Event) -> dict[str, Any]:
    """Return an event as JSON values, with the named fields in `fields`."""
    fields = _plain(event.fields)
    vehicle, ecu = _whose(event.source, fields)
    texts = {"kind": event.kind, "level": event.level, "source": event.source}
    return {
        "t": event.time_s,
        **{name: _plain(text) for name, text in texts.items()},
        **{"vehicle": vehicle, "ecu": ecu, "text": _plain(event.text), "fields": fields},
    }


def _whose(source: str, fields: Mapping[str, Any]) -> tuple[int | None, str | None]:
    """Return the vehicle and the ECU that an event is about, each None if it is about none or several."""
    fault: Mapping[str, Any] = next(
        (fields[name] for name in ("parameters", "fault") if isinstance(fields.get(name), dict)), {}
    )
    ecus = fields.get("ecus")
    failed = ecus[0] if isinstance(ecus, list) and len(ecus) == 1 else None
    said = (fields.get("ecu"), fault.get("ecu"), fault.get("node"), failed, source)
    ecu = next((name for name in said if isinstance(name, str) and name.partition(".")[2] in ROLES), None)
    number = next((each for each in (fields.get("vehicle"), fault.get("vehicle")) if type(each) is int), None)
    if number is None:
        names = (ecu, *said, fault.get("bus"), fields.get("bus"))
        found = (vehicle_of(name) for name in names if isinstance(name, str))
        number = next((each for each in found if each is not None), None)
    return number if number is None or abs(number) < _LONGEST else None, ecu


def _table(log: Path, rows: Sequence[Mapping[str, Any]]) -> pl.DataFrame:
    names = [name for name in dict.fromkeys(name for row in rows for name in row["fields"]) if name not in _SHARED]
    if len(names) > MOST_FIELDS:
        raise BadInput(
            f"{log}: its events have {len(names)} different fields; a table has at most {MOST_FIELDS}: use json"
        )
    columns = [pl.Series(name, [row[name] for row in rows], kind) for name, kind in _COLUMNS.items()]
    for name in names:
        title = f"fields.{name}" if name in _COLUMNS else name
        columns.append(_column(title, [row["fields"].get(name) for row in rows]))
    return pl.DataFrame(columns)


def _column(title: str, values: Sequence[Any]) -> pl.Series:
    """Return values as a column of numbers, or of booleans, or else of text."""
    kinds = {type(value) for value in values if value is not None}
    if kinds == {bool}:
        return pl.Series(title, values, pl.Boolean)
    if kinds == {int} and all(value is None or abs(value) < _LONGEST for value in values):
        return pl.Series(title, values, pl.Int64)
    if kinds and kinds <= {int, float}:
        return pl.Series(title, [None if value is None else float(value) for value in values], pl.Float64)
    return pl.Series(title, [_text(value) for value in values], pl.String)


def _text(value: Any) -> str | None:
    return value if value is None or isinstance(value, str) else json.dumps(value, ensure_ascii=False)


def _plain(value: Any, levels: int = _LEVELS) -> Any:
    """Return a value without what other logs may hold and JSON or UTF-8 does not: NaN, infinity, surrogates."""
    if isinstance(value, str):
        return value.encode(errors="replace").decode()
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {_plain(str(name)): _plain(each, levels - 1) for name, each in value.items()} if levels else None
    if isinstance(value, (list, tuple)):
        return [_plain(each, levels - 1) for each in value] if levels else None
    return value
