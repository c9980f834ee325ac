"""Campaigns that choose their runs, as a user calls them: the search with its counterexample, and rare failures."""

import json
import re

import polars as pl
import pytest

from bench.analysis.metrics import compute
from bench.campaign.requirements import flat_metrics
from bench.record import Run
from bench.record.compare import diff
from bench.scenario import load
from tests.campaign.commands import PLATOON, logs, parts, write_study

METRIC = "final_speed_error_mps"
INPUTS = [
    {"key": "vehicles.0.speed_mps", "distribution": {"kind": "uniform", "low": 19.0, "high": 24.0}},
    {"key": "vehicles.0.y_m", "distribution": {"kind": "uniform", "low": -0.2, "high": 0.2}},
    {"key": "road.lambda_f", "distribution": {"kind": "uniform", "low": -1.0, "high": 1.0}},
]


def seek(begin, *words):
    command = begin([*PLATOON, "campaign", "study.toml", "--workers", "2", "--out", "out", *words])
    assert command.code() == 0, command.said
    return command


def test_a_search_ends_with_a_small_counterexample_that_fails_by_itself_with_the_same_bytes(tmp_path, begin):
    write_study(tmp_path, [], inputs=INPUTS, sampling="monte-carlo", ecus={})
    out = tmp_path / "out"
    command = seek(begin, "--search", METRIC, "--runs", "21")
    assert f"{METRIC} < 3 is missed" in command.out
    found = json.loads((out / "found.json").read_text(encoding="utf-8"))
    assert (found["search"], found["worst"]["evaluations"]) == (f"{METRIC} < 3", 21)

    # The platoon drives 20 m/s: only the speed matters, and only as far as it is 3 m/s too much.
    base, small = load(tmp_path / "base.toml"), load(out / "counterexample.toml")
    (change,) = found["small"]["changes"]
    assert change["key"] == "vehicles.0.speed_mps"
    assert change["base"] == base.vehicles[0].speed_mps
    assert 23.0 < change["value"] < found["worst"]["values"]["vehicles.0.speed_mps"] + 1e-9
    assert change["value"] < 23.6
    first = base.vehicles[0].model_copy(update={"speed_mps": change["value"]})
    assert small == base.model_copy(update={"vehicles": (first, *base.vehicles[1:])})

    again = begin([*PLATOON, "run", "out/counterexample.toml", "--can", "direct", "--out", "again.mcap", "--no-report"])
    assert again.code() == 1, again.said  # 0.3 s form no platoon
    assert flat_metrics(compute(Run(tmp_path / "again.mcap")), small)[METRIC] >= 3.0
    number = found["small"]["outcome"]["number"]
    assert number in logs(out)
    assert diff(out / f"logs/run-{number:06d}.mcap", tmp_path / "again.mcap").same

    # What is there is not made again.
    rows = parts(out)
    assert rows["key"].n_unique() == rows.height
    assert seek(begin, "--search", METRIC, "--runs", "21", "--resume").out == command.out
    assert parts(out).equals(rows)
    shown = begin([*PLATOON, "campaign", "show", "out"])
    assert shown.code() == 0, shown.said
    assert "chosen by the search for the least margin" in shown.out
    assert "probability" not in shown.out.replace("is no probability", "")
    other = begin([*PLATOON, "campaign", "study.toml", "--out", "out", "--resume"])
    assert other.code() == 2
    assert "were chosen by the search" in other.said


def test_a_search_that_finds_no_failure_says_so(tmp_path, begin):
    write_study(tmp_path, [], inputs=INPUTS, requirements=[f"{METRIC} < 9"], sampling="monte-carlo", ecus={})
    command = seek(begin, "--search", METRIC, "--runs", "8")
    assert f"{METRIC} < 9 is met" in command.out
    assert (tmp_path / "out" / "worst.toml").is_file()
    assert not (tmp_path / "out" / "counterexample.toml").exists()


def test_a_small_probability_is_estimated(tmp_path, begin):
    write_study(tmp_path, [], inputs=INPUTS[:1], requirements=[f"{METRIC} < 3.4"], sampling="monte-carlo", ecus={})
    command = seek(begin, "--rare", METRIC, "--runs", "100")
    # In 0.3 s the speed falls by half a metre per second at most: it is too high from 23.4 to 23.9 m/s on, of 19 to 24.
    told = re.search(r"Probability of missing \S+ < 3\.4: (\S+), coefficient of variation (\S+)\.", command.out)
    probability, variation = float(told[1]), float(told[2])
    rows = pl.read_parquet(tmp_path / "out" / "runs.parquet")
    failing = rows.filter(pl.col(f"metric.{METRIC}") >= 3.4)["in.vehicles.0.speed_mps"]
    exact = (24.0 - failing.min()) / 5.0
    assert 0.02 <= exact <= 0.12
    assert abs(probability - exact) <= 3.0 * variation * probability
    # The first level is drawn at random, what follows is nearer to the failures.
    assert rows.height > 100
    first, later = (
        rows.filter(there)["in.vehicles.0.speed_mps"] for there in (pl.col("number") < 100, pl.col("number") >= 100)
    )
    assert later.median() > first.median() + 0.5


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--search", "frames_lost"], 'frames_lost has only "frames_lost == 0"'),
        (["--search", "final_sped_error_mps"], f"did you mean {METRIC}?"),
        (["--rare", METRIC, "--search", METRIC], "give one of them"),
        (["--rare", METRIC, "--runs", "10"], "10 samples of a level are not enough; allowed: at least 100"),
        (["--search", METRIC, "--runs", "0"], "--runs 0 is not allowed"),
    ],
)
def test_what_cannot_be_sought_is_refused_before_anything_starts(words, message, tmp_path, begin):
    write_study(tmp_path, [1, 2])
    command = begin([*PLATOON, "campaign", "study.toml", "--out", "out", *words])
    assert command.code() == 2
    assert message in command.said
    assert command.said.count("\n") <= 2
    assert not (tmp_path / "out").exists()
