"""The results of a campaign as its folder holds them."""

import polars as pl
import pytest

from bench.campaign.results import ALL_MET, COMPLETED, Limit, limit_of, read
from bench.errors import BadInput

from .conftest import ABOVE, BELOW, made_up_rows, with_trouble, write_campaign


@pytest.mark.parametrize(
    ("text", "limit"),
    [
        ("least_clearance_m > 1.0", Limit("least_clearance_m", 1.0, 1)),
        ("least_clearance_m >= -1e-3", Limit("least_clearance_m", -1e-3, 1)),
        ("formation_time_s<=6.5", Limit("formation_time_s", 6.5, -1)),
        ("frames_lost == 0", Limit("frames_lost", 0.0, 0)),
        ("formed == true", Limit("formed", 1.0, 0)),
        ("it went well", None),
        ("a > b", None),
    ],
)
def test_a_requirement_says_its_metric_limit_and_side(text, limit):
    assert limit_of(text) == limit


def test_a_run_fails_if_it_does_not_end_or_misses_anything(campaign_of):
    rows = with_trouble(made_up_rows(200), 3, "crashed", "signal 11")
    results = read(campaign_of(rows))
    shares = results.shares()
    missed = rows.filter(~pl.col(f"req.{ABOVE}") | ~pl.col(f"req.{BELOW}")).height
    assert (shares[COMPLETED].failed, shares[COMPLETED].known) == (1, 200)
    assert (shares[ALL_MET].failed, shares[ALL_MET].known) == (missed + 1, 200)
    # Its metrics are not known.
    assert shares[ABOVE].known == shares[BELOW].known == 199


def test_refused_values_are_no_runs(campaign_of):
    results = read(campaign_of(with_trouble(made_up_rows(50), 3, "refused", "mu is too large")))
    assert results.shares()[COMPLETED].known == 49
    assert results.statuses() == {"ok": 49, "refused": 1}
    assert results.troubles().rows() == [("refused", "mu is too large", 1, 3)]


def test_the_worst_runs_are_those_farthest_on_the_wrong_side(campaign_of):
    rows = made_up_rows(100)
    results = read(campaign_of(rows))
    low, high = results.worst(ABOVE), results.worst(BELOW)
    assert low["metric.least_clearance_m"].to_list() == sorted(rows["metric.least_clearance_m"])[:5]
    assert high["metric.formation_time_s"].to_list() == sorted(rows["metric.formation_time_s"], reverse=True)[:5]


def test_the_worst_by_an_equality_are_those_that_missed_it(campaign_of):
    lost = [0] * 97 + [2, 0, 9]
    rows = made_up_rows(100).with_columns(
        pl.Series("metric.frames_lost", lost), pl.Series("req.frames_lost == 0", [count == 0 for count in lost])
    )
    assert read(campaign_of(rows)).worst("frames_lost == 0")["number"].to_list() == [97, 99]


@pytest.mark.parametrize("nothing", [None, float("nan")])
def test_a_run_that_missed_a_requirement_without_a_value_is_the_worst(campaign_of, nothing):
    rows = made_up_rows(100)
    formed = rows["metric.formation_time_s"].to_list()
    formed[40] = nothing
    met = [False if number == 40 else value <= 6.5 for number, value in enumerate(formed)]
    rows = rows.with_columns(pl.Series("metric.formation_time_s", formed), pl.Series(f"req.{BELOW}", met))
    numbers = read(campaign_of(rows)).worst(BELOW)["number"].to_list()
    assert numbers[0] == 40
    assert numbers[1] == max((value, number) for number, value in enumerate(formed) if number != 40)[1]


@pytest.fixture
def unfinished(tmp_path):
    """The folder of a campaign that has no whole table yet, and 30 runs in two parts, the last of them in both."""
    directory = write_campaign(tmp_path / "campaign", made_up_rows(30))
    rows = pl.read_parquet(directory / "runs.parquet").reverse()
    (directory / "runs.parquet").unlink()
    (directory / "parts").mkdir()
    for name, part in (("0-00000000", rows.tail(20)), ("0-00000001", rows.head(11))):
        part.write_parquet(directory / "parts" / f"{name}.parquet")
    return directory


def test_the_parts_of_a_campaign_that_goes_on_are_its_results(unfinished):
    # A part that is being written.
    (unfinished / "parts" / ".0-00000002.1.part.parquet").write_bytes(b"PAR1")
    results = read(unfinished)
    assert results.runs["number"].to_list() == results.rows["number"].to_list() == list(range(30))
    assert results.runs.equals(made_up_rows(30))


@pytest.mark.parametrize(("damage", "words"), [("gone", "vanish while they are read; try again"), ("cut", "")])
def test_a_part_that_cannot_be_read_is_told(unfinished, damage, words):
    part = unfinished / "parts" / "0-00000001.parquet"
    if damage == "gone":
        part.unlink()
        part.symlink_to("nowhere")
    else:
        part.write_bytes(part.read_bytes()[:-100])
    with pytest.raises(BadInput, match=f"cannot read the results in .*{words}"):
        read(unfinished)


@pytest.mark.parametrize("sampling", ["grid", "corners"])
def test_chosen_points_have_no_bounds(campaign_of, sampling):
    shares = read(campaign_of(made_up_rows(20), sampling=sampling)).shares()
    assert {share.bounds for share in shares.values()} == {"–"}


def test_a_folder_without_a_campaign_is_refused(tmp_path):
    with pytest.raises(BadInput, match=r"no study\.toml"):
        read(tmp_path)


def test_a_campaign_without_results_is_refused(campaign_of):
    with pytest.raises(BadInput, match="no results yet"):
        read(campaign_of(made_up_rows(0)))


def test_failures_are_counted_by_each_value_of_an_input_that_is_a_text(campaign_of):
    rows = made_up_rows(200)
    shares = read(campaign_of(rows)).shares_by_choice()
    assert set(shares) == {"road.profile"}
    met = pl.col(f"req.{ABOVE}") & pl.col(f"req.{BELOW}")
    for value, share in shares["road.profile"].items():
        of_it = rows.filter(pl.col("in.road.profile") == value)
        assert (share.failed, share.known) == (of_it.filter(~met).height, of_it.height)
    assert sum(share.known for share in shares["road.profile"].values()) == 200
