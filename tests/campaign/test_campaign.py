"""What becomes of a campaign's runs, made by real workers: every way to end is a row, and any row can be made again."""

import shutil
from contextlib import nullcontext

import polars as pl
import pytest
from distributed import LocalCluster
from polars.testing import assert_frame_equal

from bench.analysis.metrics import compute
from bench.campaign.campaign import Options, begun
from bench.campaign.cluster import Place
from bench.campaign.requirements import METRIC_NAMES, flat_metrics, metric_type
from bench.campaign.sampling import samples
from bench.campaign.study import load_study
from bench.record import Run
from bench.record.compare import diff
from bench.record.reader import LogDamaged
from bench.scenario import load
from tests.campaign.commands import PLATOON, ROOT, logs, makings, write_study
from tests.campaign.steered import CRASHES, HANGS, RAISES

FMU = ROOT / "build" / "Vehicle.fmu"


@pytest.fixture(scope="module")
def place():
    """Two workers, which several campaigns use one after the other."""
    with LocalCluster(n_workers=2, threads_per_worker=1, host="127.0.0.1", dashboard_address="127.0.0.1:0") as cluster:
        yield Place(address=cluster.scheduler_address)


@pytest.fixture
def make(tmp_path, place):
    """`make(study, ...)` makes a campaign in the folder `out`, and returns its rows."""

    def made(study, **options):
        with begun(study, Options(tmp_path / "out", FMU, place, **options), study.runs) as campaign:
            campaign.run(samples(study))
        assert not list((tmp_path / "out").rglob(".*.part*"))
        return pl.read_parquet(tmp_path / "out" / "runs.parquet")

    return made


def by_seed(rows):
    return {row["in.seed"]: row for row in rows.iter_rows(named=True)}


@pytest.fixture(scope="module")
def troubled(tmp_path_factory, place):
    """The folder and rows by seed of a campaign in which several things go wrong."""
    folder = tmp_path_factory.mktemp("troubled")
    keys = [
        {"key": "seed", "distribution": {"kind": "choice", "values": [1, CRASHES, HANGS, RAISES, 2]}},
        {"key": "duration_s", "distribution": {"kind": "choice", "values": [0.3]}},
    ]
    study = load_study(write_study(folder, [], inputs=keys, time_limit_s=8.0))
    with begun(study, Options(folder / "out", FMU, place, worst=1), study.runs) as campaign:
        campaign.run(samples(study))
        assert (campaign.count.made, campaign.count.failures, campaign.count.total) == (5, 3, 5)
    return folder, by_seed(pl.read_parquet(folder / "out" / "runs.parquet"))


def test_every_way_to_end_is_a_row_with_its_words(troubled):
    _, rows = troubled
    assert {seed: (row["status"], row["tries"]) for seed, row in rows.items()} == {
        1: ("ok", 1),
        CRASHES: ("crashed", 2),
        HANGS: ("timeout", 2),
        RAISES: ("failed", 2),
        2: ("ok", 1),
    }
    assert rows[CRASHES]["words"].startswith("its process was killed by SIGSEGV; it said: Fatal Python error")
    assert rows[HANGS]["words"] == "took longer than 8 s and was ended"
    assert "veh1.tracker failed: ValueError: the third word" in rows[RAISES]["words"]
    assert rows[1]["words"] == ""


def test_a_run_without_an_end_is_tried_twice_and_no_other_is(troubled):
    folder, _ = troubled
    assert {seed: len(pids) for seed, pids in makings(folder).items()} == {1: 1, CRASHES: 2, HANGS: 2, RAISES: 2, 2: 1}


def test_metrics_and_requirements_are_those_of_the_run(troubled):
    folder, rows = troubled
    for seed in (1, 2):
        scenario = load(folder / "base.toml", [f"seed={seed}"])
        row = rows[seed]
        assert row["req.final_speed_error_mps < 3"] is (row["metric.final_speed_error_mps"] < 3)
        assert row["req.frames_lost == 0"] is True
        log = folder / "out" / "logs" / f"run-{row['number']:06d}.mcap"
        if row["log"]:
            metrics = flat_metrics(compute(Run(log)), scenario)
            assert {name: row[f"metric.{name}"] for name in METRIC_NAMES} == metrics
    assert sum(rows[seed]["log"] is not None for seed in (1, 2)) == 1
    for seed in (CRASHES, HANGS, RAISES):
        assert all(rows[seed][f"metric.{name}"] is None for name in METRIC_NAMES)
        assert rows[seed]["req.frames_lost == 0"] is None


def test_the_table_has_a_type_for_every_column(troubled):
    folder, rows = troubled
    types = pl.read_parquet(folder / "out" / "runs.parquet").schema
    of = {bool: pl.Boolean, int: pl.Int64, float: pl.Float64}
    assert {name: types[f"metric.{name}"] for name in METRIC_NAMES} == {
        name: of[metric_type(name)] for name in METRIC_NAMES
    }
    assert types["in.seed"] == pl.Int64
    assert types["in.duration_s"] == pl.Float64
    assert len({row["key"] for row in rows.values()}) == 5


@pytest.mark.parametrize("seed", [CRASHES, HANGS, RAISES])
def test_the_log_of_a_run_without_an_end_opens(seed, troubled):
    folder, rows = troubled
    log = folder / "out" / rows[seed]["log"]
    assert log.with_suffix(".toml").is_file()
    # A run that has failed has ended its log.
    ends = nullcontext() if seed == RAISES else pytest.warns(LogDamaged, match="it ends before its summary")
    with ends:
        assert Run(log).scenario.seed == seed


