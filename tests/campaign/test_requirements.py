"""Requirements by their text, and the metrics of real runs as one number each."""

import dataclasses
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.analysis.metrics import compute
from bench.analysis.requirements import Group, table
from bench.bus.link.address import Address
from bench.campaign.requirements import METRIC_NAMES, Requirement, default_requirements, flat_metrics, requirement
from bench.conductor.options import RunOptions
from bench.conductor.run import run
from bench.errors import BadInput
from bench.record import Run
from bench.scenario import load


def test_a_text_is_a_requirement_whatever_its_spaces():
    expected = Requirement("least_clearance_m", ">", 1.0)
    assert requirement("least_clearance_m > 1.0") == requirement(" least_clearance_m>1 ") == expected
    assert requirement("formed == true") == Requirement("formed", "==", 1.0)
    assert requirement("boundary_margin_min>=-1e-3").limit == -0.001


@given(st.sampled_from(METRIC_NAMES), st.sampled_from([">", ">=", "<", "<=", "==", "!="]), st.integers(-(10**6), 10**6))
def test_a_requirement_is_read_back_from_its_text(metric, comparison, thousandths):
    one = Requirement(metric, comparison, thousandths / 1000.0)
    assert requirement(one.text) == one


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("formed", "write METRIC COMPARISON NUMBER"),
        ("formed = 1", "write METRIC COMPARISON NUMBER"),
        ("least_clearance_m > 1 m", "write METRIC COMPARISON NUMBER"),
        ("least_clearance_m > one", "one is not a finite number"),
        ("least_clearance_m > nan", "nan is not a finite number"),
        ("least_clearance_m > 1e999", "1e999 is not a finite number"),
        ("clearance > 1", "clearance is not a metric; did you mean"),
        ("lest_clearance_m > 1", "did you mean least_clearance_m?"),
        ("scenario == 1", "scenario is not a metric"),
    ],
)
def test_a_text_that_states_no_requirement_is_refused(text, words):
    with pytest.raises(BadInput) as refused:
        requirement(text)
    assert words in str(refused.value)
    assert text in str(refused.value)


@pytest.mark.parametrize(
    ("comparison", "expected"),
    [
        (">", [False, False, True]),
        (">=", [False, True, True]),
        ("<", [True, False, False]),
        ("<=", [True, True, False]),
        ("==", [False, True, False]),
        ("!=", [True, False, True]),
    ],
)
def test_comparisons(comparison, expected):
    one = Requirement("least_clearance_m", comparison, 1.0)
    assert [one.met({"least_clearance_m": value}) for value in (0.5, 1.0, 1.5)] == expected
    assert one.met({"least_clearance_m": None}) is None
    assert one.met({}) is None
    assert one.met({"least_clearance_m": math.nan}) is False


def test_a_platoon_that_has_not_formed_meets_no_limit_of_its_time():
    one = Requirement("formation_time_s", "<=", 6.5)
    assert one.met({"formation_time_s": None, "formed": False}) is False
    assert one.met({"formation_time_s": None}) is None


@pytest.fixture(scope="module")
def run_of(tmp_path_factory):
    """Metrics and scenario of a real run."""

    def made(name: str, *overrides: str):
        scenario = load(name, overrides)
        log = tmp_path_factory.mktemp("run") / "run.mcap"
        run(RunOptions(scenario, address=Address.parse("direct"), out=log, command_line=["test"]))
        return compute(Run(log)), scenario

    return made


@pytest.fixture(scope="module")
def formation(run_of):
    return run_of("formation", "duration_s=6.0")


@pytest.fixture(scope="module")
def too_short(run_of):
    return run_of("formation-uneven", "duration_s=0.2")


def test_every_metric_is_one_number(formation, too_short):
    for metrics, scenario in (formation, too_short):
        flat = flat_metrics(metrics, scenario)
        assert tuple(flat) == METRIC_NAMES
        assert all(value is None or type(value) in (int, float, bool) for value in flat.values())


