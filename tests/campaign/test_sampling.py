"""Samples: always the same, each input with its distribution, and correlated where a group says so."""

import itertools

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.stats import kstest, loguniform, spearmanr, truncnorm, uniform

from bench.campaign.distributions import Choice, Integers, LogUniform, Normal, Uniform
from bench.campaign.sampling import samples
from bench.campaign.study import Group, Input, Study

RANDOM = ("monte-carlo", "latin-hypercube", "sobol")
INPUTS = (
    Input(key="a", distribution=Uniform(kind="uniform", low=-1.0, high=3.0)),
    Input(key="b", distribution=LogUniform(kind="log-uniform", low=0.01, high=10.0)),
    Input(key="c", distribution=Normal(kind="normal", mean=1.0, standard_deviation=2.0, low=-2.0, high=2.5)),
    Input(key="d", distribution=Choice(kind="choice", values=(True, 1, "x"))),
    Input(key="e", distribution=Integers(kind="integers", low=-3, high=4)),
)
GROUP = Group(
    keys=("p", "q", "r"),
    means=(0.0, 5.0, -2.0),
    standard_deviations=(1.0, 2.0, 0.1),
    low=(-5.0, 4.0, -3.0),
    high=(5.0, 15.0, -1.0),
    correlation=((1.0, 0.7, -0.3), (0.7, 1.0, 0.1), (-0.3, 0.1, 1.0)),
)
LAWS = {
    "a": uniform(-1.0, 4.0),
    "b": loguniform(0.01, 10.0),
    "c": truncnorm(-1.5, 0.75, loc=1.0, scale=2.0),
    "p": truncnorm(-5.0, 5.0),
    "q": truncnorm(-0.5, 5.0, loc=5.0, scale=2.0),
    "r": truncnorm(-10.0, 10.0, loc=-2.0, scale=0.1),
}


def a_study(sampling="monte-carlo", *, runs=100, seed=1, inputs=INPUTS, groups=(GROUP,)) -> Study:
    return Study(
        name="s",
        base="formation",
        seed=seed,
        runs=runs,
        sampling=sampling,
        inputs=inputs,
        groups=groups,
        requirements=(),
        ecus={},
        time_limit_s=1.0,
        text="",
    )


def column(study: Study, key: str) -> list:
    return [sample.values[key] for sample in samples(study)]


@given(st.sampled_from(RANDOM), st.integers(0, 2**32 - 1), st.integers(1, 40))
@settings(max_examples=30, deadline=None)
def test_the_same_study_has_the_same_samples_numbered_from_0(sampling, seed, runs):
    study = a_study(sampling, runs=runs, seed=seed)
    found = samples(study)
    assert found == samples(study)
    assert [sample.number for sample in found] == list(range(runs))
    assert all(list(sample.values) == [*"abcde", *"pqr"] for sample in found)


@given(st.sampled_from(["monte-carlo", "sobol"]), st.integers(0, 2**32 - 1), st.integers(1, 70), st.integers(0, 70))
@example("monte-carlo", 57, 1, 1)
@settings(max_examples=40, deadline=None)
def test_a_longer_campaign_begins_with_the_shorter_one(sampling, seed, runs, more):
    short, long = (samples(a_study(sampling, runs=count, seed=seed)) for count in (runs, runs + more))
    assert long[:runs] == short


@pytest.mark.parametrize("sampling", RANDOM)
def test_another_seed_gives_other_samples(sampling):
    assert column(a_study(sampling), "a") != column(a_study(sampling, seed=2), "a")


@pytest.mark.parametrize("sampling", RANDOM)
@pytest.mark.parametrize("key", LAWS)
def test_each_input_has_its_distribution(sampling, key):
    values = column(a_study(sampling, runs=4096), key)
    assert kstest(values, LAWS[key].cdf).pvalue > 0.01
    low, high = LAWS[key].support()
    assert low <= min(values)
    assert max(values) <= high


@pytest.mark.parametrize("sampling", RANDOM)
@pytest.mark.parametrize(("key", "cases"), [("d", [True, 1, "x"]), ("e", list(range(-3, 5)))])
def test_cases_are_equally_likely_and_keep_their_type(sampling, key, cases):
    values = column(a_study(sampling, runs=4096), key)
    counts = [sum(value is case or (type(value), value) == (type(case), case) for value in values) for case in cases]
    assert sum(counts) == 4096
    expected = 4096 / len(cases)
    assert max(abs(count - expected) for count in counts) < 5 * expected**0.5


