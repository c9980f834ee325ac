"""What a campaign says, and how the terminal shows it."""

import polars as pl
import pytest

from bench.campaign.results import read
from bench.campaign.summary import number, summary
from bench.cli.campaign_summary import show

from .conftest import ABOVE, BELOW, made_up_rows, with_trouble


def good(rows):
    return rows.with_columns(pl.lit(value=True).alias(f"req.{name}") for name in (ABOVE, BELOW))


def test_no_failure_of_n_is_told_as_an_upper_bound(campaign_of):
    told = summary(read(campaign_of(good(made_up_rows(1000)))))
    assert told.verdicts == [
        {"text": "0 of 1000 runs failed; probability of failure at most 0.37 %, with 95 % confidence.", "good": True}
    ]
    assert {tuple(row[1:]) for row in told.shares} == {("0", "1000", "0 %", "at most 0.37 %")}


def test_points_that_were_chosen_have_no_probability(campaign_of):
    told = summary(read(campaign_of(made_up_rows(100), sampling="grid")))
    assert "probability" not in told.verdicts[0]["text"]
    assert any("no probability" in note for note in told.notes)


@pytest.mark.parametrize(("sampling", "warned"), [("monte-carlo", False), ("sobol", True), ("latin-hypercube", True)])
def test_runs_that_are_not_independent_are_told_of(campaign_of, sampling, warned):
    notes = summary(read(campaign_of(made_up_rows(20), sampling=sampling))).notes
    assert any("not independent" in note for note in notes) is warned


def test_the_log_and_the_report_of_a_worst_run_are_told_if_they_exist(campaign_of):
    rows = made_up_rows(50)
    first, second = rows.sort("metric.least_clearance_m")["number"].to_list()[:2]
    logs = {first: "logs/a.mcap", second: "logs/gone.mcap"}
    directory = campaign_of(rows.with_columns(pl.Series("log", [logs.get(n) for n in range(50)], dtype=pl.String)))
    (directory / "logs").mkdir()
    for name in ("a.mcap", "a.html"):
        (directory / "logs" / name).touch()
    worst = summary(read(directory)).worst[0]
    assert (worst.requirement, worst.metric) == (ABOVE, "least_clearance_m")
    assert [run.number for run in worst.runs[:2]] == [first, second]
    assert (worst.runs[0].log, worst.runs[0].report) == (directory / "logs/a.mcap", directory / "logs/a.html")
    assert (worst.runs[1].log, worst.runs[1].report) == (None, None)


@pytest.mark.parametrize(
    ("value", "text"),
    [(None, "–"), (True, "yes"), (3, "3"), (3.0, "3"), (0.12345678, "0.1235"), (float("nan"), "nan"), (1e12, "1e+12")],
)
def test_numbers_have_four_digits(value, text):
    assert number(value) == text


@pytest.mark.parametrize("metrics", [True, False])
def test_the_terminal_shows_all_of_it_and_the_metrics_if_asked(campaign_of, capsys, monkeypatch, metrics):
    monkeypatch.setenv("COLUMNS", "160")
    rows = with_trouble(made_up_rows(500), 7, "hung", "it took longer than 60 s")
    directory = campaign_of(rows)
    show(directory, metrics=metrics)
    told, text = summary(read(directory)), capsys.readouterr().out

    def shown(row):
        return any(all(cell in line for cell in row) for line in text.splitlines())

    assert told.headline in text
    assert len(told.worst) == 2
    worst = [[group.requirement, group.runs[0].value, *(str(run.number) for run in group.runs)] for group in told.worst]
    for row in (*told.shares, *told.troubles, *worst):
        assert shown(row), row
    assert {shown(row) for row in told.quantiles} == {metrics}


def test_the_worst_runs_with_a_log_are_marked(campaign_of, capsys):
    rows = made_up_rows(50)
    number = rows.sort("metric.least_clearance_m")["number"][1]
    log = pl.when(pl.col("number") == number).then(pl.lit("logs/a.mcap")).alias("log")
    directory = campaign_of(rows.with_columns(log))
    (directory / "logs").mkdir()
    (directory / "logs/a.mcap").touch()
    show(directory)
    text = capsys.readouterr().out
    assert f" {number}*," in text
    # Two requirements, and the line that says what the mark is.
    assert text.count("*") == 1 + sum(number in read(directory).worst(each)["number"] for each in (ABOVE, BELOW))


@pytest.mark.parametrize("status", ["refused", "crashed"])
def test_a_campaign_without_any_metric_is_shown(campaign_of, capsys, status):
    show(campaign_of(with_trouble(made_up_rows(1), 0, status, "it went wrong")))
    text = capsys.readouterr().out
    assert f"1 runs of formation, monte-carlo sampling: 1 {status}" in text
    assert "it went wrong" in text


def test_words_of_a_run_do_not_control_the_terminal(campaign_of, capsys):
    show(campaign_of(with_trouble(made_up_rows(20), 7, "failed", "\x1b[2Jgone")))
    text = capsys.readouterr().out
    assert "\x1b" not in text
    assert r"\x1b[2Jgone" in text