def test_numbers_keep_their_value_and_lists_their_worst(formation):
    metrics, scenario = formation
    flat = flat_metrics(metrics, scenario)
    assert flat["formation_time_s"] == metrics.formation_time_s
    assert flat["vehicles"] == 3
    assert flat["final_gap_error_m"] == max(abs(gap - 10.0) for gap in metrics.final_gaps_m)
    assert abs(flat["final_gaps_m"] - 10.0) == flat["final_gap_error_m"]
    assert abs(flat["final_speeds_mps"] - 20.0) == flat["final_speed_error_mps"] > 0.0
    assert flat["final_lateral_errors_m"] == max(map(abs, metrics.final_lateral_errors_m))
    assert flat["speed_rmse_mps"] == max(metrics.speed_rmse_mps)
    assert flat["clearance_margin_m"] == metrics.least_clearance_m - metrics.required_clearance_m
    assert flat["comfort_braking_max_mps2"] == max(metrics.comfort.braking_max_mps2) > 0.0
    assert flat["comfort_steering_reversals"] == max(metrics.comfort.steering_reversals)
    assert flat["warnings"] == metrics.warnings.count


def test_what_a_run_does_not_have_is_none(formation):
    metrics, scenario = formation
    bare = dataclasses.replace(metrics, comfort=None, speed_rmse_mps=[None, None, None], abreast_at_start=True)
    flat = flat_metrics(bare, scenario)
    assert flat["comfort_braking_max_mps2"] is flat["speed_rmse_mps"] is flat["least_distance_in_line_m"] is None
    alone = dataclasses.replace(metrics, final_gaps_m=[], least_clearance_m=None, required_clearance_m=None)
    flat = flat_metrics(alone, scenario)
    assert flat["final_gaps_m"] is flat["final_gap_error_m"] is flat["clearance_margin_m"] is None


def test_a_value_that_is_not_a_number_is_the_worst(formation):
    metrics, scenario = formation
    for broken in ([math.nan, 1.0, 10.0], [10.0, 1.0, math.nan]):
        flat = flat_metrics(dataclasses.replace(metrics, final_gaps_m=broken, final_yaws_rad=broken), scenario)
        assert math.isnan(flat["final_gaps_m"])
        assert math.isnan(flat["final_gap_error_m"])
        assert math.isnan(flat["final_yaws_rad"])


def changed(metrics):
    """Metrics that each break another requirement, and some at its limit."""
    yield metrics
    for name, values in {
        "final_gaps_m": ([10.0, 10.21], [9.79, 10.0], [10.19, 9.81], [10.0, math.nan]),
        "final_speeds_mps": ([20.0, 20.0, 20.11], [19.89, 20.0, 20.0]),
        "final_lateral_errors_m": ([0.0, -0.15, 0.0], [0.149, 0.0, 0.0]),
        "final_yaws_rad": ([0.0, -0.01, 0.0], [0.009, 0.0, 0.0]),
        "boundary_margin_min": (0.0, -1.0, 1e-9, math.nan),
        "least_clearance_m": (0.9, 0.9995, None),
        "least_distance_m": (4.0, 4.1, None),
        "abreast_at_start": (True,),
        "formation_time_s": (6.5, 6.6),
        "frames_lost": (0, 1, None),
        "e2e_errors": (0, 1, None),
    }.items():
        for value in values:
            yield dataclasses.replace(metrics, **{name: value})
    yield dataclasses.replace(metrics, formation_time_s=None, formed=False)
    yield dataclasses.replace(metrics, least_distance_m=3.0, abreast_at_start=True)


@pytest.mark.parametrize("name", ["formation", "five"])
@pytest.mark.parametrize("allows", ["fail", "allow"])
def test_the_default_requirements_are_met_where_the_reports_are(formation, too_short, name, allows):
    scenario = load(name, [f"on_not_a_number={allows}"])
    verdicts = set()
    for metrics in (*changed(formation[0]), *changed(too_short[0])):
        flat = flat_metrics(metrics, scenario)
        own = {each.met(flat) for each in default_requirements(scenario)} - {None}
        report = {row.met for row in table(metrics, scenario) if row.group is Group.RUN} - {None}
        assert (False in own) == (False in report), metrics
        verdicts.add(False in own)
    assert verdicts == {True, False}