@pytest.mark.parametrize("sampling", RANDOM)
def test_a_group_has_its_correlation_and_inputs_have_none(sampling):
    study = a_study(sampling, runs=8192)
    columns = {key: column(study, key) for key in "abcpqr"}
    for (i, one), (j, other) in itertools.combinations(enumerate("pqr"), 2):
        # The rank correlation of two normal values, which truncation far out and at one end of q hardly changes.
        expected = 6.0 / np.pi * np.arcsin(GROUP.correlation[i][j] / 2.0)
        assert spearmanr(columns[one], columns[other])[0] == pytest.approx(expected, abs=0.04)
    for one, other in [*itertools.combinations("abc", 2), ("a", "p"), ("c", "q")]:
        assert abs(spearmanr(columns[one], columns[other])[0]) < 0.05


@pytest.mark.parametrize("runs", [1, 7, 64])
def test_a_latin_hypercube_has_one_value_in_each_stratum(runs):
    shares = (np.array(column(a_study("latin-hypercube", runs=runs), "a")) + 1.0) / 4.0
    assert sorted(np.floor(shares * runs).astype(int)) == list(range(runs))


def test_sobol_has_one_value_in_each_stratum_of_a_power_of_two():
    shares = (np.array(column(a_study("sobol", runs=64), "a")) + 1.0) / 4.0
    assert sorted(np.floor(shares * 64).astype(int)) == list(range(64))


def test_a_grid_is_every_combination_of_evenly_spaced_values():
    inputs = (
        Input(key="a", distribution=Uniform(kind="uniform", low=-1.0, high=3.0), points=3),
        Input(key="b", distribution=LogUniform(kind="log-uniform", low=0.01, high=100.0), points=5),
        Input(key="d", distribution=Choice(kind="choice", values=("x", "y")), points=1),
        Input(key="e", distribution=Integers(kind="integers", low=0, high=10), points=3),
    )
    found = samples(a_study("grid", runs=90, inputs=inputs, groups=()))
    assert len(found) == 90
    assert len({tuple(sample.values.values()) for sample in found}) == 90
    seen = {key: sorted({sample.values[key] for sample in found}) for key in "abde"}
    assert seen["a"] == [-1.0, 1.0, 3.0]
    assert seen["b"] == pytest.approx([0.01, 0.1, 1.0, 10.0, 100.0])
    assert (seen["d"], seen["e"]) == (["x", "y"], [0, 5, 10])
    assert [sample.values["e"] for sample in found[:4]] == [0, 5, 10, 0]


@pytest.mark.parametrize(("points", "numbers"), [(1, [1]), (2, [0, 3]), (4, [0, 1, 2, 3]), (9, [0, 1, 2, 3])])
def test_a_grid_of_integers_has_no_number_twice(points, numbers):
    assert Integers(kind="integers", low=0, high=3).grid(points) == numbers


def test_corners_are_all_combinations_of_ends_and_choices():
    found = [tuple(sample.values.values()) for sample in samples(a_study("corners", runs=48, groups=()))]
    ends = [(-1.0, 3.0), (0.01, 10.0), (-2.0, 2.5), (True, 1, "x"), (-3, 4)]
    assert found == list(itertools.product(*ends))


@given(st.lists(st.floats(0.0, 1.0), min_size=1, max_size=20), st.floats(1e-6, 1e6), st.floats(1.001, 1e6))
def test_no_share_leaves_a_range(shares, low, ratio):
    high = low * ratio
    mean = (low + high) / 2.0
    for law in (
        Uniform(kind="uniform", low=low, high=high),
        LogUniform(kind="log-uniform", low=low, high=high),
        Normal(kind="normal", mean=mean, standard_deviation=high - low, low=low, high=high),
    ):
        assert all(low <= value <= high for value in law.at(np.array(shares)))
    assert all(1 <= value <= 9 for value in Integers(kind="integers", low=1, high=9).at(np.array(shares)))


@given(st.floats(-1e3, 1e3), st.floats(1e-3, 1e3))
def test_ends_of_the_unit_interval_are_exactly_the_ends_of_the_range(low, length):
    high = low + length
    for law in (
        *(each.distribution for each in INPUTS),
        Uniform(kind="uniform", low=low, high=high),
        LogUniform(kind="log-uniform", low=length, high=2.0 * length),
        Normal(kind="normal", mean=low, standard_deviation=length, low=low, high=high),
    ):
        first, last = law.at(np.array([0.0, 1.0]))
        assert (first, last) == (law.extremes()[0], law.extremes()[-1])


@given(st.floats(-8.0, 8.0))
def test_a_range_far_from_the_mean_still_has_its_distribution(start):
    law = Normal(kind="normal", mean=0.0, standard_deviation=1.0, low=start, high=start + 1.0)
    shares = np.linspace(0.0, 1.0, 9)
    assert law.at(shares) == pytest.approx(truncnorm.ppf(shares, start, start + 1.0), abs=1e-9)
    assert len(set(law.at(shares))) == 9
