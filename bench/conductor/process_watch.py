"""Samples the processor usage of the processes of a run."""

import os
import time
from collections.abc import Callable, Iterator, Mapping

import psutil

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
        self._processes: dict[int, psutil.Process] = {}
        self._before: dict[int, tuple[float, float]] = {}

    def samples(self) -> Iterator[tuple[str, ProcessUsage]]:
        """Yield name and usage of each process if `PERIOD_S` has passed since the last time, else nothing."""
        now = time.monotonic()
        if now < self._due:
            return
        self._due = now + PERIOD_S
        for name, pid in {CONDUCTOR: os.getpid(), **self._pids()}.items():
            try:
                yield name, self._sample(pid, now)
            except psutil.Error:
                # It has just ended; the crew notices that.
                self._processes.pop(pid, None)

    def _sample(self, pid: int, now: float) -> ProcessUsage:
        if pid not in self._processes:
            self._processes[pid] = psutil.Process(pid)
        process = self._processes[pid]
        with process.oneshot():
            times = process.cpu_times()
            cpu = times.user + times.system
            at, before = self._before.get(pid, (now, cpu))
            self._before[pid] = now, cpu
            share = (cpu - before) / (now - at) if now > at else 0.0
            return ProcessUsage(cpu, share, process.memory_info().rss, process.num_ctx_switches().involuntary)
