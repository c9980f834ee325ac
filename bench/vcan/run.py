"""Runs a command where there is CAN, as if it ran here: streams, signals and exit status pass through."""

import contextlib
import os
import selectors
import shutil
import signal
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import FrameType
from typing import IO

from bench.bus.link.kernel_links import check_links, lack_of_can, make_links
from bench.conductor.patience import SAY_S
from bench.errors import BadInput, BenchError, RunFailed
from bench.vcan import wire
from bench.vcan.guest import LINKS
from bench.vcan.machine import Machine
from bench.vcan.wire import Kind, Launch
from platoon_fmu.interpreter import interpreter

MEMORY_MB = 2048

_FORWARDED = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGUSR1, signal.SIGUSR2)
_OUT, _ERR = 1, 2
_CHUNK_BYTES = 65_536


class Interrupted(BenchError):
    """A signal came while the machine was still starting."""

    def __init__(self, number: int) -> None:
        super().__init__(f"vcan: {signal.Signals(number).name} before the command had started")
        self.exit_code = 128 + number


def run_command(command: Sequence[str], memory_mb: int = MEMORY_MB) -> int:
    """Run a command where vcan0 to vcan16 are, and return its exit status as a shell has it.

    If this kernel has the links, or lets this process create them, the command replaces this process.

    Raises:
        BadInput: there is no such command, or neither this kernel nor a small one can provide CAN.
        RunFailed: the small kernel failed.
        Interrupted: it was told to end before the command ran.
    """
    environment = _environment()
    program = shutil.which(command[0], path=environment["PATH"])
    if program is None:
        raise BadInput(f"platoon vcan: there is no command {command[0]!r}")
    if _is_here():
        os.execve(program, list(command), environment)
    launch = Launch([program, *command[1:]], environment, str(Path.cwd()), _umask())
    with _signals() as arrived, Machine(memory_mb) as machine:
        return Session(machine, arrived).run(launch)


def _is_here() -> bool:
    """Whether the links exist, created if permitted."""
    if lack_of_can():
        return False
    make_links(LINKS)
    try:
        check_links(LINKS)
    except BadInput:
        return False
    return True


def _environment() -> dict[str, str]:
    """Return the caller's environment, in which this installation's commands are found even where it is not active."""
    path = os.environ.get("PATH", os.defpath)
    return {**os.environ, "PATH": os.pathsep.join([path, str(Path(interpreter()[0]).parent)])}


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


@contextlib.contextmanager
def _signals() -> Iterator[int]:
    """Yield a file descriptor from which the numbers of arriving signals are read, one byte each."""
    arrived, wakeup = os.pipe()
    os.set_blocking(wakeup, False)

    def note(number: int, _frame: FrameType | None) -> None:
        """Leave it to the wakeup descriptor."""

    previous = {number: signal.signal(number, note) for number in _FORWARDED}
    # Reading a terminal in the background must fail instead of stopping us.
    previous[signal.SIGTTIN] = signal.signal(signal.SIGTTIN, signal.SIG_IGN)
    before = signal.set_wakeup_fd(wakeup, warn_on_full_buffer=False)
    try:
        yield arrived
    finally:
        signal.set_wakeup_fd(before)
        for number, handler in previous.items():
            signal.signal(number, handler)
        os.close(arrived)
        os.close(wakeup)


