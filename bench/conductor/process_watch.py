"""Samples the processor usage of the processes of a run."""

import os
import time
from collections.abc import Callable, Iterator, Mapping

from bench.conductor.linux import taken
from bench.names import CONDUCTOR
from bench.record.process_usage import ProcessUsage

PERIOD_S = 1.0
"""Wall-clock time in s between two samples; one costs some 0.1 ms a process."""


class ProcessWatch:
    """Watches the conductor and the processes it has started, including those started or restarted later."""

    def __init__(self, pids: Callable[[], Mapping[str, int]]) -> None:
        """Watch the processes returned by `pids`, by name, and this one."""
        self._pids = pids
        self._due = 0.0
        self._before: dict[int, tuple[float, float]] = {}

    def samples(self) -> Iterator[tuple[str, ProcessUsage]]:
        """Yield name and usage of each process if `PERIOD_S` has passed since the last time, else nothing."""
        now = time.monotonic()
        if now < self._due:
            return
        self._due = now + PERIOD_S
        for name, pid in {CONDUCTOR: os.getpid(), **self._pids()}.items():
            sample = self._sample(pid, now)
            # Without one it has just ended; the crew notices that.
            if sample is not None:
                yield name, sample

    def _sample(self, pid: int, now: float) -> ProcessUsage | None:
        has = taken(pid)
        if has is None:
            return None
        at, before = self._before.get(pid, (now, has.processor_s))
        self._before[pid] = now, has.processor_s
        share = (has.processor_s - before) / (now - at) if now > at else 0.0
        return ProcessUsage(has.processor_s, share, has.memory, has.preemptions)
