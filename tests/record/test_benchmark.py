"""The benchmarks of logs run, and measure what they say. How fast anything is, is not tested."""

import io
import math

import numpy as np
import pytest
from mcap.reader import make_reader
from rich.console import Console

from bench.benchmarks import record
from bench.benchmarks.long_log import repeat
from bench.record import Run

PERIOD_S = 1


@pytest.fixture(scope="module")
def long_log(real_log, tmp_path_factory):
    path = tmp_path_factory.mktemp("long") / "long.mcap"
    frames = repeat(real_log, path, period_ns=PERIOD_S * 10**9, duration_ns=3 * 10**9)
    return path, frames


def printed(table):
    file = io.StringIO()
    Console(width=160, file=file).print(table)
    return file.getvalue()


def test_a_repeated_log_has_the_same_messages_at_later_times(real_log, long_log):
    path, frames = long_log
    once, thrice = Run(real_log), Run(path)
    assert frames == sum(len(thrice.frame_table(bus)) for bus in thrice.buses)
    assert set(thrice.topics) == set(once.topics)
    assert thrice.attachments == once.attachments
    for topic in once.topics:
        assert thrice.log.count(topic) == 3 * once.log.count(topic)
    (t, values), (long_t, long_values) = (run.signal("veh3.VehicleMotion.YawRate") for run in (once, thrice))
    assert np.array_equal(long_values, np.tile(values, 3))
    assert np.allclose(long_t, np.concatenate([t, t + PERIOD_S, t + 2 * PERIOD_S]), rtol=0, atol=1e-9)
    with path.open("rb") as stream:
        times = [record.log_time for _, _, record in make_reader(stream, validate_crcs=True).iter_messages()]
    assert len(times) == sum(thrice.log.count(topic) for topic in thrice.topics)
    assert times == sorted(times)


def test_reading_is_measured_beside_the_plain_way(real_log, long_log):
    found = record.reading(real_log, long_log[0], rounds=1)
    assert len(found) == 4
    assert all(math.isfinite(figure.least) and figure.least > 0.0 for figure in found)


def test_recording_loses_nothing(real_log, tmp_path):
    given = 2 * sum(1 for _ in Run(real_log).frames())
    table = printed(record.recording(real_log, tmp_path, times=2))
    assert table.count(f" {given} ") == 2, table
    assert list(tmp_path.iterdir()) == []


def test_memory_is_that_of_the_process_that_reads(long_log):
    # A list of 10 million times the same object is 80 MB.
    small, large = (record.memory_of(f"[None] * {count}", long_log[0]) for count in (10, 10_000_000))
    assert 70e6 < large - small < 100e6