class Session:
    """One command in one machine."""

    def __init__(self, machine: Machine, arrived: int) -> None:
        """Take the machine, and the descriptor that signals come from."""
        self._machine = machine
        self._arrived = arrived
        self._inlet = Inlet(sys.__stdin__, machine.control)
        self._runs = False
        self._ended: tuple[int, ...] | None = None
        self._selector = selectors.DefaultSelector()

    def run(self, launch: Launch) -> int:
        """Run the command to its end; return its exit status."""
        machine = self._machine
        outlets = [Outlet(machine.output, _OUT, machine.control), Outlet(machine.errors, _ERR, machine.control)]
        with self._selector as selector:
            selector.register(self._arrived, selectors.EVENT_READ, self._forward)
            selector.register(machine.answers, selectors.EVENT_READ, lambda: self._hear(launch))
            self._await_start()
            while machine.answers in selector.get_map():
                self._attend(None)
        # The machine has ended, and with it all that it could send.
        written = [outlet.finish() for outlet in outlets]
        machine.wait()
        if self._ended is None:
            raise RunFailed(f"vcan: user-mode Linux ended too early; its last output:\n{machine.last_words()}")
        status, *sent = self._ended
        if sent != written:
            raise RunFailed(f"vcan: the command wrote {sent} bytes of output and errors, but {written} came")
        return status

    def _await_start(self) -> None:
        """Attend until the command runs or the machine has ended; say so on a terminal if that takes long.

        Only there, since standard error is the command's.
        """
        say_at = time.monotonic() + SAY_S if os.isatty(_ERR) else None
        while not self._runs and self._machine.answers in self._selector.get_map():
            if say_at is not None and time.monotonic() >= say_at:
                wire.write_all(_ERR, b"waiting for a kernel with CAN (user-mode Linux) to start ...\n")
                say_at = None
            self._attend(None if say_at is None else max(0.0, say_at - time.monotonic()))

    def _attend(self, limit_s: float | None) -> None:
        for key, _ in self._selector.select(limit_s):
            key.data()

    def _hear(self, launch: Launch) -> None:
        message = wire.read(self._machine.answers)
        if message is None:
            self._selector.unregister(self._machine.answers)
            return
        kind, payload = message
        if kind is Kind.READY:
            self._machine.forget_files()
            wire.write(self._machine.control, Kind.LAUNCH, launch.encode())
            self._runs = True
            self._inlet.start()
        elif kind is Kind.TAKEN:
            self._inlet.allow(wire.numbers_of(payload)[0])
        elif kind is Kind.FAILED:
            raise BadInput(f"platoon vcan: {payload.decode()}")
        elif kind is Kind.ENDED:
            self._ended = wire.numbers_of(payload)

    def _forward(self) -> None:
        for number in os.read(self._arrived, 64):
            if number not in _FORWARDED:
                continue
            if not self._runs:
                raise Interrupted(number)
            # The machine may have gone already.
            with contextlib.suppress(BrokenPipeError):
                wire.write_numbers(self._machine.control, Kind.SIGNAL, number)


class Inlet:
    """Sends standard input to the command, in a thread, with flow control."""

    def __init__(self, source: IO[str] | None, control: int) -> None:
        """Take the stream, if there is one, and the descriptor of the control line."""
        self._source = source
        self._control = control
        self._room = wire.WINDOW_BYTES
        self._changed = threading.Condition()

    def start(self) -> None:
        """Begin; the command must have been launched."""
        threading.Thread(target=self._run, daemon=True).start()

    def allow(self, count: int) -> None:
        """Note that the command has taken so many bytes."""
        with self._changed:
            self._room += count
            self._changed.notify()

    def _run(self) -> None:
        data = b"-"
        while data:
            with self._changed:
                self._changed.wait_for(lambda: self._room >= wire.MOST_BYTES)
            data = self._read()
            with self._changed:
                self._room -= len(data)
            try:
                wire.write(self._control, Kind.INPUT, data)
            except OSError:
                # The machine has ended.
                return

    def _read(self) -> bytes:
        if self._source is None:
            return b""
        try:
            return os.read(self._source.fileno(), wire.MOST_BYTES)
        except (OSError, ValueError):
            # Closed, or a terminal of which this is not the foreground.
            return b""


class Outlet:
    """Forwards one output of the command to this process's own, in a thread: either may be read late, or never."""

    def __init__(self, source: int, target: int, control: int) -> None:
        self._source, self._target, self._control = source, target, control
        self._came = 0
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def finish(self) -> int:
        """Wait for the end of the output; return how many bytes came."""
        self._thread.join()
        return self._came

    def _run(self) -> None:
        is_read = True
        while data := os.read(self._source, _CHUNK_BYTES):
            self._came += len(data)
            if is_read:
                try:
                    wire.write_all(self._target, data)
                except OSError:
                    # The command is told as it would be told here, once it writes more.
                    is_read = False
                    with contextlib.suppress(OSError):
                        wire.write_numbers(self._control, Kind.CLOSED, self._target)
        os.close(self._source)