def test_refused_values_are_rows_and_no_runs(tmp_path, make):
    # Each by itself is a scenario; together, vehicles 1 and 2 start inside each other.
    keys = [
        {"key": "vehicles.1.x_m", "distribution": {"kind": "choice", "values": [0.0, 8.0]}},
        {"key": "vehicles.1.y_m", "distribution": {"kind": "choice", "values": [3.5, 0.0]}},
    ]
    rows = make(load_study(write_study(tmp_path, [], inputs=keys)))
    assert rows["status"].to_list() == ["ok", "ok", "ok", "refused"]
    refused = rows.row(3, named=True)
    assert "vehicles" in refused["words"]
    assert (refused["tries"], refused["log"]) == (1, None)
    assert len(makings(tmp_path)[1]) == 3


def test_runs_with_the_same_values_are_made_once_and_all_have_rows(tmp_path, make):
    keys = [{"key": "seed", "distribution": {"kind": "choice", "values": [7, 8]}}]
    study = load_study(write_study(tmp_path, [], inputs=keys, sampling="monte-carlo", runs=7))
    rows = make(study, worst=1)
    assert rows["number"].to_list() == list(range(7))
    assert {seed: len(pids) for seed, pids in makings(tmp_path).items()} == {7: 1, 8: 1}
    assert rows.drop("number").unique().height == 2
    kept = logs(tmp_path / "out")
    # A resume finds nothing to do, and takes the log of a run for that of no other.
    assert_frame_equal(make(study, worst=1, resume=True), rows)
    assert logs(tmp_path / "out") == kept
    assert sum(map(len, makings(tmp_path).values())) == 2


def test_logs_stay_of_failures_of_the_worst_and_of_those_asked_for(tmp_path, make):
    requirements = ["comfort_driven_energy_j < 80000", "final_speed_error_mps > 2.2"]
    seeds = [100, 900, 300, RAISES, 200, 400, 700]
    rows = make(load_study(write_study(tmp_path, seeds, requirements=requirements)), worst=2, asked={2, 40})
    missed = [rows.filter(~pl.col(f"req.{text}"))["number"].to_list() for text in requirements]
    assert missed == [[1], [0]]
    failed, worst_by_energy, worst_by_speed, asked = 3, {1, 6}, {0, 4}, 2
    kept = {failed, *worst_by_energy, *worst_by_speed, asked}
    assert logs(tmp_path / "out") == kept
    assert {row["number"] for row in rows.iter_rows(named=True) if row["log"]} == kept
    assert all(row["log"] in (None, f"logs/run-{row['number']:06d}.mcap") for row in rows.iter_rows(named=True))


def test_logs_asked_for_stay_when_a_campaign_goes_on_without_asking_again(tmp_path, make):
    study = load_study(write_study(tmp_path, [1, 2, 3, 4]))
    make(study, worst=0, asked={1, 3})
    assert logs(tmp_path / "out") == {1, 3}
    make(study, worst=0, resume=True)
    assert logs(tmp_path / "out") == {1, 3}


def test_a_longer_campaign_goes_on_with_the_shorter_one(tmp_path, make):
    def study(runs):
        keys = [{"key": "seed", "distribution": {"kind": "integers", "low": 1, "high": 900}}]
        return load_study(write_study(tmp_path, [], inputs=keys, sampling="monte-carlo", runs=runs))

    short = make(study(4))
    assert not make(study(4), resume=True).height - 4
    long = make(study(9), resume=True)
    assert_frame_equal(long.head(4).drop("log"), short.drop("log"))
    assert long["number"].to_list() == list(range(9))
    assert sum(map(len, makings(tmp_path).values())) == 9
    whole = tmp_path / "whole"
    shutil.move(tmp_path / "out", whole)
    (tmp_path / "makings").unlink()
    machines = ["tries", "wall_s", "worker"]
    assert_frame_equal(make(study(9)).drop(machines), long.drop(machines))
    assert logs(tmp_path / "out") == logs(whole)


@pytest.mark.parametrize("base", ["base.toml", "random"])
def test_any_run_can_be_made_again_to_the_same_bytes(base, tmp_path, make, begin):
    keys = [
        {"key": "duration_s", "distribution": {"kind": "choice", "values": [0.3]}},
        {"key": "road.lambda_f", "distribution": {"kind": "uniform", "low": -1.0, "high": 1.0}},
        {"key": "vehicles.0.speed_mps", "distribution": {"kind": "uniform", "low": 19.0, "high": 21.0}},
    ]
    keys = keys[: 2 if base == "random" else 3]
    study = write_study(tmp_path, [], base=base, inputs=keys, sampling="monte-carlo", runs=3, ecus={})
    rows = make(load_study(study), asked=None)
    assert rows["log"].null_count() == 0
    for row in rows.iter_rows(named=True):
        log, again = tmp_path / "out" / row["log"], tmp_path / f"again-{row['number']}.mcap"
        words = ["run", str(log.with_suffix(".toml")), "--can", "direct", "--no-report", "--out", str(again)]
        command = begin([*PLATOON, *words])
        assert command.code() in (0, 1), command.said
        found = diff(log, again)
        assert found.same, found
        assert Run(log).scenario.toml() == Run(again).scenario.toml() == log.with_suffix(".toml").read_text()
        assert flat_metrics(compute(Run(again)), Run(again).scenario) == {
            name: row[f"metric.{name}"] for name in METRIC_NAMES
        }
