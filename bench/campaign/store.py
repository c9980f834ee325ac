"""The folder of a campaign, written as runs end so that nothing is lost whatever is killed.

    study.toml       the study, complete in itself but for a base scenario's file
    code.txt         hash of the code that made the runs, and of the user's files that they depend on
    purpose.txt      what chose the values of the runs, if that was not the study's sampling
    keep.txt         numbers of the runs whose logs were asked for, or "all"; not there if none were
    parts/*.parquet  the rows of runs, in the order in which they ended; renamed into place, so whole or not there
    logs/            of the runs kept: run-000017.mcap, the scenario beside it as .toml, and later a report as .html
    runs.parquet     all rows in the order of their numbers, once the campaign is done

Parts are joined as they become many. A row that is in two parts, because a campaign was killed between writing the
joined part and removing those it was joined from, is the same in both.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import os
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

import polars as pl

from bench.campaign.distributions import Value
from bench.campaign.jobs import Made
from bench.campaign.requirements import METRIC_NAMES, metric_type
from bench.campaign.results import INPUT, METRIC, PURPOSE, REQUIREMENT, purpose_of, read
from bench.campaign.study import Study, load_study
from bench.campaign.version import code_version
from bench.errors import BadInput, RunFailed, shortage
from bench.files import write_text, written_aside
from bench.scenario import Scenario

MOST_PARTS = 64
"""Parts of one size that are joined into one of the next size."""
ROWS_AT_ONCE = 20_000
"""Rows of the final table that are in memory at once."""

_POLARS = {bool: pl.Boolean, int: pl.Int64, float: pl.Float64, str: pl.String}


def schema(study: Study) -> dict[str, Any]:
    """Return the columns of a campaign's rows with their types."""
    return {
        "number": pl.Int64,
        "key": pl.String,
        "status": pl.String,
        "words": pl.String,
        "tries": pl.Int64,
        "wall_s": pl.Float64,
        "worker": pl.String,
        "log": pl.String,
        **{INPUT + key: _POLARS[kind] for key, kind in (study.types() | study.shown_types()).items()},
        **{METRIC + name: _POLARS[metric_type(name)] for name in METRIC_NAMES},
        **{REQUIREMENT + each.text: pl.Boolean for each in study.requirements},
    }


def log_name(number: int) -> str:
    """Return the name of a run's log within the folder."""
    return f"logs/run-{number:06d}.mcap"


