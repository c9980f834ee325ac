"""The results of a campaign, as its folder holds them."""

from __future__ import annotations

import re
import tomllib
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import polars as pl

from bench.campaign.statistics import Share, share_of
from bench.campaign.statuses import OK, REFUSED
from bench.errors import BadInput

INPUT, METRIC, REQUIREMENT = "in.", "metric.", "req."
AT_RANDOM = ("monte-carlo", "latin-hypercube", "sobol")
"""Samplings whose share of failures estimates a probability; the others are points chosen by the user."""
COMPLETED = "run completed"
ALL_MET = "completed and all requirements met"
WORST = 5
"""How many of the worst runs by each requirement are shown, and keep their log unless told otherwise."""
PURPOSE = "purpose.txt"
"""File with what chose the values of the runs, if that was not the study's sampling."""
MOST_CHOICES = 50
"""An input with more texts than this is no choice to tell runs apart by."""
MOST_TRIES = 5
"""Times that the parts of a campaign are listed and read."""

_REQUIREMENT = re.compile(r"(\w+)\s*(<=|>=|<|>|==|!=)\s*(\S+)")


@dataclass(frozen=True)
class Results:
    """The results of a campaign.

    Attributes:
        directory: its folder.
        text: the study as TOML.
        rows: how each run ended: `number`, `status` and `words`, in the order of the numbers.
        runs: the rows of the runs that were started, in the same order, with the columns of `bench.campaign.store`.
    """

    directory: Path
    text: str
    rows: pl.DataFrame
    runs: pl.DataFrame

    @cached_property
    def study(self) -> dict[str, object]:
        """The study's keys."""
        return tomllib.loads(self.text)

    @property
    def name(self) -> str:
        """The study's name."""
        return str(self.study.get("name") or self.directory.resolve().name)

    @property
    def sampling(self) -> str:
        """How the runs were drawn."""
        return purpose_of(self.directory) or str(self.study.get("sampling", AT_RANDOM[0]))

    @property
    def at_random(self) -> bool:
        """Whether the share of failures estimates a probability."""
        return self.sampling in AT_RANDOM

    @property
    def inputs(self) -> list[str]:
        """The names of the inputs, without prefix."""
        return self._names(INPUT)

    @property
    def metrics(self) -> list[str]:
        """The names of the metrics that at least one run has as a number, without prefix."""
        return [name for name in self._names(METRIC) if _is_number(self.runs[METRIC + name])]

    @property
    def requirements(self) -> list[str]:
        """The requirements as text, without prefix."""
        return self._names(REQUIREMENT)

    @cached_property
    def verdicts(self) -> dict[str, pl.Series]:
        """Of each run whether it failed, null if unknown: by the whole, then by each requirement."""
        each = {name: ~self.runs[REQUIREMENT + name].cast(pl.Boolean) for name in self.requirements}
        not_ended = self.runs["status"] != OK
        any_missed = not_ended
        for missed in each.values():
            any_missed = any_missed | missed.fill_null(value=False)
        return {COMPLETED: not_ended, ALL_MET: any_missed, **each}

    def shares(self) -> dict[str, Share]:
        """Return the share of runs that failed for each of the `verdicts`."""
        return {name: share_of(failed, random=self.at_random) for name, failed in self.verdicts.items()}

    def shares_by_choice(self) -> dict[str, dict[str, Share]]:
        """Return the share of runs that failed by each value of the inputs that are texts, the largest share first."""
        failed = self.verdicts[ALL_MET].alias("failed")
        found = {}
        for name in self.inputs:
            values = self.runs[INPUT + name]
            if values.dtype != pl.String or not 2 <= values.n_unique() <= MOST_CHOICES:
                continue
            groups = (
                pl.DataFrame([values.alias("value"), failed]).drop_nulls("value").group_by("value", maintain_order=True)
            )
            shares = {str(value): share_of(rows["failed"], random=self.at_random) for (value,), rows in groups}
            found[name] = dict(sorted(shares.items(), key=lambda item: (-item[1].failed / item[1].known, item[0])))
        return found

    def statuses(self) -> dict[str, int]:
        """Return the number of rows by status, the ended ones first."""
        counts = dict(self.rows["status"].value_counts(sort=True).iter_rows())
        return dict(sorted(counts.items(), key=lambda item: item[0] != OK))

    def worst(self, requirement: str, most: int = WORST) -> pl.DataFrame:
        """Return the rows of the runs that are worst by the metric of a requirement, the worst first.

        Of a requirement of equality these are runs that missed it. A run that missed a requirement without having its
        metric, such as a formation time without a formation, is worse than any.
        """
        limit = limit_of(requirement)
        if limit is None or METRIC + limit.metric not in self.runs.columns:
            return self.runs.head(0)
        column, missed = pl.col(METRIC + limit.metric).cast(pl.Float64), ~pl.col(REQUIREMENT + requirement)
        if limit.side == 0:
            return self.runs.filter(missed).head(most)
        # Infinitely far on the wrong side; NaN too.
        goodness = pl.when(column.is_null() | column.is_nan()).then(-float("inf")).otherwise(limit.side * column)
        # Found among two columns: to sort the whole table takes long.
        rows = self.runs.select(pl.row_index(), goodness=goodness, known=column.is_finite() | missed).filter("known")
        worst = rows.bottom_k(most, by=["goodness", "index"]).sort("goodness", "index")
        return self.runs[worst["index"]]

    def troubles(self) -> pl.DataFrame:
        """Return what was said of rows without an ended run: status, words, how many and the first's number."""
        others = self.rows.filter(pl.col("status") != OK)
        groups = others.group_by("status", pl.col("words").fill_null(""), maintain_order=True)
        return groups.agg(pl.len().alias("rows"), pl.col("number").min()).sort("rows", descending=True)

    def report_of(self, log: str | None) -> Path | None:
        """Return the report beside a run's log, if there is one."""
        path = self.log_of(log)
        report = None if path is None else path.with_suffix(".html")
        return report if report is not None and report.is_file() else None

    def log_of(self, log: str | None) -> Path | None:
        """Return a run's log if it was kept; relative names are within the folder."""
        path = self.directory / log if log else None
        return path if path is not None and path.is_file() else None

    def _names(self, prefix: str) -> list[str]:
        return [name.removeprefix(prefix) for name in self.runs.columns if name.startswith(prefix)]


