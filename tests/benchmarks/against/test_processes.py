"""A command's processor time includes its descendants', and nothing of it is left behind."""

import subprocess
import sys
import time

import psutil
import pytest

from bench.benchmarks.against.processes import Command, Watch, descendants

BURN = "import time\nwhile time.process_time() < 0.5: pass"
PARENT = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {BURN!r}])"
# The child has a session of its own, as a bench's fork server has.
SLEEPER = (
    "import signal, subprocess, sys, time; signal.signal(signal.SIGINT, signal.{}); "
    "subprocess.Popen(['sleep', '60'], start_new_session=True); time.sleep(60)"
)


def python(code):
    return [sys.executable, "-c", code]


def test_processor_time_includes_descendants():
    with Command(python(PARENT)) as running:
        running.wait()
    assert running.returncode == 0
    assert running.cpu_s >= 0.5


def test_processes_are_sampled_one_by_one():
    with Command(python(PARENT)) as running, Watch(running.pid) as watch:
        running.wait()
    assert running.pid in watch.usages
    burned = max(watch.usages.values(), key=lambda usage: usage.user_s[-1])
    assert burned is not watch.usages[running.pid]
    assert burned.user_s == sorted(burned.user_s)
    assert len(burned.at_ns) == len(burned.user_s) == len(burned.system_s)
    assert burned.peak_bytes >= burned.shared_bytes > 1_000_000


@pytest.mark.parametrize("on_interrupt", ["SIG_DFL", "SIG_IGN"])
def test_leaving_the_context_ends_the_command_and_its_descendants(on_interrupt, monkeypatch):
    monkeypatch.setattr("bench.benchmarks.against.processes.GRACE_S", 0.2)
    with Command(python(SLEEPER.format(on_interrupt))) as running:
        while not descendants(running.pid):
            time.sleep(0.05)
        started = [psutil.Process(running.pid), *descendants(running.pid)]
    assert running.returncode is not None
    assert not psutil.wait_procs(started, timeout=30)[1]


def test_a_command_that_does_not_exist_is_an_error():
    with pytest.raises(FileNotFoundError):
        Command(["/nonsense"], stdout=subprocess.DEVNULL)
