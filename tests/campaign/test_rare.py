"""Subset simulation on problems whose probability is known, and how it ends where it cannot go on."""

import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm

from bench.campaign.rare import LEVEL_SHARE, share_variation, subset_simulation
from bench.campaign.requirements import Requirement
from bench.campaign.statuses import REFUSED
from bench.campaign.study import Group
from bench.errors import BadInput, RunFailed
from tests.campaign.evaluations import ABOVE_0, METRIC, Evaluated, choice, integers, normal, study_of, uniform

SEEDS = range(20)
SAMPLES = 1000
BETA = 4.7534
"""Distance of the nearest failure, in standard deviations, whose probability is 1e-6."""


def plane(v):
    return BETA - sum(v.values()) / math.sqrt(len(v))


def four_branches(v):
    """The series system of four branches of many papers on reliability, with failures in four directions."""
    a, b = v["a"], v["b"]
    bent = 0.1 * (a - b) ** 2 + 3.0
    across, along = (a - b), (a + b) / math.sqrt(2.0)
    return min(bent - along, bent + along, across + 7.0 / math.sqrt(2.0), -across + 7.0 / math.sqrt(2.0))


def probability_of_four_branches():
    """The probability, by integration along the diagonal across the branches."""

    def not_failed(x):
        return norm.pdf(x) * (1.0 - 2.0 * norm.sf(3.0 + 0.2 * x * x))

    return 1.0 - quad(not_failed, -3.5, 3.5)[0]


def dice(v):
    """What three dice of 100 faces lack of 297."""
    return 297.0 - sum(v.values())


PROBLEMS = {
    "plane-2": (study_of(normal(), normal()), plane, norm.sf(BETA)),
    "plane-10": (study_of(*[normal()] * 10), plane, norm.sf(BETA)),
    "four-branches": (study_of(normal(), normal()), four_branches, probability_of_four_branches()),
    # The faces lack at most 3 of 300 in 20 of the ways in which three dice can fall.
    "dice": (study_of(*[integers(1, 100)] * 3), dice, math.comb(6, 3) / 100.0**3),
    # The sum of the two has the variance 2 + 2 * 0.7.
    "correlated": (
        study_of(
            groups=(
                Group(
                    keys=("p", "q"),
                    means=(1.0, 2.0),
                    standard_deviations=(1.0, 1.0),
                    low=(-7.0, -6.0),
                    high=(9.0, 10.0),
                    correlation=((1.0, 0.7), (0.7, 1.0)),
                ),
            )
        ),
        lambda v: 3.0 + 4.0 * math.sqrt(3.4) - sum(v.values()),
        norm.sf(4.0),
    ),
}


def seeded(study, seed):
    return type(study)(**{**study.__dict__, "seed": seed})


def simulated(study, function, **options):
    """The last progress of a simulation, which has the estimate."""
    *_, last = subset_simulation(study, ABOVE_0, Evaluated(function), **options)
    return last


@pytest.mark.parametrize("name", PROBLEMS)
def test_the_mean_and_the_stated_variation_are_those_of_many_simulations(name):
    study, function, probability = PROBLEMS[name]
    estimates = [simulated(seeded(study, seed), function, samples=SAMPLES).estimate for seed in SEEDS]
    found = np.array([estimate.probability for estimate in estimates])
    stated = float(np.mean([estimate.variation for estimate in estimates]))
    assert abs(found.mean() / probability - 1.0) < 3.0 * stated / math.sqrt(len(found))
    assert stated / 2.0 < found.std(ddof=1) / probability < 2.0 * stated
    assert all(estimate.most is None for estimate in estimates)


def test_a_rare_failure_takes_few_runs():
    study, function, probability = PROBLEMS["plane-2"]
    last = simulated(study, function, samples=SAMPLES)
    assert last.evaluations < 7000 < 0.01 / probability
    assert last.estimate.words == f"reached the failures on level {last.level}"


def test_levels_lead_to_the_failures():
    study, function, _ = PROBLEMS["plane-10"]
    estimate = simulated(study, function, samples=SAMPLES).estimate
    thresholds = [level.threshold for level in estimate.levels]
    assert thresholds[0] == math.inf
    assert thresholds == sorted(thresholds, reverse=True)
    # Samples that have not moved share their margin, and so the threshold.
    assert all(LEVEL_SHARE <= level.share < 1.2 * LEVEL_SHARE for level in estimate.levels[:-1])
    assert estimate.levels[-1].share >= LEVEL_SHARE
    assert estimate.probability == pytest.approx(math.prod(level.share for level in estimate.levels))
    assert estimate.variation == pytest.approx(math.hypot(*(level.variation for level in estimate.levels)))


