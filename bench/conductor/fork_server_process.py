"""A fork server as its conductor sees it: how it is started, set up and ended."""

import os
import select
import signal
import socket
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from types import TracebackType
from typing import Protocol, Self

from bench.conductor.fork_server import THREADS, serve_forked
from platoon_fmu.interpreter import python

END_S = 1.0
"""Wall-clock time in s that it has to end its children and itself, before it is killed."""


class _Process(Protocol):
    """A child of this process, see `subprocess.Popen`."""

    @property
    def pid(self) -> int: ...

    def send_signal(self, sig: int, /) -> None: ...

    def wait(self, timeout: float | None = None) -> int: ...


class ForkServer:
    """A running fork server. A context manager: at its end, it and its children have ended.

    Attributes:
        pid: its process number.
        words: reading end of the pipe with its standard output and error.
    """

    def __init__(self, process: _Process, lifeline: socket.socket, words: int) -> None:
        """Take over `process`, this end of its lifeline, and `words`."""
        self.pid = process.pid
        self.words = words
        self._process = process
        self._lifeline = lifeline

    def __enter__(self) -> Self:
        """Return the fork server itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End it."""
        self.end_children()
        self.end()

    def set_up(self, descriptors: Sequence[int]) -> None:
        """Give it what it is to fork: the descriptors of `bench.conductor.fork_server.Setup`."""
        # It may have ended, which its closed pipes tell.
        with suppress(BrokenPipeError, ConnectionResetError):
            socket.send_fds(self._lifeline, [b"."], descriptors)

    def resume(self) -> None:
        """Let it go on if somebody has stopped it (SIGSTOP)."""
        self._process.send_signal(signal.SIGCONT)

    def end_children(self) -> None:
        """Have it kill its children and end."""
        self._lifeline.close()

    def end(self) -> None:
        """Wait until it has ended, after `end_children`; idempotent."""
        if self.words < 0:
            return
        try:
            self._process.wait(END_S)
        except subprocess.TimeoutExpired:
            # Its children die with it.
            self._process.send_signal(signal.SIGKILL)
            self._process.wait()
        os.close(self.words)
        self.words = -1


def start_fork_server(early: Sequence[str]) -> ForkServer:
    """Start a fork server as a fresh interpreter.

    Args:
        early: built-in ECU classes that it is to import at once.

    Raises:
        OSError: the system does not permit another process.
    """
    ours, theirs = socket.socketpair()
    words, stderr = os.pipe()
    os.set_blocking(words, False)
    try:
        process = python(
            "bench.conductor.fork_server",
            str(os.getpid()),
            *early,
            settings=THREADS,
            stdin=theirs,
            stdout=stderr,
            stderr=stderr,
            # Ctrl-C in a terminal signals all processes of its group: only the conductor handles it.
            start_new_session=True,
        )
    except OSError:
        ours.close()
        os.close(words)
        raise
    finally:
        theirs.close()
        os.close(stderr)
    return ForkServer(process, ours, words)


def fork_server(early: Sequence[str]) -> ForkServer:
    """Fork a fork server from this process, which shares with it what it has imported; else as `start_fork_server`.

    Only a process without threads can be forked safely. It must not have opened what the fork server's children could
    do harm to, and its libraries must have been told to use one thread (`THREADS`).

    Args:
        early: as of `start_fork_server`.
    """
    # numpy's threads are not Python's.
    if sys.platform != "linux" or len(os.listdir("/proc/self/task")) > 1:  # noqa: PTH208 - numbers, not paths
        return start_fork_server(early)
    ours, theirs = socket.socketpair()
    words, stderr = os.pipe()
    os.set_blocking(words, False)
    sys.stdout.flush()
    sys.stderr.flush()
    conductor = os.getpid()
    try:
        pid = os.fork()
    except OSError:
        ours.close()
        os.close(words)
        raise
    finally:
        if os.getpid() == conductor:
            theirs.close()
            os.close(stderr)
    if pid == 0:
        code = 1
        try:
            code = serve_forked(theirs, stderr, conductor, early)
            sys.stdout.flush()
            sys.stderr.flush()
        finally:
            # Whatever happened, this process must not continue as a second conductor.
            os._exit(code)
    return ForkServer(_Forked(pid), ours, words)


class _Forked:
    """A forked child of this process, as `subprocess.Popen` has one that it has started."""

    def __init__(self, pid: int) -> None:
        self.pid = pid
        self._code: int | None = None
        self._descriptor = os.pidfd_open(pid)

    def send_signal(self, number: int, /) -> None:
        # Until it is waited for, its number belongs to no other process.
        if self._code is None:
            os.kill(self.pid, number)

    def wait(self, timeout: float | None = None) -> int:
        if self._code is None:
            if not select.select([self._descriptor], [], [], timeout)[0]:
                raise subprocess.TimeoutExpired("fork server", timeout or 0.0)
            os.close(self._descriptor)
            self._code = os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])
        return self._code
