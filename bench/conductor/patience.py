"""Waiting for processes to start: when to say so, and when to give up."""

import time
from collections.abc import Callable, Sequence

from bench.errors import RunFailed

SAY_S = 2.0
"""Wall-clock time in s after which a person is told what is waited for."""

LONGEST_S = 600.0
"""Wall-clock time in s after which waiting ends, whatever progress there is."""

PERIOD_S = 0.5
"""Wall-clock time in s between two looks at the clock."""

_NAMED = 4

Say = Callable[[str], None]
"""Called with what is waited for, every second from `SAY_S` on."""


class Patience:
    """Waits as long as there are signs of progress: not for a fixed time, as a busy machine may take long."""

    def __init__(self, silence_s: float, say: Say | None, clock: Callable[[], float] = time.monotonic) -> None:
        """Begin to wait.

        Args:
            silence_s: time in s without a sign of progress after which to give up.
            say: see `Say`; None to say nothing.
            clock: returns the time in s.
        """
        self._silence_s = silence_s
        self._say = say
        self._clock = clock
        self._began = self._moved = clock()
        self._next_look = self._began
        self._next_word = self._began + SAY_S
        self._seen: object = None

    def look(self, what: str, doing: str, progress: Callable[[], object]) -> None:
        """Say what is waited for, if it is time to.

        Args:
            what: what is waited for: `veh1.tracker, veh2.tracker`.
            doing: what they are doing.
            progress: returns how far they are; another value than before is a sign of progress.

        Raises:
            RunFailed: it took too long.
        """
        now = self._clock()
        if now < self._next_look:
            return
        self._next_look = now + PERIOD_S
        seen = progress()
        if seen != self._seen:
            self._seen, self._moved = seen, now
        waited, still = now - self._began, now - self._moved
        if still >= self._silence_s:
            since = f"; no sign of progress since {waited - still:.0f} s" if waited > still else ""
            raise RunFailed(f"{what} not ready after {waited:.0f} s; {doing}{since}")
        if waited >= LONGEST_S:
            raise RunFailed(f"{what} not ready after {waited:.0f} s; {doing}")
        if now >= self._next_word:
            self._next_word = now + 1.0
            if self._say is not None:
                self._say(f"waiting for {what} to start ({waited:.0f} s): {doing} ...")


def listed(names: Sequence[str]) -> str:
    """Return names in a row, the first few of many."""
    more = len(names) - _NAMED
    return ", ".join(names) if more <= 1 else f"{', '.join(names[:_NAMED])} and {more} more"
