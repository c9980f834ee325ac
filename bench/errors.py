"""The bench's errors, which the command line turns into one message and an exit code."""

import errno
import os

_SHORT_OF = {
    errno.EMFILE: "too many open files for one process; permit more with: ulimit -n",
    errno.ENFILE: "too many open files on this machine",
    errno.EAGAIN: "no further process or thread is permitted; permit more with: ulimit -u",
    errno.ENOMEM: "out of memory",
    errno.ENOSPC: "no space left",
    errno.EDQUOT: "the disk quota is used up",
    errno.EFBIG: "a file would be larger than permitted; permit more with: ulimit -f",
    errno.EROFS: "the file system is read-only",
}


class BenchError(Exception):
    """Base of all errors shown to a user; its text is shown unchanged.

    Attributes:
        exit_code: the exit code of `platoon` when this error ends it.
    """

    exit_code = 1


class RunFailed(BenchError):
    """A run started and failed (an ECU died, a bus fell silent)."""

    exit_code = 1


class BadInput(BenchError):
    """Invalid input; nothing was started or written."""

    exit_code = 2


class EcuError(RunFailed):
    """An ECU's own code failed, or its step returned something that cannot be sent."""


def shortage(error: BaseException) -> str | None:
    """Return what the system does not provide, as a message; None if `error` is something else."""
    if isinstance(error, MemoryError):
        return _SHORT_OF[errno.ENOMEM]
    if isinstance(error, RuntimeError) and "can't start new thread" in str(error):
        return _SHORT_OF[errno.EAGAIN]
    if isinstance(error, FileNotFoundError) and error.errno == errno.ENOENT and "No usable temporary" in str(error):
        return f"{error.strerror}; set TMPDIR to a directory that can be written to"
    if not isinstance(error, OSError) or error.errno not in _SHORT_OF:
        return None
    where = f"{os.fsdecode(error.filename)}: " if isinstance(error.filename, str | bytes) else ""
    return f"{where}{_SHORT_OF[error.errno]}"
