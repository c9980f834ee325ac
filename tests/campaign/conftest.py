"""Campaigns of made-up runs: the columns of a real one, with answers that are known."""

import numpy as np
import polars as pl
import pytest

from bench.bus.link.address import Address
from bench.conductor.options import RunOptions
from bench.conductor.run import run
from bench.scenario import load
from tests.campaign.commands import commands

STUDY = """name = "made-up"
base = "formation"
seed = 1
runs = {runs}
sampling = "{sampling}"
"""
ABOVE, BELOW = "least_clearance_m > 1.0", "formation_time_s <= 6.5"


def made_up_rows(runs, *, seed=1):
    """Rows of runs: clearance falls with lambda_f, formation time rises with speed, wind does nothing."""
    random = np.random.default_rng(seed)
    lambda_f, speed, wind = random.random((3, runs))
    clearance = 2.0 - 1.01 * lambda_f + 0.02 * random.standard_normal(runs)
    formed = 5.0 + 1.4 * speed + 0.2 * lambda_f
    return pl.DataFrame(
        {
            "number": np.arange(runs),
            "key": [f"{number:016x}" for number in range(runs)],
            "status": ["ok"] * runs,
            "words": [""] * runs,
            "wall_s": 2.0 + random.random(runs),
            "worker": ["tcp://127.0.0.1:1"] * runs,
            "log": pl.Series([None] * runs, dtype=pl.String),
            "in.road.lambda_f": lambda_f,
            "in.vehicles.0.speed_mps": 20.0 + speed,
            "in.road.wind_mps": wind,
            "in.road.profile": random.choice(["sine", "step"], runs),
            "metric.least_clearance_m": clearance,
            "metric.formation_time_s": formed,
            "metric.frames_lost": np.zeros(runs, int),
            "metric.complete": [True] * runs,
            f"req.{ABOVE}": clearance > 1.0,
            f"req.{BELOW}": formed <= 6.5,
        }
    )


def with_trouble(rows, number, status, words):
    """The rows with one that did not reach its end: it has no metrics."""
    there = pl.col("number") == number
    empty = [name for name in rows.columns if name.startswith(("metric.", "req."))]
    return rows.with_columns(
        pl.when(there).then(pl.lit(status)).otherwise("status").alias("status"),
        pl.when(there).then(pl.lit(words)).otherwise("words").alias("words"),
        *(pl.when(~there).then(name).alias(name) for name in empty),
    )


def write_campaign(directory, rows, *, sampling="monte-carlo"):
    """Write a campaign's folder."""
    directory.mkdir(parents=True, exist_ok=True)
    (directory / "study.toml").write_text(STUDY.format(runs=rows.height, sampling=sampling), encoding="utf-8")
    rows.write_parquet(directory / "runs.parquet")
    return directory


@pytest.fixture(scope="session")
def real_log(once):
    """The log of a real run, the first second of the shipped scenario `formation`."""

    def make(folder):
        scenario, log = load("formation", ["duration_s=1.0"]), folder / "run.mcap"
        run(RunOptions(scenario, Address.parse("direct"), log, ["test"]))

    return once("campaign-run", make) / "run.mcap"


@pytest.fixture
def campaign_of(tmp_path):
    """`campaign_of(rows)`: the folder of a campaign with these rows."""
    return lambda rows, **options: write_campaign(tmp_path / "campaign", rows, **options)


@pytest.fixture
def begin(tmp_path):
    """`begin(words)` starts a command in the test's folder."""
    with commands(tmp_path) as start:
        yield start
