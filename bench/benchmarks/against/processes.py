"""Commands that end with their context, and what the kernel says about the processes of a command.

A run's processor time is what the kernel charges for the command and all its descendants. What each process has used so
far is sampled while it runs, and so is its memory: these figures vanish with the process.
"""

import os
import re
import signal
import subprocess
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any

import psutil

SAMPLE_S = 0.1
"""Wall-clock time in s between two samples of all processes; one takes some 0.1 ms a process."""

LOOK_S = 0.5
"""Wall-clock time in s between two looks for new processes, for which all processes of the machine are gone through."""

SHARED_S = 1.0
"""Wall-clock time in s between two samples of the proportional memory, for which the kernel walks all pages."""

GRACE_S = 5.0
"""Wall-clock time in s that a command has to end after SIGINT."""

_TICK_S = 1.0 / os.sysconf("SC_CLK_TCK")


class Command:
    """A running command, in a session of its own; leaving the context ends it with all that it has started.

    Attributes:
        pid: its process.
        returncode: exit code; None while it runs.
        cpu_s: user and system time in s of the command and of all its descendants; 0 while it runs.
    """

    def __init__(self, command: Sequence[str | Path], **options: Any) -> None:
        """Start the command; `options` are those of `subprocess.Popen`."""
        # A session of its own, so that Ctrl-C reaches this process alone, which then ends the command.
        self._process = subprocess.Popen(command, start_new_session=True, stdin=subprocess.DEVNULL, **options)
        self.pid = self._process.pid
        self.returncode: int | None = None
        self.cpu_s = 0.0

    def __enter__(self) -> "Command":
        """Return it, running."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the command if it still runs."""
        if self.returncode is not None:
            return
        started = descendants(self.pid)
        self._signal(signal.SIGINT)
        until = time.monotonic() + GRACE_S
        while self.returncode is None and time.monotonic() < until:
            time.sleep(0.05)
            self._reap(os.WNOHANG)
        for process in started:
            with suppress(psutil.Error):
                process.kill()
        if self.returncode is None:
            self._signal(signal.SIGKILL)
            self._reap(0)

    def wait(self) -> None:
        """Wait until the command has ended."""
        self._reap(0)

    def _signal(self, number: int) -> None:
        # Not Popen.send_signal, which reaps a process that has ended; until that is done here, its number is its own.
        with suppress(ProcessLookupError):
            os.kill(self.pid, number)

    def _reap(self, flags: int) -> None:
        # Not Popen.wait, which does not tell the processor time.
        try:
            pid, status, usage = os.wait4(self.pid, flags)
        except ChildProcessError:
            # Ctrl-C came just after it had been reaped; nobody asks how it ended.
            self.returncode = self._process.returncode = -signal.SIGINT
            return
        if pid:
            self.cpu_s = usage.ru_utime + usage.ru_stime
            self.returncode = self._process.returncode = os.waitstatus_to_exitcode(status)


def descendants(pid: int) -> list[psutil.Process]:
    """Return the processes that a process, or one of these, has started; none if it has ended."""
    try:
        return psutil.Process(pid).children(recursive=True)
    except psutil.Error:
        return []


@dataclass
class Usage:
    """What one process has used, sampled.

    Attributes:
        name: as the kernel shows it, e.g. veh1.tracker.
        at_ns: times of the samples (ns since 1970).
        user_s, system_s: processor time since the process started, at those times.
        peak_bytes: peak resident memory.
        shared_bytes: largest proportional memory (PSS): a page that n processes share counts 1/n.
    """

    name: str
    at_ns: list[int] = field(default_factory=list)
    user_s: list[float] = field(default_factory=list)
    system_s: list[float] = field(default_factory=list)
    peak_bytes: int = 0
    shared_bytes: int = 0


class Watch(threading.Thread):
    """Samples a process and its descendants while the context lasts.

    Attributes:
        usages: by process number.
    """

    def __init__(self, pid: int) -> None:
        """Watch this process."""
        super().__init__(daemon=True)
        self.usages: dict[int, Usage] = {}
        self._pid = pid
        self._ended = threading.Event()

    def __enter__(self) -> "Watch":
        """Begin."""
        self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End."""
        self._ended.set()
        self.join()

    def run(self) -> None:
        """Sample until the end of the context."""
        look = shared = 0.0
        members: list[int] = []
        while not self._ended.wait(SAMPLE_S):
            now = time.monotonic()
            if now >= look:
                members, look = [self._pid, *(each.pid for each in descendants(self._pid))], now + LOOK_S
            for pid in members:
                with suppress(OSError):
                    self._sample(pid)
                    if now >= shared:
                        self._sample_shared(pid)
            if now >= shared:
                shared = now + SHARED_S

    def _sample(self, pid: int) -> None:
        name, rest = _stat(pid)
        usage = self.usages.setdefault(pid, Usage(name))
        usage.name = name
        usage.at_ns.append(time.time_ns())
        usage.user_s.append(int(rest[11]) * _TICK_S)
        usage.system_s.append(int(rest[12]) * _TICK_S)
        usage.peak_bytes = max(usage.peak_bytes, _kilobytes(f"/proc/{pid}/status", "VmHWM") * 1024)

    def _sample_shared(self, pid: int) -> None:
        usage = self.usages[pid]
        usage.shared_bytes = max(usage.shared_bytes, _kilobytes(f"/proc/{pid}/smaps_rollup", "Pss") * 1024)


def _stat(pid: int) -> tuple[str, list[str]]:
    """Return a process's name, and the fields of proc(5)'s /proc/PID/stat from the third on."""
    head, _, rest = Path(f"/proc/{pid}/stat").read_text(errors="replace").rpartition(")")
    return head.partition("(")[2], rest.split()


def _kilobytes(file: str, key: str) -> int:
    found = re.search(rf"^{key}:\s+(\d+) kB", Path(file).read_text(), re.MULTILINE)
    return int(found[1]) if found else 0
