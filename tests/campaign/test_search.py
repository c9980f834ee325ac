"""Search for the worst: finds minima that are known, whatever the inputs, and ends as it should."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.campaign.evaluating import Outcome, Remembered, fails, margin_of, requirement_on
from bench.campaign.requirements import Requirement
from bench.campaign.search import FRUITLESS_STARTS, search
from bench.campaign.statuses import OK, REFUSED
from bench.errors import BadInput
from tests.campaign.evaluations import ABOVE_0, METRIC, Evaluated, choice, integers, normal, study_of, uniform

SEEDS = range(1, 6)


def worst_of(study, function, *, requirement=ABOVE_0, runs=1000, workers=2):
    """The last of what a search yields."""
    *_, last = search(study, requirement, Evaluated(function), runs=runs, workers=workers)
    return last


@pytest.mark.parametrize("seed", SEEDS)
def test_finds_a_minimum_within_the_ranges(seed):
    study = study_of(uniform(10.0, 20.0), uniform(-1.0, 0.0), normal(), seed=seed)
    worst = worst_of(study, lambda v: (v["a"] - 12.0) ** 2 + 100.0 * (v["b"] + 0.3) ** 2 + (v["c"] - v["b"]) ** 2)
    assert worst.values == pytest.approx({"a": 12.0, "b": -0.3, "c": -0.3}, abs=0.01)
    assert worst.margin == worst.outcome.metrics[METRIC] == pytest.approx(0.0, abs=1e-4)


@pytest.mark.parametrize("seed", SEEDS)
def test_finds_a_minimum_on_the_edge_of_the_ranges(seed):
    study = study_of(uniform(), uniform(), uniform(), uniform(), seed=seed)
    worst = worst_of(study, lambda v: v["a"] - v["b"] + (v["c"] - 0.4) ** 2 + (v["d"] - 0.6) ** 2)
    assert worst.margin == pytest.approx(-1.0, abs=0.001)


@pytest.mark.parametrize("seed", SEEDS)
def test_finds_the_worst_of_inputs_with_few_values_beside_continuous_ones(seed):
    study = study_of(uniform(), integers(1, 20), choice("a", "b", "c"), choice(True, False), choice(7), seed=seed)

    def distance(v):
        other = {"a": 0.3, "b": 0.0, "c": 0.5}[v["c"]] + 0.2 * v["d"]
        return (v["a"] - v["b"] / 20) ** 2 + abs(v["b"] - 17) / 10 + other

    worst = worst_of(study, distance)
    assert worst.values == {"a": pytest.approx(0.85, abs=0.01), "b": 17, "c": "b", "d": False, "e": 7}


def test_a_restart_finds_a_narrow_valley_that_the_first_start_misses():
    study = study_of(uniform(), uniform(), seed=1)

    def valleys(v):
        wide = (v["a"] - 0.3) ** 2 + (v["b"] - 0.3) ** 2
        return min(wide, 20 * ((v["a"] - 0.85) ** 2 + (v["b"] - 0.8) ** 2) - 0.1)

    found = list(search(study, ABOVE_0, Evaluated(valleys), runs=3000))
    assert max(each.margin for each in found if each.starts == 1) >= 0.0
    assert found[-1].starts > 1
    assert found[-1].margin == pytest.approx(-0.1, abs=0.01)


def test_ends_when_restarts_find_nothing_worse():
    worst = worst_of(study_of(uniform()), lambda v: (v["a"] - 0.77) ** 2, runs=100_000)
    assert worst.starts == 1 + FRUITLESS_STARTS
    assert worst.ended == "converged: the last 3 of 4 starts found none worse"
    assert worst.evaluations < 2000


@given(st.integers(1, 60), st.integers(1, 12))
def test_makes_exactly_the_runs_allowed_in_batches_of_at_least_the_workers(runs, workers):
    evaluated = Evaluated(lambda v: v["a"] + v["b"])
    *_, worst = search(study_of(uniform(), uniform()), ABOVE_0, evaluated, runs=runs, workers=workers)
    assert worst.ended == f"made {runs} runs, as many as allowed"
    assert worst.evaluations == len(evaluated.values) == runs
    assert all(len(batch) >= workers for batch in evaluated.batches[:-1])


def test_the_same_seed_gives_the_same_search_and_another_one_does_not():
    def found(seed):
        study = study_of(uniform(), integers(0, 5), seed=seed)
        return list(search(study, ABOVE_0, Evaluated(lambda v: v["a"] * v["b"] - v["a"]), runs=150))

    assert found(1) == found(1)
    assert found(1) != found(2)


def test_progress_has_the_worst_so_far_and_only_the_last_has_ended():
    evaluated = Evaluated(lambda v: abs(v["a"] - 0.1) + abs(v["b"] - 0.8))
    found = list(search(study_of(uniform(), uniform()), ABOVE_0, evaluated, runs=100))
    metrics = [evaluated.function(values) for values in evaluated.values]
    assert [each.margin for each in found] == [min(metrics[: each.evaluations]) for each in found]
    assert [bool(each.ended) for each in found] == [False] * (len(found) - 1) + [True]
    assert evaluated.function(found[-1].values) == found[-1].margin
    assert found[-1].outcome.metrics == {METRIC: found[-1].margin}


def test_values_are_evaluated_once():
    evaluated = Evaluated(lambda v: float(v["a"] * v["b"]))
    *_, worst = search(study_of(integers(-3, 3), choice(-1, 0, 1)), ABOVE_0, evaluated, runs=1000)
    texts = [repr(values) for values in evaluated.values]
    assert len(texts) == len(set(texts)) == worst.evaluations <= 21
    assert worst.margin == -3.0
    assert worst.ended.startswith("converged")


def test_equal_values_of_other_types_are_others():
    evaluated = Evaluated(lambda v: 1.0 if v["a"] is True else float(v["a"]) + 1.0)
    remembered = Remembered(evaluated)
    outcomes = remembered([{"a": True}, {"a": 1}, {"a": 1.0}, {"a": True}])
    assert [outcome.metrics[METRIC] for outcome in outcomes] == [1.0, 2.0, 2.0, 1.0]
    assert remembered.evaluations == len(evaluated.values) == 3


def test_a_run_that_does_not_reach_its_end_is_the_worst_and_ends_the_search():
    evaluated = Evaluated(lambda v: "crashed" if v["a"] > 0.9 else 1.0 - v["a"])
    *_, worst = search(study_of(uniform(), uniform()), ABOVE_0, evaluated, runs=1000)
    assert worst.margin == -math.inf
    assert worst.values["a"] > 0.9
    assert worst.outcome.status == "crashed"
    assert worst.ended == "found a run than which none can be worse"


@pytest.mark.parametrize("seed", SEEDS)
def test_values_without_a_scenario_or_margin_keep_the_search_going(seed):
    def clearance(v):
        if v["a"] + v["b"] < 0.5:
            return REFUSED if v["a"] < v["b"] else None
        return v["a"] + 2.0 * v["b"]

    worst = worst_of(study_of(uniform(), uniform(), seed=seed), clearance)
    assert worst.margin == pytest.approx(0.5, abs=0.02)


def test_a_search_in_which_no_run_has_a_margin_ends_and_says_so():
    worst = worst_of(study_of(uniform(), uniform()), lambda _: REFUSED)
    assert (worst.margin, worst.values, worst.outcome) == (None, None, None)
    assert worst.ended.startswith("converged")


def test_an_upper_limit_is_exceeded():
    worst = worst_of(study_of(uniform(0.0, 4.0)), lambda v: v["a"], requirement=Requirement(METRIC, "<=", 3.0))
    assert worst.margin == pytest.approx(-1.0, abs=1e-3)


@pytest.mark.parametrize("comparison", ["==", "!="])
def test_an_equality_cannot_be_searched(comparison):
    with pytest.raises(BadInput, match=r"has none; allowed: >, >=, <, <="):
        search(study_of(uniform()), Requirement("frames_lost", comparison, 0.0), Evaluated(lambda _: 0.0), runs=1)


def test_a_study_without_anything_to_vary_cannot_be_searched():
    with pytest.raises(BadInput, match=r"no input has more than one value.*give \[\[inputs\]\]"):
        search(study_of(choice(1.0)), ABOVE_0, Evaluated(lambda _: 0.0), runs=1)
    with pytest.raises(BadInput, match=r"another scenario in each run.*platoon scenarios random:7 > mine.toml"):
        search(study_of(uniform(), base="random"), ABOVE_0, Evaluated(lambda _: 0.0), runs=1)


LIMITS = (
    Requirement("least_clearance_m", ">", 1.0),
    Requirement("least_clearance_m", "<", 50.0),
    Requirement("formation_time_s", "<=", 6.5),
    Requirement("frames_lost", "==", 0.0),
)


def test_the_requirement_on_a_metric_is_found_by_its_name_or_its_text():
    study = study_of(uniform(), requirements=LIMITS)
    assert requirement_on(study, "formation_time_s") == LIMITS[2]
    assert requirement_on(study, "least_clearance_m < 50") == LIMITS[1]


@pytest.mark.parametrize(
    ("metric", "message"),
    [
        ("least_clearance_m", "has 2 limits in the study s; give one of them: 'least_clearance_m > 1' or"),
        ("frames_lost", 'has only "frames_lost == 0" .* no margin; allowed: least_clearance_m'),
        ("least_distance_m", "has no limit in the study s; allowed: least_clearance_m, .*formation_time_s; or add"),
        ("formation_time", "is not a metric; did you mean formation_time_s"),
    ],
)
def test_a_metric_without_one_limit_is_refused_with_those_allowed(metric, message):
    with pytest.raises(BadInput, match=message):
        requirement_on(study_of(uniform(), requirements=LIMITS), metric)


@pytest.mark.parametrize(
    ("outcome", "margin", "failed"),
    [
        (Outcome(0, {METRIC: 0.5}, OK, ""), 0.5, False),
        (Outcome(0, {METRIC: -0.5}, OK, ""), -0.5, True),
        (Outcome(0, {METRIC: 0.0}, OK, ""), 0.0, True),
        (Outcome(0, {METRIC: math.nan}, OK, ""), -math.inf, True),
        (Outcome(0, {METRIC: None}, OK, ""), None, False),
        (Outcome(0, None, "timeout", "too long"), -math.inf, True),
        (Outcome(0, None, REFUSED, "no scenario"), None, False),
    ],
)
def test_margin_and_failure_of_a_run(outcome, margin, failed):
    assert margin_of(outcome, ABOVE_0) == margin
    assert fails(outcome, ABOVE_0) is failed


def test_a_formation_that_never_was_is_beyond_every_limit_of_its_time():
    outcome = Outcome(0, {"formation_time_s": None, "formed": False}, OK, "")
    assert margin_of(outcome, LIMITS[2]) == -math.inf
    assert fails(outcome, LIMITS[2])
