"""Requests to the Linux kernel about processes; other systems do without them."""

import ctypes
import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager

_PR_SET_PDEATHSIG = 1
_PR_SET_NAME = 15


def die_with_parent() -> None:
    """Have the kernel kill this process as soon as its parent is dead. The lifeline does the same, but later."""
    _prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


def set_name(name: str) -> None:
    """Name this process (15 characters) for ps and top."""
    _prctl(_PR_SET_NAME, name.encode())


@contextmanager
def as_batch_work() -> Iterator[None]:
    """Do not interrupt others when woken: this thread, and the processes it starts meanwhile (SCHED_BATCH, sched(7)).

    A bench has more processes than the machine has cores. Woken by every single frame, they would keep interrupting
    those who send them; so they find several frames when it is their turn, which takes a fifth off a cycle.
    """
    try:
        changed = sys.platform == "linux" and os.sched_getscheduler(0) == os.SCHED_OTHER
        if changed:
            os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))
    except OSError:
        # Some containers forbid the call; all works without it too.
        changed = False
    try:
        yield
    finally:
        if changed:
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def _prctl(request: int, argument: int | bytes) -> None:
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(request, argument, 0, 0, 0)