class Store:
    """The folder of a campaign, opened for writing by one process.

    Attributes:
        folder: the folder.
        study: the study.
    """

    def __init__(self, folder: Path, study: Study) -> None:
        """Take a folder that `opened` has prepared."""
        self.folder = folder
        self.study = study
        self._schema = schema(study)
        self._parts = folder / "parts"
        self._table = folder / "runs.parquet"
        self._base = hashlib.sha256(_identity(study).encode())
        # Of each size the parts, and the number of the next part.
        self._sizes: dict[int, list[Path]] = {}
        for path in sorted(self._parts.glob("*.parquet"), key=_order_of):
            self._sizes.setdefault(_size_of(path), []).append(path)
        self._next = 1 + max((_order_of(path) for each in self._sizes.values() for path in each), default=-1)

    def key(self, number: int, values: dict[str, Value]) -> str:
        """Return the key of a run: a hash of its scenario, seed included, and of the code.

        The scenario follows from the study's base and the values, which are hashed in its place.
        """
        digest = self._base.copy()
        digest.update(json.dumps([number if self.study.by_number else None, values], sort_keys=True).encode())
        return digest.hexdigest()[:16]

    def done(self) -> pl.DataFrame:
        """Return the rows there are, each once, in the order in which the runs ended."""
        return self._scan().unique("number", keep="first", maintain_order=True).collect()

    def add(self, rows: Sequence[dict[str, Any]]) -> None:
        """Write rows of runs; the table of all runs, if there is one, is none of all any more.

        Raises:
            RunFailed: they cannot be written.
        """
        self._table.unlink(missing_ok=True)
        self._write(0, pl.DataFrame(rows, self._schema, orient="row"))
        for size in sorted(self._sizes):
            if len(self._sizes[size]) >= MOST_PARTS:
                self._join(size)

    def row(self, made: Made, key: str, values: dict[str, Value]) -> dict[str, Any]:
        """Return the row of a run."""
        shown = values | self.study.shown(made.number, values)
        return {
            "number": made.number,
            "key": key,
            "status": made.status,
            "words": made.words,
            "tries": made.tries,
            "wall_s": made.wall_s,
            "worker": made.worker,
            "log": log_name(made.number) if made.log is not None else None,
            **{INPUT + name: _as(self._schema[INPUT + name], value) for name, value in shown.items()},
            **{METRIC + name: _as(self._schema[METRIC + name], made.metrics.get(name)) for name in METRIC_NAMES},
            **{REQUIREMENT + each.text: each.met(made.metrics) for each in self.study.requirements},
        }

    def keep(self, made: Made, values: dict[str, Value]) -> None:
        """Write the log of a run, and its scenario, with which `platoon run` makes the same run.

        Raises:
            RunFailed: they cannot be written.
        """
        if made.log is None:
            return
        log = self.folder / log_name(made.number)
        with _writing(log) as aside:
            aside.write_bytes(made.log)
        with _writing(log.with_suffix(".toml")) as aside:
            aside.write_text(self.study.scenario(made.number, values).toml(), encoding="utf-8")

    def drop(self, numbers: Iterable[int]) -> None:
        """Remove the logs of runs."""
        for number in numbers:
            log = self.folder / log_name(number)
            for path in (log, log.with_suffix(".toml"), log.with_suffix(".html")):
                path.unlink(missing_ok=True)

    def asked(self, now: Collection[int] | None) -> Collection[int] | None:
        """Return which runs' logs have been asked for, now or before the campaign was resumed; None for all.

        Raises:
            RunFailed: they cannot be written down.
        """
        file = self.folder / "keep.txt"
        before = file.read_text(encoding="utf-8").split() if file.is_file() else []
        found = None if now is None or "all" in before else {*now, *map(int, before)}
        if found is None or found:
            with _writing(file) as aside:
                aside.write_text(" ".join(["all"] if found is None else map(str, sorted(found))) + "\n")
        return found

    def drop_unknown_logs(self) -> None:
        """Remove logs of runs without a row: a campaign was killed after it had written the log."""
        known = set(self._scan().select("log").drop_nulls().collect()["log"])
        for log in (self.folder / "logs").glob("run-*.mcap"):
            if f"logs/{log.name}" not in known:
                self.drop([int(log.stem.removeprefix("run-"))])

    def finish(self) -> Path:
        """Write the table of all runs in the order of their numbers, and return it.

        Raises:
            RunFailed: it cannot be written.
        """
        numbers = self._scan().select("number").unique().sort("number").collect()["number"]
        with _writing(self._table) as aside:
            parts = [
                self._between(numbers[start], numbers[min(start + ROWS_AT_ONCE, len(numbers)) - 1])
                for start in range(0, len(numbers), ROWS_AT_ONCE)
            ]
            pl.concat(parts or [pl.LazyFrame(schema=self._schema)]).sink_parquet(aside)
        return self._table

    def _between(self, first: int, last: int) -> pl.LazyFrame:
        rows = self._scan().filter(pl.col("number").is_between(first, last))
        names = {f"logs/{path.name}" for path in (self.folder / "logs").glob("*.mcap")}
        kept = pl.when(pl.col("log").is_in(list(names))).then("log")
        return rows.unique("number", keep="first").sort("number").with_columns(kept.alias("log"))

    def _scan(self) -> pl.LazyFrame:
        paths = sorted((path for each in self._sizes.values() for path in each), key=_order_of)
        return pl.scan_parquet(paths) if paths else pl.LazyFrame(schema=self._schema)

    def _join(self, size: int) -> None:
        old = self._sizes[size]
        self._write(size + 1, pl.read_parquet(old).unique("number", keep="first", maintain_order=True))
        self._sizes[size] = []
        for path in old:
            path.unlink()

    def _write(self, size: int, rows: pl.DataFrame) -> None:
        part = self._parts / f"{size}-{self._next:08d}.parquet"
        content = BytesIO()
        rows.write_parquet(content)
        with _writing(part) as aside:
            # Of what goes wrong here Python says more than polars.
            aside.write_bytes(content.getbuffer())
        self._next += 1
        self._sizes.setdefault(size, []).append(part)


def scenario_of(folder: Path, number: int) -> Scenario:
    """Return the scenario of a run.

    Raises:
        BadInput: the folder is none of a campaign, or has no such run.
    """
    rows = read(folder).runs.filter(pl.col("number") == number)
    if rows.is_empty():
        raise BadInput(f"{folder} has no run {number}; allowed: the numbers in its runs.parquet")
    row = rows.row(0, named=True)
    study = load_study(folder / "study.toml")
    # A counterexample leaves keys to the base.
    values = {key: row[INPUT + key] for key in study.keys if row[INPUT + key] is not None}
    return study.scenario(number, values)


def check(folder: Path, study: Study, purpose: str = "", *, resume: bool) -> None:
    """Check that a folder can be opened for a study.

    Raises:
        BadInput: it exists and is not to be resumed, or is no campaign of this study and this code.
    """
    if resume:
        _check_same(folder, study, purpose)
    elif _is_campaign(folder):
        raise BadInput(f"{folder} already exists; go on with it by --resume, or give another --out")
    elif os.path.lexists(folder):
        raise BadInput(f"{folder} already exists, and is no campaign; give another --out, or remove it")


