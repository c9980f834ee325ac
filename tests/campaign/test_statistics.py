"""Shares of failures with exact bounds, and what is told of metrics."""

import math

import numpy as np
import polars as pl
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binom, binomtest

from bench.campaign.statistics import convergence, edges_of, histogram, percent, quantiles, share, share_of


@pytest.mark.parametrize(
    ("failed", "known", "low", "high"),
    [
        # Agresti and Coull (1998), Approximate is better than "exact": 0, 1 ... of n; 1 - 0.025^(1/n) for none.
        (0, 10, 0.0, 0.30850),
        (0, 100, 0.0, 0.036217),
        (0, 1000, 0.0, 0.0036821),
        # Newcombe (1998), Two-sided confidence intervals for the single proportion, table I, method 5.
        (81, 263, 0.2527, 0.3676),
        (15, 148, 0.0578, 0.1617),
        (0, 20, 0.0, 0.1684),
        (1, 29, 0.0009, 0.1776),
    ],
)
def test_the_bounds_are_the_published_ones(failed, known, low, high):
    found = share(failed, known)
    assert found.low == pytest.approx(low, abs=6e-5)
    assert found.high == pytest.approx(high, abs=6e-5)


@given(st.integers(1, 100_000).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_the_bounds_are_those_of_scipys_exact_test(case):
    failed, known = case
    found, exact = share(failed, known), binomtest(failed, known).proportion_ci(0.95, method="exact")
    assert found.low == pytest.approx(exact.low, abs=1e-9)
    assert found.high == pytest.approx(exact.high, abs=1e-9)


@pytest.mark.parametrize("chance", [0.001, 0.03, 0.4])
def test_the_bounds_hold_the_probability_as_often_as_they_say(chance):
    counts = np.arange(201)
    held = [share(int(k), 200).low <= chance <= share(int(k), 200).high for k in counts]
    assert binom.pmf(counts, 200, chance)[held].sum() >= 0.95


def test_none_of_n_is_told_as_its_upper_bound_and_all_of_n_as_its_lower_one():
    assert share(0, 1000).bounds == "at most 0.37 %"
    assert share(1000, 1000).bounds == "at least 99.63 %"
    assert share(14, 998).bounds == "0.76 % to 2.4 %"


def test_bounds_are_rounded_outwards():
    for failed in range(51):
        found = share(failed, 50)
        ends = [
            float(word) / 100
            for word in found.bounds.replace("at least", "").replace("at most", "").split()
            if word[0].isdigit()
        ]
        if failed < 50:
            assert ends[-1] >= found.high
        if failed > 0:
            assert ends[0] <= found.low


def test_runs_that_are_not_drawn_at_random_have_a_share_without_bounds():
    found = share(3, 8, random=False)
    assert (found.text, found.bounds) == ("37.5 %", "–")


def test_of_no_run_nothing_is_told():
    found = share_of(pl.Series([None, None], dtype=pl.Boolean))
    assert (found.failed, found.known, found.text, found.bounds) == (0, 0, "–", "–")


def test_runs_of_which_nothing_is_known_count_neither_way():
    found = share_of(pl.Series([True, None, False, None, False]))
    assert (found.failed, found.known) == (1, 3)


def test_the_share_converges_in_the_order_of_the_runs_up_to_all_of_them():
    failed = pl.Series([True] * 10 + [False] * 990)
    shares = list(convergence(failed))
    assert shares[-1] == share(10, 1000)
    assert [each.known for each in shares] == sorted({each.known for each in shares})
    assert all(each == share(min(10, each.known), each.known) for each in shares)


def test_a_campaign_of_few_runs_has_a_point_for_each():
    assert [each.known for each in convergence(pl.Series([False, None, True]))] == [1, 2]
    assert list(convergence(pl.Series([None], dtype=pl.Boolean))) == []


def test_quantiles_leave_out_what_is_no_number():
    nothing = [math.nan, math.inf, None]
    values = {"some": [*map(float, range(101)), *nothing], "none": nothing + [None] * 101, "truth": [True] * 104}
    assert quantiles(pl.DataFrame(values)) == [[0.0, 5.0, 50.0, 95.0, 100.0], [], [1.0] * 5]
    assert quantiles(pl.DataFrame()) == []


@pytest.mark.parametrize("values", [[1.0], [2.5, 2.5], [0.0, 1.0, 1.0], list(np.linspace(-3, 9, 500)), [5.0, 1e9]])
def test_every_value_is_in_a_class_of_the_histogram(values):
    numbers = np.array(values)
    edges = edges_of(numbers)
    assert sum(histogram(numbers, edges)) == len(values)
    assert np.all(np.diff(edges) > 0)


def test_whole_numbers_have_a_class_each():
    assert histogram(np.array([0.0, 0.0, 2.0]), edges_of(np.array([0.0, 0.0, 2.0]))) == [2, 0, 1]


@pytest.mark.parametrize(
    ("part", "text"),
    [(0.0, "0 %"), (1.0, "100 %"), (0.5, "50.0 %"), (0.00123, "0.12 %"), (0.99987, "99.987 %"), (1e-7, "0.000010 %")],
)
def test_a_share_is_told_in_percent(part, text):
    assert percent(part) == text