def test_all_chains_advance_in_one_batch():
    study, function, _ = PROBLEMS["plane-2"]
    evaluated = Evaluated(function)
    progress = list(subset_simulation(study, ABOVE_0, evaluated, samples=SAMPLES))
    sizes = [len(batch) for batch in evaluated.batches]
    assert sizes[0] == SAMPLES
    # The 100 chains of a level begin with samples of the level before; it can be few more, with equal margins.
    assert sizes[1:10] == [100] * 9
    assert 9 * (progress[-1].level - 1) <= len(sizes[1:])
    assert sum(sizes) < SAMPLES + 900 * (progress[-1].level - 1) + 100
    assert [each.evaluations for each in progress] == [*np.cumsum(sizes), sum(sizes)]
    assert [each.estimate is not None for each in progress] == [False] * len(sizes) + [True]


def test_the_number_of_samples_need_not_be_one_of_whole_chains():
    study, function, probability = PROBLEMS["four-branches"]
    evaluated = Evaluated(function)
    *_, last = subset_simulation(study, ABOVE_0, evaluated, samples=1037)
    # 104 chains of 10 steps would be 1040 samples.
    assert [len(batch) for batch in evaluated.batches[:10]] == [1037, *[104] * 8, 101]
    assert last.estimate.probability == pytest.approx(probability, rel=0.6)


def test_the_same_seed_gives_the_same_simulation_and_another_one_does_not():
    study, function, _ = PROBLEMS["four-branches"]
    one, again, other = (
        [*subset_simulation(seeded(study, seed), ABOVE_0, Evaluated(function), samples=200)] for seed in (1, 1, 2)
    )
    assert one == again
    assert one[-1].estimate.probability != other[-1].estimate.probability


def test_frequent_failures_are_counted_as_by_monte_carlo():
    evaluated = Evaluated(lambda v: v["a"] - 0.3)
    *_, last = subset_simulation(study_of(uniform()), ABOVE_0, evaluated, samples=SAMPLES)
    failed = sum(values["a"] <= 0.3 for values in evaluated.values)
    assert len(evaluated.values) == SAMPLES
    assert last.estimate.probability == failed / SAMPLES
    assert last.estimate.variation == pytest.approx(math.sqrt((SAMPLES - failed) / failed / SAMPLES))


def test_a_run_that_does_not_reach_its_end_fails():
    def crashing(v):
        return "crashed" if v["a"] > 0.9998 else 1.1 - v["a"]

    found = [simulated(study_of(uniform(), seed=seed), crashing).estimate.probability for seed in SEEDS]
    assert np.mean(found) == pytest.approx(2e-4, rel=0.2)


@pytest.mark.parametrize("unknown", [REFUSED, None])
def test_values_without_a_scenario_or_margin_do_not_count(unknown):
    def clearance(v):
        return unknown if v["a"] < 0.5 else 0.9999 - v["a"]

    found = [simulated(study_of(uniform(), seed=seed), clearance).estimate.probability for seed in SEEDS]
    assert np.mean(found) == pytest.approx(2e-4, rel=0.2)


def test_only_as_many_values_are_drawn_as_are_missing():
    evaluated = Evaluated(lambda v: REFUSED if v["a"] < 0.2 else 0.5 - v["a"])
    list(subset_simulation(study_of(uniform()), ABOVE_0, evaluated, samples=SAMPLES))
    refused = [sum(values["a"] < 0.2 for values in batch) for batch in evaluated.batches]
    assert [len(batch) for batch in evaluated.batches] == [SAMPLES, *refused[:-1]]
    assert refused[-1] == 0


def test_simulation_needs_values_that_make_a_run():
    def run():
        list(subset_simulation(study_of(uniform()), ABOVE_0, Evaluated(lambda _: REFUSED), samples=100))

    with pytest.raises(RunFailed, match="Of 10000 random values, only 0 made a run with a margin of least_clearance_m"):
        run()


def test_without_any_failure_and_without_any_lower_margin_there_is_only_the_exact_bound():
    last = simulated(study_of(normal()), lambda _: 2.5, samples=200)
    assert last.evaluations == 200
    assert (last.estimate.probability, last.estimate.variation) == (0.0, math.inf)
    # Clopper and Pearson's bound of 0 of 200.
    assert last.estimate.most == pytest.approx(1.0 - 0.025 ** (1 / 200))
    assert "ended on level 1, because no level can follow" in last.estimate.words
    assert "same margin of least_clearance_m, 2.5, none has less and none fails" in last.estimate.words


