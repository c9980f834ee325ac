"""`platoon vcan -- COMMAND`: a command runs where CAN is as if it ran here. Starts real user-mode Linux kernels."""

import os
import signal
import socket
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

from bench.bus.link.kernel_links import lack_of_can
from bench.errors import BadInput
from bench.vcan import machine

ROOT = Path(__file__).parents[2]
PLATOON = [sys.executable, "-m", "bench.cli", "vcan", "--"]
LIMIT_S = 240.0

pytestmark = [
    pytest.mark.skipif(not lack_of_can(), reason="this kernel has CAN, so the command runs here"),
    pytest.mark.skipif(bool(machine.lacking_packages()), reason="user-mode Linux is not installed"),
]


def environment() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": str(ROOT)}


def run(*command: str, cwd: Path, stdin: bytes = b"") -> subprocess.CompletedProcess[bytes]:
    return subprocess.run(
        [*PLATOON, *command], cwd=cwd, env=environment(), input=stdin, capture_output=True, timeout=LIMIT_S, check=False
    )


def kernel_of(process: subprocess.Popen[bytes]) -> int:
    """Process group of the kernel that a running `platoon vcan` has started."""
    for folder in Path("/proc").iterdir():
        with suppress(OSError):
            if folder.name.isdigit() and b"rootfstype=hostfs" in (folder / "cmdline").read_bytes():
                parent, group = (folder / "stat").read_text().rpartition(")")[2].split()[1:3]
                if int(parent) == process.pid:
                    return int(group)
    raise AssertionError("there is no kernel")


def started_kernel(process: subprocess.Popen[bytes]) -> int:
    """The same, as soon as there is one."""
    while process.poll() is None:
        with suppress(AssertionError):
            return kernel_of(process)
        time.sleep(0.01)
    raise AssertionError("the command ended without a kernel")


def assert_gone(group: int) -> None:
    """Nothing of a kernel is left, or will be soon."""
    end = time.monotonic() + 60.0
    while True:
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return
        assert time.monotonic() < end, f"there are processes of group {group} left"
        time.sleep(0.05)


def test_streams_status_directory_and_environment_are_the_callers(tmp_path: Path) -> None:
    script = (
        "import os, sys, socket\n"
        "data = sys.stdin.buffer.read()\n"
        "sys.stdout.buffer.write(bytes(range(256)) * 40_000 + data)\n"
        "sys.stderr.write(os.getcwd() + ' ' + os.environ['PYTHONPATH'])\n"
        "socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW).bind(('vcan16',))\n"
        "open('made', 'w').write('here')\n"
        "sys.exit(7)\n"
    )
    done = run(sys.executable, "-c", script, cwd=tmp_path, stdin=b"and the end\r\n\x00")
    assert done.returncode == 7
    assert done.stdout == bytes(range(256)) * 40_000 + b"and the end\r\n\x00"
    assert done.stderr.decode() == f"{tmp_path} {ROOT}"
    assert (tmp_path / "made").read_text() == "here"


def test_a_person_at_a_terminal_is_told_that_the_kernel_takes_long(tmp_path: Path) -> None:
    ours, terminal = os.openpty()
    command = [*PLATOON, "echo", "it runs"]
    with subprocess.Popen(command, cwd=tmp_path, env=environment(), stderr=terminal, stdout=subprocess.PIPE) as process:
        os.close(terminal)
        kernel = started_kernel(process)
        os.killpg(kernel, signal.SIGSTOP)
        assert b"waiting for a kernel with CAN" in os.read(ours, 4096)
        os.killpg(kernel, signal.SIGCONT)
        assert process.communicate(timeout=LIMIT_S)[0] == b"it runs\n"
    os.close(ours)


def test_a_command_that_a_signal_ends_has_the_shells_status(tmp_path: Path) -> None:
    assert run("sh", "-c", "kill -KILL $$", cwd=tmp_path).returncode == 128 + signal.SIGKILL


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_reaches_the_command(tmp_path: Path, number: signal.Signals) -> None:
    script = "trap 'echo got it; exit 42' INT TERM; echo ready; while :; do sleep 0.1; done"
    command = [*PLATOON, "sh", "-c", script]
    place = tmp_path / "tmp"
    place.mkdir()
    there = environment() | {"TMPDIR": str(place)}
    with subprocess.Popen(command, cwd=tmp_path, env=there, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"ready\n"
        kernel = kernel_of(process)
        process.send_signal(number)
        assert process.stdout.read() == b"got it\n"
        assert process.wait(LIMIT_S) == 42
    assert_gone(kernel)
    assert list(place.iterdir()) == []


def test_nothing_is_left_of_one_that_is_killed(tmp_path: Path) -> None:
    place = tmp_path / "tmp"
    place.mkdir()
    command = [*PLATOON, "sh", "-c", "echo ready; sleep 1000"]
    there = environment() | {"TMPDIR": str(place)}
    with subprocess.Popen(command, cwd=tmp_path, env=there, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"ready\n"
        kernel = kernel_of(process)
        process.kill()
    assert_gone(kernel)
    assert list(place.iterdir()) == []


def test_no_such_command_is_said_before_anything_starts(tmp_path: Path) -> None:
    done = run("no-such-command", cwd=tmp_path)
    assert done.returncode == 2
    assert b"there is no command 'no-such-command'" in done.stderr


def test_missing_packages_are_named_in_one_message(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr(machine, "_SYSTEM_PATH", str(tmp_path))
    with pytest.raises(BadInput) as refusal:
        machine.require_packages()
    assert "apt-get install --no-install-recommends user-mode-linux kmod iproute2" in str(refusal.value)


def test_this_kernel_has_no_can_itself() -> None:
    with pytest.raises(OSError, match="not supported"):
        socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW)
