"""Bytes to and from many places at once."""

import numpy as np
import pytest

from bench.mcap.gathering import gathered, scatter

ROW = np.dtype([("a", "<u2"), ("b", "<f8"), ("c", "u1")])


def test_values_come_back_from_where_they_were_put_and_nothing_else_changes():
    rows = np.array([(1, 0.1, 2), (3, -0.0, 4), (5, np.nan, 6)], ROW)
    data = np.full(40, 0xEE, np.uint8)
    offsets = np.array([29, 0, 12])
    scatter(data, offsets, rows)
    assert gathered(data, offsets, ROW.itemsize).tobytes() == rows.tobytes()
    assert np.flatnonzero(data == 0xEE).tolist() == [11, *range(23, 29)]


@pytest.mark.parametrize("offset", [30, 1000])
def test_what_would_go_beyond_the_end_is_refused(offset):
    data = np.zeros(40, np.uint8)
    with pytest.raises(IndexError):
        scatter(data, np.array([offset]), np.zeros(1, ROW))
    with pytest.raises(IndexError):
        gathered(data, np.array([offset]), ROW.itemsize)
