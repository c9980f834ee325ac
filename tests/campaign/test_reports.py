"""The reports of a campaign's worst runs, from real logs."""

import shutil

import polars as pl
import pytest

from bench.campaign.reports import write_reports
from bench.campaign.results import read

from .conftest import ABOVE, BELOW, made_up_rows


@pytest.fixture
def campaign(campaign_of, real_log):
    """`campaign(numbers)`: the folder of a campaign of 50 runs, with logs of these."""

    def made(numbers, rows=None):
        rows = made_up_rows(50) if rows is None else rows
        log = pl.when(pl.col("number").is_in(numbers)).then(pl.format("logs/run-{}.mcap", "number"))
        directory = campaign_of(rows.with_columns(log.alias("log")))
        (directory / "logs").mkdir()
        for number in numbers:
            shutil.copy(real_log, directory / "logs" / f"run-{number}.mcap")
        return directory

    return made


def worst(requirement, rows=None):
    """The numbers of the five worst runs, the worst first."""
    rows = made_up_rows(50) if rows is None else rows
    by, falling = {ABOVE: ("metric.least_clearance_m", False), BELOW: ("metric.formation_time_s", True)}[requirement]
    return rows.sort(by, descending=falling)["number"].to_list()[:5]


def test_the_worst_runs_of_every_requirement_get_the_report_of_their_log(campaign):
    numbers = [worst(ABOVE)[0], worst(BELOW)[1]]
    directory = campaign(numbers)
    reports = write_reports(read(directory))
    assert reports == [directory / "logs" / f"run-{number}.html" for number in numbers]
    for report in reports:
        assert "<title>platoon: formation</title>" in report.read_text(encoding="utf-8")
    for requirement, number in zip((ABOVE, BELOW), numbers, strict=True):
        rows = read(directory).worst(requirement).filter(number=number)
        assert read(directory).report_of(rows["log"].item()) in reports


def test_other_runs_with_a_log_get_none(campaign):
    best = next(number for number in range(50) if number not in {*worst(ABOVE), *worst(BELOW)})
    directory = campaign([best])
    assert write_reports(read(directory)) == []
    assert list(directory.glob("logs/*.html")) == []


def test_a_run_that_is_worst_twice_has_one_report(campaign):
    rows = made_up_rows(50).with_columns(pl.Series("metric.formation_time_s", [9.0] + [5.0] * 49))
    rows = rows.with_columns(pl.Series("metric.least_clearance_m", [0.1] + [2.0] * 49))
    directory = campaign([0], rows)
    assert [path.name for path in write_reports(read(directory))] == ["run-0.html"]


def test_a_report_that_exists_stays(campaign):
    number = worst(ABOVE)[0]
    directory = campaign([number])
    report = directory / "logs" / f"run-{number}.html"
    report.write_text("mine", encoding="utf-8")
    assert write_reports(read(directory)) == []
    assert report.read_text(encoding="utf-8") == "mine"


@pytest.mark.parametrize("damage", ["empty", "gone"])
def test_a_log_without_a_report_to_draw_does_not_keep_others_from_theirs(campaign, damage):
    first, second = worst(ABOVE)[:2]
    directory = campaign([first, second])
    log = directory / "logs" / f"run-{first}.mcap"
    if damage == "empty":
        log.write_bytes(b"")
    else:
        log.unlink()
    assert [path.name for path in write_reports(read(directory))] == [f"run-{second}.html"]


def test_a_report_that_cannot_be_written_is_left_out(campaign):
    first, second = worst(ABOVE)[:2]
    directory = campaign([first, second])
    # Permissions would not stop root.
    (directory / "logs" / f"run-{first}.html").mkdir()
    assert [path.name for path in write_reports(read(directory))] == [f"run-{second}.html"]
