"""Exports signals as a table, CSV or Parquet, one time slice after the other."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

import polars as pl
from polars.io.plugins import register_io_source

from bench.errors import BadInput, BenchError
from bench.files import check_new, written_aside
from bench.mcap.time_span import NS, Span
from bench.record.catalogue import Place
from bench.record.joining import joined, step_ns
from bench.record.reader import Run
from bench.record.topic_reader import TopicReader

SLICE_NS = 10 * NS
"""Length of a time slice: 1,000 rows of a run's log."""

MOST_SLICES = 1_000_000
"""Maximum number of slices of a table: four months. Damaged logs may have any times."""

GROUP_VALUES = 2_000_000
"""Number of values in a row group of a Parquet file, held in memory until written."""


class TableFormat(StrEnum):
    """A format of tables."""

    CSV = "csv"
    PARQUET = "parquet"

    @property
    def suffix(self) -> str:
        """Suffixes of its files."""
        return f".{self.value}"


@dataclass(frozen=True)
class ExportedTable:
    """The result of an export: number of rows, and of columns besides the time."""

    rows: int
    columns: int


def export_table(
    log: Path,
    target: Path,
    kind: TableFormat,
    patterns: Sequence[str] = ("*",),
    *,
    start_s: float | None = None,
    end_s: float | None = None,
    every_s: float | None = None,
    labels: bool = False,
) -> ExportedTable:
    """Write signals, joined on one time base as by `Run.table`, to the new file `target`, in bounded memory.

    The first column is the time `t` in s. In CSV the units follow the names; in Parquet they are the metadata
    `units`, JSON of name -> unit.

    Args:
        log: the log.
        target: the file.
        kind: its format.
        patterns: the signals, as in `Run.names`.
        start_s: only data of this time or later.
        end_s: only data of an earlier time.
        every_s: the step of the time base; if not given, all times of the signals.
        labels: signals with a value table as text.

    Raises:
        BadInput: the log cannot be read, has no such signal or no data in that time, or the file cannot be written.
    """
    check_new(target, kind.suffix)
    run = Run(log)
    places = run.catalogue.chosen(patterns)
    slices = _Slices(run.log, places, Span.of(start_s, end_s), every_s, labels=labels)
    units = {name: run.unit(name) for name in places}
    with written_aside(target, new=True) as path, path.open("wb") as stream:
        # Given the path, polars may open it again after an error, when it has already been removed.
        table = register_io_source(slices.read, schema=slices.schema)
        try:
            if kind is TableFormat.CSV:
                titles = {name: f"{name} [{unit}]" for name, unit in units.items() if unit}
                table.rename({"t": "t [s]", **titles}).sink_csv(stream)
            else:
                metadata = {"units": json.dumps({"t": "s", **units})}
                table.sink_parquet(stream, metadata=metadata, row_group_size=max(1, GROUP_VALUES // len(units)))
        except pl.exceptions.PolarsError as error:
            # polars turns errors raised in `slices.read` into its own.
            raise slices.error or BadInput(f"cannot write {target}: {error}") from error
        if not slices.rows:
            raise BadInput(f"{log} has no values of these signals in that time: there is nothing to export")
    return ExportedTable(slices.rows, len(places))


class _Slices:
    """The joined signals, slice by slice.

    Attributes:
        schema: column -> type.
        rows: number of rows read.
        error: the error in reading, None if none.
    """

    def __init__(
        self, log: TopicReader, places: Mapping[str, Place], span: Span, every_s: float | None, *, labels: bool
    ) -> None:
        self._log, self._places, self._every_s, self._labels = log, places, every_s, labels
        self._step = None if every_s is None else step_ns(every_s)
        self._topics = list(dict.fromkeys(place.topic for place in places.values()))
        spans = [found for found in (log.span(topic) for topic in self._topics) if found]
        first = min((found.start_ns for found in spans), default=0)
        last = max((found.end_ns for found in spans), default=0)
        self._span = Span(first if span.start_ns < 0 else span.start_ns, min(last, span.end_ns))
        if (self._span.end_ns - self._span.start_ns) // SLICE_NS > MOST_SLICES:
            times = f"from {self._span.start_ns / NS:g} s to {self._span.end_ns / NS:g} s"
            raise BadInput(f"{log.path} has times {times}, too far apart for one table; give the times to export")
        self.schema = self._slice(Span(0, 0)).schema
        self.rows = 0
        self.error: BenchError | None = None

    def read(
        self, columns: list[str] | None, predicate: pl.Expr | None, limit: int | None, _batch: int | None
    ) -> Iterator[pl.DataFrame]:
        """Yield the slices as polars requests them."""
        try:
            for span in self._spans():
                table = self._slice(span)
                self.rows += len(table)
                table = table if columns is None else table.select(columns)
                table = table if predicate is None else table.filter(predicate)
                yield table if limit is None else table.head(limit)
        except BenchError as error:
            self.error = error
            raise

    def _spans(self) -> Iterator[Span]:
        length = SLICE_NS if self._step is None else max(1, SLICE_NS // self._step) * self._step
        for start in range(self._span.start_ns, self._span.end_ns, length):
            span = Span(start, min(start + length, self._span.end_ns))
            # Logs of other tools may have long gaps.
            if self._step is not None or self._log.may_have(self._topics, span):
                yield span

    def _slice(self, span: Span) -> pl.DataFrame:
        table = joined(self._log, self._places, span, self._every_s, labels=self._labels)
        # Each slice would have a different Enum if a value is in no table.
        return table.cast({pl.Enum: pl.String}) if self._labels else table
