"""Signals as polars tables: joined on one time base, messages as recorded, events.

Time is the column `t` in s. A table goes to pandas through Arrow: `table.to_pandas()`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
import polars as pl

from bench.errors import BadInput
from bench.mcap.time_span import FOREVER_NS, NS, Span, to_ns
from bench.record.catalogue import Place
from bench.record.columns import Columns
from bench.record.event import Event
from bench.record.time_join import last_until
from bench.record.topic_decoder import TopicDecoder
from bench.record.topic_reader import TopicReader

MAX_ROWS = 50_000_000
"""Maximum number of rows of a table: a step that gives more is probably a mistake."""

Times = npt.NDArray[np.int64]


def joined(
    log: TopicReader, places: Mapping[str, Place], span: Span, every_s: float | None, *, labels: bool
) -> pl.DataFrame:
    """Return the signals of `places` (name -> place) joined, see `Run.table`.

    Raises:
        BadInput: the step is invalid, or gives too many rows.
    """
    step = None if every_s is None else step_ns(every_s)
    topics = list(dict.fromkeys(place.topic for place in places.values()))
    begin = log.start_of_last_before(topics, span.start_ns) if span.start_ns > 0 else 0
    tables = {topic: _in_order(table) for topic, table in log.tables(topics, Span(begin, span.end_ns)).items()}
    times = {topic: table.time_ns for topic, table in tables.items()}
    base = _every_time(times, span) if step is None else _steps(times, span, step)
    rows = {topic: last_until(at, base) for topic, at in times.items()}
    columns = {"t": pl.Series("t", base / NS)}
    for name, (topic, field) in places.items():
        held = rows[topic]
        values = _series(name, tables[topic][field], log.decoder(topic), field, labels=labels)
        # An index of None gives null: no value yet.
        index = (
            pl.Series(held).set(pl.Series(held < 0), None) if len(values) else pl.repeat(None, len(held), eager=True)
        )
        columns[name] = values.gather(index.cast(pl.UInt32))
    return pl.DataFrame(columns)


def step_ns(every_s: float) -> int:
    """Return a step in ns.

    Raises:
        BadInput: it is less than 1 ns.
    """
    step = to_ns(every_s, "--every / every_s")
    if step <= 0:
        raise BadInput(f"--every / every_s {every_s}: give a step in s, at least 1e-9")
    return step


def message_table(columns: Columns, decoder: TopicDecoder, *, labels: bool) -> pl.DataFrame:
    """Return the values of a topic as recorded."""
    series = [_series(name, columns[name], decoder, name, labels=labels) for name in decoder.names]
    return pl.DataFrame([pl.Series("t", columns["t"]), *series])


def event_table(events: Sequence[Event]) -> pl.DataFrame:
    """Return events as `t`, `level`, `source`, `text`, `kind` and `fields`, a JSON object."""
    names = ("level", "source", "text", "kind")
    rows = [(event.time_s, *(getattr(event, name) for name in names), json.dumps(event.fields)) for event in events]
    schema = {"t": pl.Float64, **dict.fromkeys((*names, "fields"), pl.String)}
    return pl.DataFrame(rows, schema=schema, orient="row")


def signal_table(log: TopicReader, places: Mapping[str, Place], *, ranges: bool) -> pl.DataFrame:
    """Return a description of the signals of `places` (name -> place), see `Run.signal_table`."""
    spans = {topic: log.span(topic) for topic in {place.topic for place in places.values()}}
    limits = _limits(log, places) if ranges else {}
    rows = []
    for name, (topic, field) in places.items():
        decoder, span = log.decoder(topic), spans[topic]
        first, last = (None, None) if span is None else (span.start_ns / NS, (span.end_ns - 1) / NS)
        row = {"name": name, "unit": decoder.unit(field), "values": log.count(topic), "start_s": first, "end_s": last}
        if ranges:
            row["min"], row["max"] = limits.get(name, (None, None))
        rows.append({**row, "comment": decoder.comments.get(field, "")})
    numbers = dict.fromkeys(("start_s", "end_s", "min", "max"), pl.Float64)
    return pl.DataFrame(rows, schema_overrides={key: kind for key, kind in numbers.items() if key in rows[0]})


def _limits(log: TopicReader, places: Mapping[str, Place]) -> dict[str, tuple[float, float]]:
    """Return minimum and maximum of each signal with values, ignoring NaN."""
    found: dict[str, tuple[float, float]] = {}
    for topic in dict.fromkeys(place.topic for place in places.values()):
        table = log.tables([topic])[topic]
        for name, place in places.items():
            if place.topic == topic:
                values = table[place.field].astype(np.float64)
                values = values[~np.isnan(values)]
                if len(values):
                    found[name] = float(values.min()), float(values.max())
    return found


def _in_order(table: Columns) -> Columns:
    """Return a table sorted by time; rows of one time stay in the order of the file."""
    times = table.time_ns
    return table if (np.diff(times) >= 0).all() else table.select(np.argsort(times, kind="stable"))


def _every_time(times: Mapping[str, Times], span: Span) -> Times:
    union = np.unique(np.concatenate(list(times.values())))
    return union[span.holds(union)]


def _steps(times: Mapping[str, Times], span: Span, step: int) -> Times:
    ends = [(int(at[0]), int(at[-1])) for at in times.values() if len(at)]
    if not ends and (span.start_ns < 0 or span.end_ns == FOREVER_NS):
        return np.empty(0, np.int64)
    start = min(first for first, _ in ends) if span.start_ns < 0 else span.start_ns
    # If an end is given, the last values are held until then.
    end = max(last for _, last in ends) + 1 if span.end_ns == FOREVER_NS else span.end_ns
    if (end - start) / step > MAX_ROWS:
        makes = f"makes {(end - start) // step} rows, more than {MAX_ROWS}; give a larger one"
        raise BadInput(f"--every / every_s {step / NS:g} {makes}")
    return np.arange(start, end, step, dtype=np.int64)


def _series(name: str, values: npt.NDArray[Any], decoder: TopicDecoder, field: str, *, labels: bool) -> pl.Series:
    table = decoder.labels.get(field)
    if not labels or table is None:
        return pl.Series(name, values.astype(decoder.dtypes[field]))
    numbers, index = np.unique(values, return_inverse=True)
    # A value without a name in the table is given as its number.
    texts = [table.get(int(number), str(int(number))) for number in numbers]
    known = dict.fromkeys([*table.values(), *texts])
    return pl.Series(name, np.array(texts, object)[index].tolist(), dtype=pl.Enum(list(known)))
