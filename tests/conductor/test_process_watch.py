"""What processes take of the machine, sampled for the log."""

import os
import subprocess
import sys

import psutil
import pytest

from bench.conductor import process_watch
from bench.conductor.process_watch import CONDUCTOR, ProcessWatch


def spin(seconds):
    end = psutil.Process().cpu_times().user + seconds
    while psutil.Process().cpu_times().user < end:
        pass


def test_the_first_sample_comes_at_once_and_the_next_after_the_period():
    watch = ProcessWatch(dict)
    assert [name for name, _ in watch.samples()] == [CONDUCTOR]
    assert list(watch.samples()) == []


def test_a_sample_is_what_the_kernel_says_of_the_process(monkeypatch):
    monkeypatch.setattr(process_watch, "PERIOD_S", 0.0)
    watch = ProcessWatch(dict)
    ((_, first),) = watch.samples()
    spin(0.1)
    ((_, second),) = watch.samples()
    assert second.cpu_time - first.cpu_time >= 0.09
    assert first.cpu_share == 0.0
    assert 0.0 < second.cpu_share <= 1.5
    assert second.memory == pytest.approx(psutil.Process().memory_info().rss, rel=0.1)


def test_a_process_that_has_ended_is_left_out(monkeypatch):
    monkeypatch.setattr(process_watch, "PERIOD_S", 0.0)
    child = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    try:
        watch = ProcessWatch(lambda: {"child": child.pid, "me": os.getpid()})
        assert [name for name, _ in watch.samples()] == [CONDUCTOR, "child", "me"]
    finally:
        child.communicate(b"\n")
    assert [name for name, _ in watch.samples()] == [CONDUCTOR, "me"]
