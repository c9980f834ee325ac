"""The process from which the plant and the ECUs are forked, so that shared modules are imported once.

`platoon run` forks it from itself before it opens anything, so what both need is imported once for all processes of a
run. A program that calls `bench.conductor.run` has modules and threads of its own, so there it is a fresh interpreter.
It imports the built-in ECUs while the conductor opens the buses, forks the children when their `Setup` comes, and then
reports every child that ends; when the conductor ends, it kills the remaining children.

Not multiprocessing's forkserver: that runs the conductor's main module again in every child, which would bring the
command line and the plant into each ECU, and has the environment of the conductor, whose numpy may use many threads.
"""

import faulthandler
import gc
import importlib
import io
import os
import pickle
import select
import signal
import socket
import sys
import traceback
import warnings
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

from bench.bus.control_channel import ControlChannel, Kind
from bench.conductor.linux import as_batch_work, die_with_parent, set_name
from bench.errors import BenchError, shortage

NAME = "fork server"
"""Its name, in messages and in the list of processes."""

THREADS = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")
"""Its environment: one thread in each library."""

_MOST_DESCRIPTORS = 253
"""Descriptors that Linux passes in one message (SCM_MAX_FD)."""

_format_warning = warnings.formatwarning
"""As the interpreter shows warnings; the command line shows them as messages of its own."""


@dataclass(frozen=True)
class Child:
    """A process to be forked.

    Attributes:
        name: name in messages.
        target: `module:function`, called with the child's `ControlChannel` and the arguments.
        arguments: pickled tuple; only the child unpickles it, with the imports required.
        on_call: whether it is forked only on request.
    """

    name: str
    target: str
    arguments: bytes
    on_call: bool = False


@dataclass(frozen=True)
class Setup:
    """The input of a fork server.

    It comes with these file descriptors, in this order: the pickled setup itself, the writing end of the pipe for
    reports, the reading end of the pipe with the names of children to be forked on request (a line each), the fault
    board, and for each child the one for its standard output and error.

    Attributes:
        children: the processes to be forked.
        preload: ECU classes to import before forking, see `bench.ecu.loading.load_class`.
    """

    children: tuple[Child, ...]
    preload: tuple[str, ...]


def main() -> None:
    """Run a fork server in a fresh interpreter.

    Its arguments are the conductor's process number and the built-in ECU classes to import at once; its standard input
    is the socket to the conductor.
    """
    lifeline = socket.socket(fileno=os.dup(0))
    sys.exit(serve(lifeline, int(sys.argv[1]), sys.argv[2:]))


def serve_forked(lifeline: socket.socket, words: int, conductor: int, early: Sequence[str]) -> int:
    """Run a fork server in a child of the conductor, after making it as a new program would be; return the exit code.

    Args:
        lifeline: as of `serve`.
        words: file descriptor for its standard output and error.
        conductor: as of `serve`.
        early: as of `serve`.
    """
    os.setsid()
    signal.set_wakeup_fd(-1)
    for number in signal.valid_signals():
        if callable(signal.getsignal(number)):
            signal.signal(number, signal.SIG_DFL)
    os.dup2(words, 1)
    os.dup2(words, 2)
    for descriptor in map(int, os.listdir("/proc/self/fd")):  # noqa: PTH208 - numbers, not paths
        if descriptor > 2 and descriptor != lifeline.fileno():
            # The one of the list itself is closed already.
            with suppress(OSError):
                os.close(descriptor)
    sys.stdout = open(1, "w", closefd=False)  # noqa: SIM115 - a descriptor has no path; it stays open
    sys.stderr = open(2, "w", buffering=1, errors="backslashreplace", closefd=False)  # noqa: SIM115
    sys.argv[:] = ["-c"]
    os.environ.update(THREADS)
    warnings.formatwarning = _format_warning
    return serve(lifeline, conductor, early)


def serve(lifeline: socket.socket, conductor: int, early: Sequence[str]) -> int:
    """Run a fork server; return the exit code.

    Args:
        lifeline: a socket to the conductor, which brings the `Setup` and ends when the conductor ends.
        conductor: process number of the conductor.
        early: built-in ECU classes to import before the setup comes.
    """
    die_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    null = os.open(os.devnull, os.O_RDONLY)
    os.dup2(null, 0)
    os.close(null)
    if os.getppid() != conductor:
        return 0
    set_name(NAME)
    try:
        with as_batch_work():
            _preload(early)
            _, descriptors, _, _ = socket.recv_fds(lifeline, 1, _MOST_DESCRIPTORS, socket.MSG_CMSG_CLOEXEC)
            if descriptors:
                _ForkServer(lifeline.fileno(), descriptors).run()
    except BenchError as error:
        sys.stderr.write(f"{error}\n")
        return 1
    except OSError as error:
        sys.stderr.write((shortage(error) or f"{type(error).__name__}: {error}") + "\n")
        return 1
    return 0