@dataclass(frozen=True)
class Limit:
    """A requirement: the metric, its limit, and on which side it is to stay: 1 above, -1 below, 0 neither."""

    metric: str
    value: float
    side: int


def limit_of(requirement: str) -> Limit | None:
    """Return what a requirement's text says; None if that is not a metric, a comparison and a number."""
    found = _REQUIREMENT.fullmatch(requirement.strip())
    if found is None:
        return None
    metric, comparison, text = found.groups()
    try:
        value = {"true": 1.0, "false": 0.0}.get(text.lower()) or float(text)
    except ValueError:
        return None
    return Limit(metric, value, {">": 1, "<": -1}.get(comparison[0], 0))


def purpose_of(directory: Path) -> str:
    """Return what chose the values of a campaign's runs; empty if that was the study's sampling."""
    file = directory / PURPOSE
    return file.read_text(encoding="utf-8").strip() if file.is_file() else ""


def read(directory: Path) -> Results:
    """Read the results of a campaign.

    Raises:
        BadInput: the folder is none of a campaign, there are no results yet, or they cannot be read.
    """
    study = directory / "study.toml"
    if not study.is_file():
        raise BadInput(f"{directory} has no study.toml: give the folder of a campaign, see platoon campaign --out")
    try:
        found = _rows(directory)
        rows = found.select("number", "status", "words").collect()
        # From the file: a filter of the table in memory would make another one.
        runs = found.filter(pl.col("status") != REFUSED).collect()
    except (pl.exceptions.PolarsError, OSError) as error:
        raise BadInput(f"cannot read the results in {directory}: {error}") from error
    if rows.is_empty():
        raise BadInput(f"{directory} has no results yet; go on with: platoon campaign {study} --resume")
    return Results(directory, study.read_text(encoding="utf-8"), rows, runs)


def _rows(directory: Path) -> pl.LazyFrame:
    """Return the rows in the order of their numbers: of the whole table or, until there is one, of its parts."""
    whole = directory / "runs.parquet"
    if whole.is_file():
        return pl.scan_parquet(whole)
    for _ in range(MOST_TRIES):
        # The campaign may go on meanwhile, and put one part in the place of several.
        with suppress(FileNotFoundError):
            return _of_parts(directory / "parts").lazy()
    raise BadInput(f"cannot read the results in {directory}: its parts vanish while they are read; try again")


def _of_parts(folder: Path) -> pl.DataFrame:
    """Return the rows in a campaign's parts, each once; not those of a part that is being written.

    Raises:
        FileNotFoundError: a part is there no more.
    """
    paths = sorted(path for path in folder.glob("*.parquet") if not path.name.startswith("."))
    if not paths:
        return pl.DataFrame(schema={"number": pl.Int64, "status": pl.String, "words": pl.String})
    return pl.scan_parquet(paths).unique("number", keep="first").sort("number").collect()


def _is_number(values: pl.Series) -> bool:
    return (values.dtype.is_numeric() or values.dtype == pl.Boolean) and values.null_count() < values.len()