@contextmanager
def opened(folder: Path, study: Study, purpose: str = "", *, resume: bool) -> Iterator[Store]:
    """Open a campaign's folder; it is created unless the campaign is resumed.

    Raises:
        BadInput: see `check`; it cannot be created, or is in use.
    """
    check(folder, study, purpose, resume=resume)
    if not resume:
        _create(folder, study, purpose)
    with (folder / ".lock").open("w") as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise BadInput(f"{folder} is in use by another platoon campaign; wait for it, or end it") from None
        for path in (*folder.glob("parts/.*"), *folder.glob("logs/.*"), *folder.glob(".*.part.*")):
            # Left half written by a campaign that was killed.
            path.unlink()
        # The number of runs may be another one now.
        with _writing(folder / "study.toml") as aside:
            aside.write_text(study.text, encoding="utf-8")
        store = Store(folder, study)
        store.drop_unknown_logs()
        yield store


def _create(folder: Path, study: Study, purpose: str) -> None:
    try:
        folder.mkdir(parents=True)
        for name in ("parts", "logs"):
            (folder / name).mkdir()
        write_text(folder / "code.txt", _code_and_files(study))
        if purpose:
            write_text(folder / PURPOSE, purpose + "\n")
        # The last: what it is missing from is no campaign.
        write_text(folder / "study.toml", study.text)
    except FileExistsError as error:
        raise BadInput(f"{folder} already exists; give another --out") from error
    except OSError as error:
        raise BadInput(f"cannot create {folder}: {error.strerror}; give another --out") from error


def _is_campaign(folder: Path) -> bool:
    return (folder / "study.toml").is_file() and (folder / "code.txt").is_file()


def _check_same(folder: Path, study: Study, purpose: str) -> None:
    if not _is_campaign(folder):
        raise BadInput(f"--resume: {folder} is no campaign; start it without --resume, or give its folder by --out")
    code, _, files = (folder / "code.txt").read_text(encoding="utf-8", errors="replace").partition("\n")
    if code != code_version():
        raise BadInput(
            f"--resume: the runs in {folder} were made by other code ({code}) than this ({code_version()}), so theirs"
            " and new ones would not belong together; start a new campaign with another --out"
        )
    has = purpose_of(folder)
    if has != purpose:
        sampled = "the study's sampling"
        raise BadInput(
            f"--resume: the runs in {folder} were chosen by {has or sampled}, not by {purpose or sampled}; allowed: the"
            " same; give another --out"
        )
    if not study.continues((folder / "study.toml").read_text(encoding="utf-8", errors="replace")):
        raise BadInput(
            f"--resume: {folder} holds another study than {study.name} is now; allowed: the same study, of which only"
            f" name, description, time_limit_s and, unless sampling prevents it, runs may differ; resume"
            f" {folder / 'study.toml'}, or give another --out"
        )
    _check_files(folder, study, files.splitlines())


def _check_files(folder: Path, study: Study, before: Sequence[str]) -> None:
    """Refuse a base scenario or ECU that has been edited since."""
    now = _code_and_files(study).splitlines()[1:]
    changed = sorted(line.partition("  ")[2] for line in set(now) ^ set(before))
    if changed:
        raise BadInput(
            f"--resume: {changed[0]} has changed since the runs in {folder} were made, so theirs and new ones would not"
            " belong together; restore it, or start a new campaign with another --out"
        )


def _code_and_files(study: Study) -> str:
    """Return the hash of the code, and a line for each of the user's files with its hash and place."""
    files = sorted(study.files().items())
    lines = [f"{hashlib.sha256(content).hexdigest()}  {place}" for place, content in files]
    return "\n".join([code_version(), *lines, ""])


@contextmanager
def _writing(target: Path) -> Iterator[Path]:
    """As `written_aside`; the campaign has begun, so that a failure is no bad input."""
    try:
        with written_aside(target) as aside:
            yield aside
    except (BadInput, pl.exceptions.PolarsError) as error:
        cause = error.__cause__ or error
        raise RunFailed(f"{target} cannot be written: {shortage(cause) or cause}") from error


def _identity(study: Study) -> str:
    """Return what all runs of a study have in common, as text; files by their content, wherever they are."""
    files = study.files()
    places = {place: hashlib.sha256(content).hexdigest() for place, content in files.items()}
    common = study.with_files(places)
    return json.dumps([code_version(), common.base, sorted(common.ecus.items())])


def _size_of(part: Path) -> int:
    return int(part.stem.partition("-")[0])


def _order_of(part: Path) -> int:
    return int(part.stem.partition("-")[2])


def _as(column: Any, value: Any) -> Any:
    """Return a value as its column's type."""
    if value is None:
        return None
    return {pl.Float64: float, pl.Int64: int, pl.Boolean: bool, pl.String: str}[column](value)
