"""The program that is a Linux kernel with CAN: what it needs from this machine, starting and stopping it."""

import contextlib
import os
import shutil
import signal
import subprocess
import tempfile
import threading
from collections import deque
from pathlib import Path

from bench.conductor.linux import die_with_parent
from bench.errors import BadInput
from bench.vcan.guest import CONTROL, ERRORS, MODULES, MODULES_DIRECTORY, OUTPUT
from platoon_fmu.interpreter import interpreter

PROGRAM = "linux.uml"
LEAST_MEMORY_MB = 256
LAST_LINES = 12
"""Number of console lines shown when the kernel fails."""

_ROOT = Path(__file__).parents[2]
_SYSTEM_PATH = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"
_END_GUARD_S = 20.0


def lacking_packages() -> list[str]:
    """Return the Debian packages that are missing to boot the machine."""
    path = os.environ.get("PATH", "") + ":" + _SYSTEM_PATH
    programs = {"user-mode-linux": PROGRAM, "kmod": "insmod", "iproute2": "ip"}
    lacking = [package for package, program in programs.items() if shutil.which(program, path=path) is None]
    if "user-mode-linux" not in lacking and not list(MODULES_DIRECTORY.glob(f"*/kernel/{MODULES[-1]}.ko")):
        lacking.append("user-mode-linux")
    return lacking


def require_packages() -> None:
    """Check that all packages are there.

    Raises:
        BadInput: some are missing; the message says how to install all of them.
    """
    lacking = lacking_packages()
    if lacking:
        raise BadInput(
            "platoon vcan: this kernel has no CAN, and booting one that has (user-mode Linux) needs the missing "
            f"{', '.join(lacking)}; on Debian type:\n  sudo apt-get install --no-install-recommends {' '.join(lacking)}"
        )


class Machine:
    """User-mode Linux, running `bench.vcan.guest` as its first process.

    It is killed when the thread that created it ends, or when its context exits.

    Attributes:
        control: file descriptor for messages to the first process.
        answers: file descriptor for its messages.
        output: file descriptor of the command's standard output; its reader closes it.
        errors: file descriptor of its standard error, likewise.
    """

    def __init__(self, memory_mb: int) -> None:
        """Start it, with at most this much memory.

        Raises:
            BadInput: packages are missing or the memory cannot be had.
        """
        require_packages()
        place = _memory_place(memory_mb)
        self._directory = tempfile.TemporaryDirectory(prefix="platoon-vcan-")
        pipes = [os.pipe() for _ in range(5)]
        (told, self.control), (self.answers, answered), (self.output, out), (self.errors, err), (log, logged) = pipes
        theirs = (told, answered, out, err, logged)
        python, *options = interpreter()
        self._process = subprocess.Popen(
            [
                PROGRAM,
                f"mem={memory_mb}M",
                *("rootfstype=hostfs", "rootflags=/", "rw", "quiet"),
                *("con=null", f"con0=null,fd:{logged}"),
                *(f"con{CONTROL}=fd:{told},fd:{answered}", f"con{OUTPUT}=null,fd:{out}", f"con{ERRORS}=null,fd:{err}"),
                f"uml_dir={self._directory.name}/",
                # Words with = become the first process's environment; what follows -- becomes its arguments.
                *(f'init="{python}"', f'PYTHONPATH="{_ROOT}"', "PYTHONDONTWRITEBYTECODE=1"),
                *("--", *options, "-S", "-m", "bench.vcan.guest"),
            ],
            stdin=subprocess.DEVNULL,
            stdout=logged,
            stderr=logged,
            pass_fds=theirs,
            env={"PATH": _SYSTEM_PATH, "HOME": self._directory.name, "TMPDIR": place},
            # Ctrl-C in a terminal is for the command, not for the kernel.
            start_new_session=True,
            preexec_fn=die_with_parent,
        )
        for descriptor in theirs:
            os.close(descriptor)
        # The kernel dies with its parent, but it has helper processes that do not notice. This one kills them: its
        # standard input ends when this process is gone, however that happened.
        self._watcher = subprocess.Popen(
            ["/bin/sh", "-c", 'read _; kill -9 "-$1"', "sh", str(self._process.pid)],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        self._console: deque[str] = deque(maxlen=LAST_LINES)
        self._listener = threading.Thread(target=self._listen, args=(log,), daemon=True)
        self._listener.start()

    def __enter__(self) -> "Machine":
        """Return the machine."""
        return self

    def __exit__(self, *_: object) -> None:
        """Kill what is left of it."""
        with contextlib.suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        self._watcher.kill()
        self._watcher.communicate()
        os.close(self.control)
        os.close(self.answers)
        self.forget_files()

    def forget_files(self) -> None:
        """Remove the files needed only at the start, so that none stays behind however this process ends."""
        self._directory.cleanup()

    def wait(self) -> None:
        """Wait until it is off; kill it if that takes very long."""
        try:
            self._process.wait(_END_GUARD_S)
        except subprocess.TimeoutExpired:
            self._process.kill()

    def last_words(self) -> str:
        """Return the last lines of its console, once it is off."""
        self._listener.join(1.0)
        return "\n".join(f"  {line}" for line in self._console)

    def _listen(self, log: int) -> None:
        with open(log, encoding="utf-8", errors="replace") as lines:
            self._console.extend(line.rstrip() for line in lines if line.strip())


def _memory_place(memory_mb: int) -> str:
    """Return the directory for the file, removed at once, that is the machine's memory.

    Raises:
        BadInput: no directory has the room.
    """
    if memory_mb < LEAST_MEMORY_MB:
        raise BadInput(f"platoon vcan: --memory {memory_mb}: at least {LEAST_MEMORY_MB} (MB)")
    found = []
    for place in ("/dev/shm", os.environ.get("TMPDIR") or "/tmp"):
        if not (Path(place).is_dir() and os.access(place, os.W_OK)):
            continue
        volume = os.statvfs(place)
        free_mb = volume.f_bavail * volume.f_frsize >> 20
        if free_mb >= memory_mb and not volume.f_flag & os.ST_NOEXEC:
            return place
        found.append(f"{place} has {free_mb} MB{' and is mounted noexec' if volume.f_flag & os.ST_NOEXEC else ''}")
    raise BadInput(
        f"platoon vcan: the machine's memory of {memory_mb} MB needs room for a file: {', '.join(found)}; "
        "give --memory, or set TMPDIR to a directory with room"
    )
