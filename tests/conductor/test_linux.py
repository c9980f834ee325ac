"""Requests to the kernel about processes."""

import fcntl
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from bench.conductor.linux import (
    as_batch_work,
    enlarge_pipe,
    pin,
    real_time,
    set_real_time,
    stolen_s,
    taken,
    wait_until,
)

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="only Linux takes these requests")


def test_batch_work_is_for_the_time_of_the_context_and_what_is_started_in_it() -> None:
    before = os.sched_getscheduler(0)
    tell = [sys.executable, "-c", "import os; print(os.sched_getscheduler(0))"]
    with as_batch_work():
        assert os.sched_getscheduler(0) == os.SCHED_BATCH
        assert int(subprocess.run(tell, capture_output=True, check=True).stdout) == os.SCHED_BATCH
    assert os.sched_getscheduler(0) == before


def test_a_policy_that_somebody_has_chosen_stays() -> None:
    with as_batch_work():
        with as_batch_work():
            assert os.sched_getscheduler(0) == os.SCHED_BATCH
        assert os.sched_getscheduler(0) == os.SCHED_BATCH


def test_a_process_is_named_and_dies_with_its_parent() -> None:
    code = """
import os, time
from pathlib import Path
from bench.conductor.linux import die_with_parent, set_name
if os.fork() == 0:
    die_with_parent()
    set_name("veh12.planner")
    print(Path("/proc/self/comm").read_text(), end="", flush=True)
    time.sleep(600)
os.wait()
"""
    root = Path(__file__).parents[2]
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, cwd=root) as parent:
        assert parent.stdout is not None
        assert parent.stdout.readline() == "veh12.planner\n"
        parent.kill()
        # The pipe ends only when the child, too, is gone.
        assert parent.communicate(timeout=60)[0] == ""


def test_waiting_ends_at_the_time_and_not_before() -> None:
    deadline = time.monotonic_ns() + 5_000_000
    wait_until(deadline)
    assert time.monotonic_ns() >= deadline
    # What is past is not waited for.
    wait_until(deadline - 10_000_000_000)


def test_a_process_goes_first_where_that_is_permitted() -> None:
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as child:
        before = os.sched_getscheduler(child.pid)
        granted = set_real_time(child.pid, 20)
        assert os.sched_getscheduler(child.pid) == (os.SCHED_FIFO if granted else before)
        if granted:
            assert os.sched_getparam(child.pid).sched_priority == 20
        pin(child.pid, {min(os.sched_getaffinity(0))})
        assert os.sched_getaffinity(child.pid) == {min(os.sched_getaffinity(0))}
        child.communicate(b"\n")
    assert set_real_time(child.pid, 20)  # It has ended, which is not for want of permission.


def test_this_process_goes_first_for_the_time_of_the_context() -> None:
    before = os.sched_getscheduler(0)
    granted = set_real_time(os.getpid(), 1)
    os.sched_setscheduler(0, before, os.sched_param(0))
    with real_time(1):
        assert os.sched_getscheduler(0) == (os.SCHED_FIFO if granted else before)
    assert os.sched_getscheduler(0) == before


def test_what_a_host_takes_only_grows() -> None:
    before = stolen_s()
    assert 0.0 <= before <= stolen_s()


def test_a_pipe_is_made_larger() -> None:
    reader, writer = os.pipe()
    before = fcntl.fcntl(writer, fcntl.F_GETPIPE_SZ)
    enlarge_pipe(reader)
    # An unprivileged user may have used up the pages that the system gives to pipes.
    assert fcntl.fcntl(writer, fcntl.F_GETPIPE_SZ) in (before, 1 << 20)
    os.close(reader)
    os.close(writer)


def test_a_process_that_has_ended_takes_nothing_even_while_its_parent_has_not_waited_for_it() -> None:
    child = subprocess.Popen(
        [sys.executable, "-c", "print(flush=True); input()"], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    assert child.stdout is not None
    child.stdout.readline()
    has = taken(child.pid)
    assert has is not None
    assert has.memory > 1_000_000
    assert has.preemptions >= 0
    assert child.stdin is not None
    child.stdin.close()
    os.waitid(os.P_PID, child.pid, os.WEXITED | os.WNOWAIT)
    assert taken(child.pid) is None
    child.wait()
    assert taken(child.pid) is None