def _preload(classes: Sequence[str]) -> None:
    # Not at the top: the conductor does not need these imports.
    from bench.bus.codec import load_codecs
    from bench.ecu.loading import load_classes

    # Reads and caches the DBC files.
    load_codecs(1)
    importlib.import_module("bench.ecu.main")
    # Every link of the bus udp needs it; without it, the link says so.
    with suppress(ImportError):
        importlib.import_module("msgpack")
    load_classes(classes)


class _ForkServer:
    def __init__(self, lifeline: int, descriptors: Sequence[int]) -> None:
        content, reports, self._orders, board, *self._stderrs = descriptors
        with open(content, "rb") as file:  # noqa: PTH123 - a descriptor has no path
            self._setup: Setup = pickle.load(file)
        self._channel = ControlChannel(lifeline, reports, board)
        self._alive: dict[int, str] = {}
        # A child killed by a fault may be forked again, so the pipes for standard errors stay open here.
        # A child's end wakes the fork server through this pipe.
        self._wake, self._waker = os.pipe()
        os.set_blocking(self._waker, False)
        os.set_blocking(self._wake, False)

    def run(self) -> None:
        signal.signal(signal.SIGCHLD, lambda *_: None)
        signal.set_wakeup_fd(self._waker, warn_on_full_buffer=False)
        _preload(self._setup.preload)
        # Imported objects stay: garbage collection can skip them in all children.
        gc.freeze()
        gc.enable()
        self._fork([child.name for child in self._setup.children if not child.on_call])
        while True:
            ready, _, _ = select.select([self._wake, self._channel.lifeline, self._orders], [], [])
            if self._channel.lifeline in ready:
                self._kill()
                return
            if self._wake in ready:
                os.read(self._wake, 4096)
                self._reap()
            if self._orders in ready:
                self._fork(os.read(self._orders, 4096).decode().split())

    def _fork(self, names: Sequence[str]) -> None:
        own_pid = os.getpid()
        for child, stderr in zip(self._setup.children, self._stderrs, strict=True):
            if child.name not in names:
                continue
            pid = os.fork()
            if pid == 0:
                code = 1
                try:
                    die_with_parent()
                    if os.getppid() == own_pid:
                        os.close(self._orders)
                        code = _run(child, stderr, self._channel, self._stderrs)
                finally:
                    # Whatever happened, this process must not continue as a second fork server.
                    os._exit(code)
            self._alive[pid] = child.name
            self._channel.report(Kind.STARTED, {"name": child.name, "pid": pid})

    def _reap(self) -> None:
        while self._alive:
            pid, status = os.waitpid(-1, os.WNOHANG)
            if pid == 0:
                return
            name = self._alive.pop(pid)
            code = os.waitstatus_to_exitcode(status)
            self._channel.report(Kind.ENDED, {"name": name, "pid": pid, "code": code})

    def _kill(self) -> None:
        for pid in self._alive:
            os.kill(pid, signal.SIGKILL)
        for pid in self._alive:
            os.waitpid(pid, 0)


def _run(child: Child, stderr: int, channel: ControlChannel, stderrs: Sequence[int]) -> int:
    """Call the child's target; return the exit code. Errors are printed on standard error."""
    signal.set_wakeup_fd(-1)
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    os.dup2(stderr, 1)
    os.dup2(stderr, 2)
    for each in stderrs:
        os.close(each)
    set_name(child.name)
    # So that a crash in compiled code prints a traceback, and earlier output is not lost.
    faulthandler.enable()
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(line_buffering=True)
    module, _, function = child.target.partition(":")
    code = 1
    try:
        getattr(importlib.import_module(module), function)(channel, *pickle.loads(child.arguments))
        code = 0
    except BenchError as error:
        sys.stderr.write(f"{error}\n")
    except Exception as error:  # noqa: BLE001 - the last one who can say what happened
        lacking = shortage(error)
        if lacking:
            sys.stderr.write(f"{lacking}\n")
        else:
            traceback.print_exc()
    sys.stdout.flush()
    sys.stderr.flush()
    return code
