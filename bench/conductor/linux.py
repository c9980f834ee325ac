"""Requests to the Linux kernel about processes; skipped on other systems."""

import ctypes
import errno
import fcntl
import os
import signal
import sys
import time
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import NamedTuple

_PR_SET_PDEATHSIG = 1
_PR_SET_NAME = 15
_TIMER_ABSTIME = 1
_LIBC = ctypes.CDLL(None)

SLEEP_NS = 20_000
"""Shorter waits are busy: going to sleep and waking up takes as long."""


class _Timespec(ctypes.Structure):
    _fields_ = (("tv_sec", ctypes.c_long), ("tv_nsec", ctypes.c_long))


def die_with_parent() -> None:
    """Have the kernel kill this process as soon as its parent is dead. The lifeline does the same, but later."""
    _prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


def set_name(name: str) -> None:
    """Name this process (15 characters) for ps and top."""
    _prctl(_PR_SET_NAME, name.encode())


def is_stopped(pid: int) -> bool:
    """Whether a process has been stopped by a signal (SIGSTOP), or by a debugger."""
    return _stat_after_name(pid)[:1] in (["T"], ["t"])


@contextmanager
def as_batch_work() -> Iterator[None]:
    """Do not interrupt others when woken: this thread, and the processes it starts meanwhile (SCHED_BATCH, sched(7)).

    A bench has more processes than the machine has cores. Woken by each frame, they would keep interrupting the
    senders; instead they find several frames when scheduled, which shortens a cycle by a fifth.
    """
    try:
        changed = sys.platform == "linux" and os.sched_getscheduler(0) == os.SCHED_OTHER
        if changed:
            os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
    except OSError:
        # Some containers forbid the call; everything works without it.
        changed = False
    try:
        yield
    finally:
        if changed:
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


@contextmanager
def give_way() -> Iterator[None]:
    """Run this process, with all its threads, at idle priority (SCHED_IDLE, sched(7))."""
    _schedule_all_threads("SCHED_IDLE")
    try:
        yield
    finally:
        _schedule_all_threads("SCHED_OTHER")


def _schedule_all_threads(policy: str) -> None:
    for thread in os.listdir("/proc/self/task") if sys.platform == "linux" else ():  # noqa: PTH208 - numbers, not paths
        # If forbidden, as in some containers, everything works without it; and a thread may have ended.
        with suppress(OSError):
            os.sched_setscheduler(int(thread), getattr(os, policy), os.sched_param(0))


def set_real_time(pid: int, priority: int) -> bool:
    """Run a process before all others of lower `priority` (1..99) until it waits (SCHED_FIFO, sched(7)).

    Returns whether that is permitted; it takes root, CAP_SYS_NICE or a limit on real-time priorities (ulimit -r).
    """
    try:
        os.sched_setscheduler(pid, os.SCHED_FIFO, os.sched_param(priority))
    except (AttributeError, PermissionError):
        return False
    except ProcessLookupError:
        # It has ended; its monitor will notice.
        return True
    return True


@contextmanager
def real_time(priority: int) -> Iterator[None]:
    """The same for this process during the context."""
    before = (os.sched_getscheduler(0), os.sched_getparam(0)) if sys.platform == "linux" else None
    granted = set_real_time(0, priority)
    try:
        yield
    finally:
        if granted and before:
            os.sched_setscheduler(0, *before)


def pin(pid: int, cores: Collection[int]) -> None:
    """Restrict a process to these cores; if that is not permitted, it stays unrestricted."""
    with suppress(OSError):
        os.sched_setaffinity(pid, cores)


def enlarge_pipe(descriptor: int) -> None:
    """Let a pipe hold 1 MiB, so that its writers do not block if the reader is a second behind."""
    if sys.platform == "linux":
        with suppress(OSError):
            fcntl.fcntl(descriptor, fcntl.F_SETPIPE_SZ, 1 << 20)


def stolen_s() -> float:
    """Return the processor time in s that a virtual machine's host has given to others when this machine wanted it.

    It is the steal time of proc(5), of all cores together since this machine started; 0 if the kernel does not report
    it.
    """
    try:
        with open("/proc/stat") as stat:  # noqa: PTH123 - as quick as it can be
            return int(stat.readline().split()[8]) / os.sysconf("SC_CLK_TCK")
    except (OSError, IndexError, ValueError):
        return 0.0


def dropped_datagrams(pids: Mapping[str, int]) -> dict[str, int]:
    """Return the number of UDP datagrams that the kernel has dropped before processes read them, by name; none if 0.

    Args:
        pids: process numbers by name; one that has ended has none.
    """
    try:
        rows = [line.split() for line in Path("/proc/net/udp").read_text().splitlines()[1:]]
    except OSError:
        return {}
    drops = {f"socket:[{row[9]}]": int(row[12]) for row in rows if len(row) > 12}
    found = {name: sum(drops.get(each, 0) for each in _descriptors(pid)) for name, pid in pids.items()}
    return {name: count for name, count in found.items() if count}


def _descriptors(pid: int) -> set[str]:
    """Return what a process has open; empty if that cannot be told."""
    with suppress(OSError):
        return {str(each.readlink()) for each in Path(f"/proc/{pid}/fd").iterdir()}
    return set()


def wait_until(time_ns: int) -> None:
    """Sleep until the time.monotonic_ns() clock shows `time_ns`; awake if it is near, at once where it is past that."""
    while (left := time_ns - time.monotonic_ns()) > 0:
        if left > SLEEP_NS:
            _sleep_until(time_ns)


def _sleep_until(time_ns: int) -> None:
    # With an absolute time, an interruption between reading the clock and sleeping makes no difference.
    if sys.platform != "linux":
        time.sleep(max(0, time_ns - time.monotonic_ns()) / 1e9)
        return
    deadline = _Timespec(*divmod(time_ns, 1_000_000_000))
    while _LIBC.clock_nanosleep(time.CLOCK_MONOTONIC, _TIMER_ABSTIME, ctypes.byref(deadline), None) == errno.EINTR:
        # Python handles the signal here.
        pass


def _prctl(request: int, argument: int | bytes) -> None:
    if sys.platform == "linux":
        _LIBC.prctl(request, argument, 0, 0, 0)


def processor_time(pid: int) -> float:
    """Return the processor time of a process in s; 0 if it has ended."""
    return sum(map(int, _stat_after_name(pid)[11:13])) / os.sysconf("SC_CLK_TCK")


class Taken(NamedTuple):
    """What a process has taken of the machine.

    Attributes:
        processor_s: its processor time in s, user and system.
        memory: its resident memory in bytes.
        preemptions: how often others took its processor (involuntary context switches).
    """

    processor_s: float
    memory: int
    preemptions: int


def taken(pid: int) -> Taken | None:
    """Return what a process has taken of the machine; None if it has ended."""
    try:
        status = Path(f"/proc/{pid}/status").read_text(errors="replace")
    except OSError:
        return None
    lines = dict(line.partition(":")[::2] for line in status.splitlines())
    if "VmRSS" not in lines:
        # It has ended, but its parent does not know yet.
        return None
    memory_kib = lines["VmRSS"].split()[0]
    return Taken(processor_time(pid), int(memory_kib) * 1024, int(lines["nonvoluntary_ctxt_switches"]))


def _stat_after_name(pid: int) -> list[str]:
    """Return the fields of proc(5)'s /proc/PID/stat from the third, the state, on; empty if the process has ended."""
    with suppress(OSError):
        # The name, in parentheses, may contain any character.
        return Path(f"/proc/{pid}/stat").read_text(errors="replace").rpartition(")")[2].split()
    return []
