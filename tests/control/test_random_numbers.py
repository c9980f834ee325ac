"""The random numbers: the published sequence, and the distributions that the names promise."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.control.random_numbers import RandomNumbers, mixed


def test_sequence_is_the_published_one() -> None:
    """The first numbers of the reference implementation for seed 1234567."""
    numbers = RandomNumbers(1234567)
    assert [numbers.bits() for _ in range(5)] == [
        6457827717110365317,
        3203168211198807973,
        9817491932198370423,
        4593380528125082431,
        16408922859458223821,
    ]


def test_uniform_numbers_are_uniform() -> None:
    numbers = RandomNumbers(1)
    drawn = np.array([numbers.uniform() for _ in range(20_000)])
    assert 0.0 <= drawn.min() < drawn.max() < 1.0
    counts = np.histogram(drawn, 20, (0.0, 1.0))[0]
    # Chi-squared with 19 degrees of freedom: its 99.9 % quantile.
    assert ((counts - 1000.0) ** 2 / 1000.0).sum() < 43.8


def test_normal_numbers_are_normal() -> None:
    numbers = RandomNumbers(1)
    drawn = np.sort([numbers.normal() for _ in range(20_000)])
    expected = [0.5 * (1.0 + math.erf(x / math.sqrt(2.0))) for x in drawn]
    # Kolmogorov and Smirnov: the 99.9 % quantile.
    assert np.abs(expected - np.arange(1, 20_001) / 20_000).max() < 1.95 / math.sqrt(20_000)
    assert np.corrcoef(drawn[:-1], drawn[1:])[0, 1] > 0.99
    unsorted = np.array([numbers.normal() for _ in range(20_000)])
    assert abs(np.corrcoef(unsorted[:-1], unsorted[1:])[0, 1]) < 0.03


@given(st.integers(0, 2**64 - 1), st.integers(1, 1000))
def test_integers_are_below_their_limit(seed: int, count: int) -> None:
    numbers = RandomNumbers(seed)
    assert all(0 <= numbers.below(count) < count for _ in range(20))


@pytest.mark.parametrize("count", [4, 24])
def test_every_integer_is_drawn(count: int) -> None:
    numbers = RandomNumbers(3)
    assert {numbers.below(count) for _ in range(2000)} == set(range(count))


def test_mixed_seeds_depend_on_every_number_and_on_their_order() -> None:
    seeds = {mixed(*numbers) for numbers in ((1, 2, 3), (1, 3, 2), (2, 1, 3), (1, 2, 4), (2, 2, 3), (1, 2), (3, 2, 1))}
    assert len(seeds) == 7
    assert all(0 <= seed < 2**64 for seed in seeds)
    assert mixed(1, 2, 3) == mixed(1, 2, 3)


@given(st.integers(0, 2**128), st.integers(1, 100), st.integers(0, 2**40))
def test_mixed_takes_numbers_of_any_size(seed: int, vehicle: int, interval: int) -> None:
    assert mixed(seed, vehicle, interval) != mixed(seed, vehicle, interval + 1)
