"""The process from which the plant and the ECUs are forked, so that shared modules are imported once.

The conductor starts it as a fresh interpreter. It forks the early children at once, imports the shared modules, forks
the other children, and then reports every child that ends; when the conductor ends, it kills the remaining children.

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
import sys
import traceback
from collections.abc import Sequence
from dataclasses import dataclass

from bench.bus.control_channel import ControlChannel, Kind
from bench.conductor.linux import die_with_parent, set_name
from bench.errors import BenchError, shortage


@dataclass(frozen=True)
class Child:
    """A process to be forked.

    Attributes:
        name: name in messages.
        target: `module:function`, called with the child's `ControlChannel` and the arguments.
        arguments: pickled tuple; only the child unpickles it, with the imports required.
        stderr: file descriptor for its standard output and error.
        early: whether it is forked before the shared imports, because it needs few of them.
        on_call: whether it is forked only on request.
    """

    name: str
    target: str
    arguments: bytes
    stderr: int
    early: bool
    on_call: bool = False


@dataclass(frozen=True)
class Setup:
    """The input of a fork server.

    Attributes:
        children: the processes to be forked.
        preload: ECU classes to import before forking, see `bench.ecu.loading.load_class`.
        reports: writing end of the pipe for reports.
        orders: reading end of the pipe with the names of children to be forked on request, a line each.
        board: file descriptor of the fault board.
        conductor: process number of the conductor.
    """

    children: tuple[Child, ...]
    preload: tuple[str, ...]
    reports: int
    orders: int
    board: int
    conductor: int


def main() -> None:
    """Run a fork server: its argument is the descriptor of its pickled setup, its standard input the lifeline."""
    die_with_parent()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with open(int(sys.argv[1]), "rb") as content:  # noqa: PTH123 - a descriptor has no path
        setup: Setup = pickle.load(content)
    lifeline = os.dup(0)
    with open(os.devnull) as null:  # noqa: PTH123 - a descriptor is wanted, not a path
        os.dup2(null.fileno(), 0)
    if os.getppid() != setup.conductor:
        return
    set_name("fork server")
    try:
        _ForkServer(setup, ControlChannel(lifeline, setup.reports, setup.board)).run()
    except BenchError as error:
        sys.exit(str(error))
    except OSError as error:
        sys.exit(shortage(error) or f"{type(error).__name__}: {error}")


class _ForkServer:
    def __init__(self, setup: Setup, channel: ControlChannel) -> None:
        self._setup = setup
        self._channel = channel
        self._alive: dict[int, str] = {}
        # A child killed by a fault may be forked again, so the pipes for standard errors stay open here.
        # A child's end wakes the fork server through this pipe.
        self._wake, self._waker = os.pipe()
        os.set_blocking(self._waker, False)
        os.set_blocking(self._wake, False)

    def run(self) -> None:
        signal.signal(signal.SIGCHLD, lambda *_: None)
        signal.set_wakeup_fd(self._waker, warn_on_full_buffer=False)
        self._fork([child for child in self._setup.children if child.early])
        self._preload()
        self._fork([child for child in self._setup.children if not (child.early or child.on_call)])
        while True:
            ready, _, _ = select.select([self._wake, self._channel.lifeline, self._setup.orders], [], [])
            if self._channel.lifeline in ready:
                self._kill()
                return
            if self._wake in ready:
                os.read(self._wake, 4096)
                self._reap()
            if self._setup.orders in ready:
                names = os.read(self._setup.orders, 4096).decode().split()
                self._fork([child for child in self._setup.children if child.name in names])

    def _preload(self) -> None:
        # Not at the top: the early children do not need these imports and need not wait for them.
        from bench.bus.codec import load_codecs
        from bench.ecu.loading import load_classes

        # Reads and caches the DBC files.
        load_codecs(1)
        load_classes(self._setup.preload)
        # Imported objects stay: garbage collection can skip them in all children.
        gc.collect()
        gc.freeze()

    def _fork(self, children: Sequence[Child]) -> None:
        own_pid = os.getpid()
        for child in children:
            pid = os.fork()
            if pid == 0:
                code = 1
                try:
                    die_with_parent()
                    if os.getppid() == own_pid:
                        os.close(self._setup.orders)
                        code = _run(child, self._channel, [other.stderr for other in self._setup.children])
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


def _run(child: Child, channel: ControlChannel, stderrs: Sequence[int]) -> int:
    """Call the child's target; return the exit code. Errors are printed on standard error."""
    signal.set_wakeup_fd(-1)
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    os.dup2(child.stderr, 1)
    os.dup2(child.stderr, 2)
    for stderr in stderrs:
        os.close(stderr)
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
