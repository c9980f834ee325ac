"""A time limit for each step of an ECU that is run again: one that hangs must not hold up the others for ever."""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing.sharedctypes import RawValue

from bench.cycle import time_of

_MAKING = -1


class StepLimit:
    """Ends the process of an ECU, by SIGALRM, where a step does not end in time; so it ends also what hangs in C code.

    Made before that process is forked, it tells what went on there to the process that is left.
    """

    def __init__(self, seconds: float) -> None:
        """Allow so many `seconds` of wall-clock time for a step."""
        self._seconds = seconds
        # In memory that both processes see.
        self._cycle = RawValue("q", _MAKING)

    @contextmanager
    def making(self) -> Iterator[None]:
        """Watch over the making of the ECU."""
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
        """Return what hangs where the time was over, and since when."""
        cycle = self._cycle.value
        if cycle == _MAKING:
            return f"hangs in its making, which did not end within {self._seconds:g} s"
        return f"hangs in cycle {cycle} (t = {time_of(cycle):.3f} s): no end within {self._seconds:g} s"
