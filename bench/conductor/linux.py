"""Two requests to the kernel that Python has no function for (prctl(2)); other systems do without them."""

import ctypes
import signal
import sys

_PR_SET_PDEATHSIG = 1
_PR_SET_NAME = 15


def die_with_parent() -> None:
    """Have the kernel kill this process as soon as its parent is dead. The lifeline does the same, but later."""
    _prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


def set_name(name: str) -> None:
    """Name this process (15 characters) for ps and top."""
    _prctl(_PR_SET_NAME, name.encode())


def _prctl(request: int, argument: int | bytes) -> None:
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(request, argument, 0, 0, 0)
