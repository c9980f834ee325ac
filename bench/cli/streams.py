"""The standard streams of a command: always open, and never a reason for it to fail half-way.

A closed stream is replaced by /dev/null: otherwise the next file that is opened would get its number, and what somebody
prints would land in a log. When output cannot be written, the command goes on without: a reader that has seen enough
(`| head`) is no error, anything else is reported at the end.
"""

import errno
import io
import os
import sys
from contextlib import suppress
from typing import Any, TextIO


class Output(io.FileIO):
    """A stream that accepts everything.

    Attributes:
        problem: why something could not be written; None if that has not happened, or its reader has gone.
    """

    def __init__(self, descriptor: int) -> None:
        """Write to `descriptor`, which stays open."""
        super().__init__(descriptor, "w", closefd=False)
        self.problem: OSError | None = None

    def write(self, data: Any) -> int:
        """Write bytes, or drop them."""
        try:
            return super().write(data) or 0
        except OSError as error:
            if error.errno != errno.EPIPE:
                self.problem = error
            null = os.open(os.devnull, os.O_WRONLY)
            os.dup2(null, self.fileno())
            os.close(null)
            return len(memoryview(data))


def prepare_streams() -> Output:
    """Open what is closed, and make the outputs of this process accept everything; return standard output."""
    for descriptor in (0, 1, 2):
        try:
            os.fstat(descriptor)
        except OSError:
            # The lowest number that is free is this one.
            os.open(os.devnull, os.O_RDWR)
    raw = Output(1)
    if sys.stdout is sys.__stdout__:  # noqa: TID251 - guarded later
        sys.stdout = _text(raw, sys.stdout, by_lines=raw.isatty())
    if sys.stderr is sys.__stderr__:  # noqa: TID251 - guarded later
        sys.stderr = _text(Output(2), sys.stderr, by_lines=True)
    return raw


def _text(raw: Output, like: TextIO | None, *, by_lines: bool) -> TextIO:
    encoding, errors = (like.encoding, like.errors) if like else (None, None)
    return io.TextIOWrapper(io.BufferedWriter(raw), encoding, errors, line_buffering=by_lines)


def flush() -> None:
    """Write what is still to be written."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(ValueError, OSError, AttributeError):
            stream.flush()
