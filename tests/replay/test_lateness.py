"""Quantiles of lateness against numpy's."""

import numpy as np
import pytest

from bench.replay.lateness import Lateness


def test_quantiles_are_at_most_ten_per_cent_too_large():
    late = np.random.default_rng(1).lognormal(11.0, 2.0, 5000).astype(int)
    table = Lateness()
    for each in late.tolist():
        table.add(each)
    for share in (0.5, 0.9, 0.99, 1.0):
        exact = np.quantile(late, share, method="inverted_cdf")
        assert exact <= table.quantile_ns(share) <= 1.1 * exact
    assert table.largest_ns == table.quantile_ns(1.0) == late.max()
    assert table.frames == 5000


def test_nothing_sent_and_what_was_early():
    table = Lateness()
    assert table.quantile_ns(0.99) == 0
    table.add(-5)
    assert (table.frames, table.quantile_ns(0.5), table.largest_ns) == (1, 0, 0)


@pytest.mark.parametrize("late", [1, 99, 100, 12_345])
def test_a_single_one_is_exact(late):
    table = Lateness()
    table.add(late)
    assert table.quantile_ns(0.5) == late
