"""The first process in user-mode Linux: sets the machine up, runs one command, forwards its streams, and powers off.

Only the standard library is used, so that it starts at once. Whatever goes wrong before it is READY appears on the
kernel's console, which the caller shows.
"""

import contextlib
import ctypes
import os
import queue
import signal
import stat
import subprocess
import sys
import termios
import threading
import traceback
import tty
from pathlib import Path
from typing import IO

from bench.bus.link.kernel_links import make_links
from bench.vcan import wire
from bench.vcan.wire import Kind, Launch

LINKS = tuple(f"vcan{number}" for number in range(17))
"""One for v2v and one for each of up to 16 vehicles."""

CONTROL, OUTPUT, ERRORS = 1, 2, 3
"""Consoles of the machine: messages both ways, the command's standard output, its standard error."""

MODULES = ("net/can/can", "net/can/can-raw", "net/can/can-bcm", "drivers/net/can/dev/can-dev", "drivers/net/can/vcan")
"""can-bcm is for tools that send periodically (python-can, can-utils); the bench itself does not need it."""

MODULES_DIRECTORY = Path("/usr/lib/uml/modules")

_LIBC = ctypes.CDLL(None, use_errno=True)
_POWER_OFF = 0x4321FEDC
_NODES = {"null": (1, 3), "zero": (1, 5), "full": (1, 7), "random": (1, 8), "urandom": (1, 9), "tty": (5, 0)}
_NODES |= {f"tty{number}": (4, number) for number in (CONTROL, OUTPUT, ERRORS)}
_CHUNK_BYTES = 16_384
_FROM_TERMINAL = {signal.SIGINT, signal.SIGQUIT, signal.SIGHUP}


def main() -> None:
    """Act as the machine's first process; when it returns the machine is off."""
    try:
        _set_up()
        _serve()
    except BaseException:  # noqa: BLE001 - the kernel panics when its first process ends, and nobody reads why
        traceback.print_exc()
    finally:
        # What was written is still in this kernel's memory.
        os.sync()
        _LIBC.reboot(_POWER_OFF)


def _set_up() -> None:
    for kind, place in (("proc", "/proc"), ("sysfs", "/sys"), ("tmpfs", "/dev")):
        _mount(kind, place)
    os.umask(0)
    for name, numbers in _NODES.items():
        os.mknod(f"/dev/{name}", stat.S_IFCHR | 0o666, os.makedev(*numbers))
    for directory, kind in (("pts", "devpts"), ("shm", "tmpfs")):
        Path("/dev", directory).mkdir()
        _mount(kind, f"/dev/{directory}", "ptmxmode=0666" if kind == "devpts" else "mode=1777")
    for name, target in (("ptmx", "pts/ptmx"), ("fd", "/proc/self/fd")):
        Path("/dev", name).symlink_to(target)
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        Path("/dev", name).symlink_to(f"/proc/self/fd/{number}")
    os.environ["PATH"] = os.defpath + ":/usr/sbin:/sbin"
    kernel = MODULES_DIRECTORY / os.uname().release / "kernel"
    for module in MODULES:
        subprocess.run(["insmod", str(kernel / f"{module}.ko")], check=True)
    make_links(LINKS)
    # As on any machine with a network: multicast, which the bench's other bus uses, has somewhere to go.
    commands = b"link set lo up\nroute add 239.0.0.0/8 dev lo\n"
    subprocess.run(["ip", "-batch", "-"], input=commands, check=True)


def _mount(kind: str, place: str, options: str = "") -> None:
    if _LIBC.mount(kind.encode(), place.encode(), kind.encode(), 0, options.encode()):
        raise OSError(ctypes.get_errno(), os.strerror(ctypes.get_errno()), place)


def _open_console(number: int) -> int:
    """Open a console in raw mode."""
    console = os.open(f"/dev/tty{number}", os.O_RDWR | os.O_NOCTTY)
    tty.setraw(console)
    return console


