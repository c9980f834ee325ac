"""Joins in time, against what they mean, value by value."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from bench.record.time_join import last_until, same_times

TIMES = st.lists(st.integers(0, 30), max_size=20)
CYCLE_NS = 10_000_000


@given(TIMES, TIMES)
def test_equal_times_meet_however_their_seconds_were_reckoned(a, b):
    # 3 * 0.01 s and 0.03 s differ in their last bit.
    rows = same_times(np.array(a, np.float64) * 0.01, np.array(b, np.int64) / 100)
    common = sorted(set(a) & set(b))
    assert [row.tolist() for row in rows] == [[times.index(time) for time in common] for times in (a, b)]


@given(TIMES.map(sorted), TIMES)
def test_a_value_holds_from_its_time_until_the_next(times, at):
    rows = last_until(np.array(times, np.int64) * CYCLE_NS, np.array(at, np.int64) * CYCLE_NS)
    assert rows.tolist() == [sum(time <= now for time in times) - 1 for now in at]
