"""A time limit for each step of an ECU that is run again: one that hangs must not block the others."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing.sharedctypes import RawValue

from bench.cycle import time_of

_MAKING = -1


class StepLimit:
    """Ends an ECU's process, by SIGALRM, if a step does not end in time, even if it hangs in C code.

    Created before that process is forked, it tells the parent what was going on.
    """

    def __init__(self, seconds: float) -> None:
        """Allow so many `seconds` of wall-clock time for a step."""
        self._seconds = seconds
        # In shared memory.
        self._cycle = RawValue("q", _MAKING)

    @contextmanager
    def making(self) -> Iterator[None]:
        """Watch over the creation of the ECU."""
        with self.step(_MAKING):
            yield

    @contextmanager
    def step(self, cycle: int) -> Iterator[None]:
        """Watch over a step."""
        self._cycle.value = cycle
        signal.setitimer(signal.ITIMER_REAL, self._seconds)
        try:
            yield
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0.0)

    def __str__(self) -> str:
        """Return what hangs, and since when, if the time was over."""
        cycle = self._cycle.value
        if cycle == _MAKING:
            return f"hangs in its constructor, which did not end within {self._seconds:g} s"
        return f"hangs in cycle {cycle} (t = {time_of(cycle):.3f} s): no end within {self._seconds:g} s"