def test_a_plateau_on_a_later_level_bounds_the_probability_by_that_level():
    # Nothing is below the margin of 1, which half of a per mille have.
    last = simulated(study_of(uniform()), lambda v: max(1.0, 1.9995 - v["a"]))
    assert last.level > 3
    assert "no level can follow" in last.estimate.words
    assert last.estimate.probability == 0.0
    assert 0.0 < last.estimate.most < 0.0005


def test_few_failures_beside_a_plateau_are_counted():
    def two_values(v):
        return -1.0 if v["a"] > 0.97 else 1.0

    evaluated = Evaluated(two_values)
    *_, last = subset_simulation(study_of(uniform()), ABOVE_0, evaluated, samples=SAMPLES)
    assert last.estimate.probability == sum(two_values(values) < 0.0 for values in evaluated.values) / SAMPLES > 0.0
    assert last.level == 1


def test_a_plateau_above_lower_margins_is_left():
    def steps(v):
        """1 for 96 %, then falling to failures with a probability of 1e-4."""
        return 1.0 if v["a"] < 0.96 else 0.9999 - v["a"]

    found = [simulated(study_of(uniform(), seed=seed), steps).estimate.probability for seed in SEEDS]
    assert np.mean(found) == pytest.approx(1e-4, rel=0.3)


def test_the_largest_number_of_levels_ends_it_with_a_bound():
    last = simulated(study_of(normal()), lambda v: math.exp(-v["a"]), most_levels=4)
    assert last.level == len(last.estimate.levels) == 4
    assert last.estimate.probability == 0.0
    assert last.reached == pytest.approx(1e-3)
    # 0 of 100 chains, and the probability of the level is uncertain.
    assert 1e-3 * (1.0 - 0.025 ** (1 / 100)) < last.estimate.most < 1e-3
    assert last.estimate.words.startswith("ended after 4 levels without a failure; the least margin")


def test_variation_of_chains_that_never_move_is_that_of_their_number():
    chosen = np.tile(np.arange(50) < 10, (10, 1))
    assert share_variation(chosen, np.ones_like(chosen)) == pytest.approx(math.sqrt(0.8 / 0.2 / 50))


def test_variation_of_independent_steps_is_about_that_of_their_number():
    chosen = np.random.default_rng(1).random((10, 1000)) < 0.1
    p = chosen.mean()
    assert share_variation(chosen, np.ones_like(chosen)) == pytest.approx(math.sqrt((1 - p) / p / 10_000), rel=0.05)


def test_variation_ignores_steps_that_a_chain_does_not_have():
    there = np.ones((2, 4), dtype=bool)
    there[1, 2:] = False
    chosen = np.array([[True, False, True, False], [True, False, True, True]])
    # 6 samples, half of them chosen, and two pairs that agree: gamma is 2 * 2/6 * (1/2 - 1/4) / (1/4).
    assert share_variation(chosen, there) == pytest.approx(math.sqrt((1.0 + 2.0 / 3.0) / 6.0))


def test_what_cannot_be_simulated_is_refused_at_once():
    evaluated = Evaluated(lambda _: 0.0)
    with pytest.raises(BadInput, match='"frames_lost == 0" has none; allowed: >, >=, <, <='):
        subset_simulation(study_of(uniform()), Requirement("frames_lost", "==", 0.0), evaluated)
    with pytest.raises(BadInput, match="99 samples of a level are not enough; allowed: at least 100"):
        subset_simulation(study_of(uniform()), ABOVE_0, evaluated, samples=99)
    with pytest.raises(BadInput, match="no input has more than one value"):
        subset_simulation(study_of(choice(1)), ABOVE_0, evaluated)
    with pytest.raises(BadInput, match="another scenario in each run"):
        subset_simulation(study_of(uniform(), base="random"), ABOVE_0, evaluated)


def test_an_upper_limit_is_exceeded_with_its_probability():
    limit = Requirement(METRIC, "<", 0.999)
    found = []
    for seed in SEEDS:
        *_, last = subset_simulation(study_of(uniform(), seed=seed), limit, Evaluated(lambda v: v["a"]))
        found.append(last.estimate.probability)
    assert np.mean(found) == pytest.approx(0.001, rel=0.15)
