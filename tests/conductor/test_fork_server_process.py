"""A fork server is a process of its own, whether it was forked from the conductor or is a fresh interpreter."""

import os
import select
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from bench.conductor import fork_server_process
from bench.conductor.fork_server import NAME
from platoon_fmu.interpreter import python

FORK = """
import os, sys, warnings
from bench.conductor.fork_server_process import fork_server
def main():
    warnings.formatwarning = lambda *_, **__: "of the command\\n"
    opened = os.open(os.devnull, os.O_RDONLY)
    server = fork_server([])
    with server:
        print(server.pid, opened, flush=True)
        sys.stdin.readline()
"""


@pytest.fixture
def command(tmp_path: Path):
    """A program that has forked a fork server, and waits."""
    (tmp_path / "forking.py").write_text(FORK)
    path = f"{tmp_path}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"
    settings = {"PYTHONPATH": path, "OPENBLAS_NUM_THREADS": "1"}
    program = subprocess.Popen(
        [sys.executable, "-P", "-c", "from forking import main; main()"],
        env=os.environ | settings,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    yield program
    program.kill()
    program.communicate()


def _until(holds) -> None:
    while not holds():
        time.sleep(0.01)


def test_it_has_a_session_and_streams_of_its_own_and_nothing_that_its_parent_opened(command):
    pid, opened = map(int, command.stdout.readline().split())
    process = Path(f"/proc/{pid}")
    _until(lambda: (process / "comm").read_text().strip() == NAME)
    assert os.getsid(pid) == pid
    assert (process / "fd" / "0").readlink() == Path(os.devnull)
    assert str((process / "fd" / "1").readlink()).startswith("pipe:")
    assert not (process / "fd" / str(opened)).exists()
    command.communicate(b"\n")
    assert command.returncode == 0
    assert not process.exists()


def test_it_ends_with_its_parent(command):
    pid = int(command.stdout.readline().split()[0])
    command.kill()
    command.wait()
    _until(lambda: not Path(f"/proc/{pid}").exists())


def test_a_program_with_threads_gets_a_fresh_interpreter(monkeypatch):
    started = []
    monkeypatch.setattr(
        fork_server_process, "python", lambda *arguments, **options: started.append(1) or python(*arguments, **options)
    )
    reader, writer = os.pipe()
    waiting = threading.Thread(target=os.read, args=(reader, 1))
    waiting.start()
    try:
        with fork_server_process.fork_server([]) as server:
            assert started == [1]
            assert not select.select([server.words], [], [], 0.0)[0]
    finally:
        os.write(writer, b".")
        waiting.join()
        os.close(reader)
        os.close(writer)