def _serve() -> None:
    control = _open_console(CONTROL)
    wire.write(control, Kind.READY)
    message = wire.read(control)
    if message is None or message[0] is not Kind.LAUNCH:
        return
    launch = Launch.decode(message[1])
    try:
        command = _start(launch)
    except OSError as error:
        wire.write(control, Kind.FAILED, f"{error.filename}: {error.strerror}".encode(errors="replace"))
    else:
        status, sent = _hand_through(command, control)
        # The caller reads files that the command wrote as soon as it knows the status.
        os.sync()
        wire.write_numbers(control, Kind.ENDED, status, *sent)
    termios.tcdrain(control)


def _start(launch: Launch) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        launch.command,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        bufsize=0,
        cwd=launch.directory,
        env=launch.environment,
        umask=launch.umask,
        start_new_session=True,
    )


def _hand_through(command: subprocess.Popen[bytes], control: int) -> tuple[int, list[int]]:
    """Return the command's exit status as a shell has it, and how many bytes of its two outputs were forwarded."""
    pumps = [Pump(_take(command.stdout), OUTPUT), Pump(_take(command.stderr), ERRORS)]
    feeder = Feeder(_take(command.stdin), control)
    threading.Thread(target=_obey, args=(control, command.pid, feeder, pumps), daemon=True).start()
    status = _reap(command.pid)
    # The machine ends with its command, and with it everything the command left running.
    os.kill(-1, signal.SIGKILL)
    return status, [pump.finish() for pump in pumps]


def _take(stream: IO[bytes] | None) -> int:
    """Return a file descriptor of its own for one of the command's pipes."""
    if stream is None:
        raise ValueError("not a pipe")
    with stream:
        return os.dup(stream.fileno())


def _reap(pid: int) -> int:
    """Wait for a process and return its exit status; meanwhile reap orphans."""
    while True:
        ended, status = os.wait()
        if ended == pid:
            code = os.waitstatus_to_exitcode(status)
            return code if code >= 0 else 128 - code


def _obey(control: int, pid: int, feeder: "Feeder", pumps: "list[Pump]") -> None:
    """Carry out messages from the control line until the caller is gone."""
    while (message := wire.read(control)) is not None:
        kind, payload = message
        if kind is Kind.INPUT:
            feeder.put(payload)
        elif kind is Kind.CLOSED:
            pumps[wire.numbers_of(payload)[0] - 1].close()
        elif kind is Kind.SIGNAL:
            number = wire.numbers_of(payload)[0]
            # A terminal signals all processes of a command, `kill` the one process alone.
            with contextlib.suppress(ProcessLookupError):
                (os.killpg if number in _FROM_TERMINAL else os.kill)(pid, number)


class Pump:
    """Forwards one output of the command to a console until every writer has closed it."""

    def __init__(self, source: int, console: int) -> None:
        self._source = source
        self._console = _open_console(console)
        self._sent = 0
        self._closed = False
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def close(self) -> None:
        """Let the command notice, by its second next write, that nobody reads this."""
        self._closed = True

    def finish(self) -> int:
        """Wait until everything is forwarded; return the number of bytes."""
        self._thread.join()
        termios.tcdrain(self._console)
        os.close(self._console)
        return self._sent

    def _run(self) -> None:
        while (data := os.read(self._source, _CHUNK_BYTES)) and not self._closed:
            wire.write_all(self._console, data)
            self._sent += len(data)
        os.close(self._source)


class Feeder:
    """Writes standard input to the command without blocking the control line."""

    def __init__(self, sink: int, control: int) -> None:
        self._sink = sink
        self._control = control
        self._waiting: queue.SimpleQueue[bytes] = queue.SimpleQueue()
        threading.Thread(target=self._run, daemon=True).start()

    def put(self, data: bytes) -> None:
        """Add bytes; an empty string marks the end."""
        self._waiting.put(data)

    def _run(self) -> None:
        while data := self._waiting.get():
            try:
                wire.write_all(self._sink, data)
            except BrokenPipeError:
                # The command reads no more, so no more is requested.
                return
            wire.write_numbers(self._control, Kind.TAKEN, len(data))
        os.close(self._sink)


if __name__ == "__main__":
    main()
    sys.exit("the machine is still on")
