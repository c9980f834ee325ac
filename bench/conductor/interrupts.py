"""Ctrl-C and similar signals as an event to wait for, so that they never interrupt a run while it writes its log."""

import os
import signal
import threading
from types import FrameType, TracebackType
from typing import Any

from bench.errors import RunFailed


class Interrupted(RunFailed):
    """A person or the system asked the run to end."""


class Interrupts:
    """While this context lasts, SIGINT, SIGTERM and SIGHUP only set `received` and make `fileno()` readable.

    Outside the main thread, where Python handles no signals, it does nothing.

    Attributes:
        received: name of the signal received, None before.
    """

    _SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

    def __init__(self) -> None:
        """Begin with no signal received."""
        self.received: str | None = None
        self._before: dict[signal.Signals, Any] = {}
        self._reader, self._writer = os.pipe()
        os.set_blocking(self._writer, False)
        self._wakeup_before = -1

    def fileno(self) -> int:
        """Return the file descriptor that becomes readable when a signal comes."""
        return self._reader

    def check(self) -> None:
        """End the run if a signal has come.

        Raises:
            Interrupted: a signal has come.
        """
        if self.received is not None:
            raise Interrupted(f"interrupted by {self.received}")

    def __enter__(self) -> "Interrupts":
        """Install the signal handlers."""
        if threading.current_thread() is threading.main_thread():
            self._wakeup_before = signal.set_wakeup_fd(self._writer, warn_on_full_buffer=False)
            self._before = {number: signal.signal(number, self._receive) for number in self._SIGNALS}
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Restore the signal handlers."""
        for number, handler in self._before.items():
            signal.signal(number, handler)
        if self._before:
            signal.set_wakeup_fd(self._wakeup_before)
        os.close(self._reader)
        os.close(self._writer)

    def _receive(self, number: int, _frame: FrameType | None) -> None:
        self.received = signal.Signals(number).name
