"""Requests to the kernel about processes."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from bench.conductor.linux import as_batch_work

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
