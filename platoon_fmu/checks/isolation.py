"""Runs a function in a process of its own, so that a binary that crashes or hangs takes nobody along."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import tempfile
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, TypeVar

from platoon_fmu.errors import FmuError, ProcessDied

T = TypeVar("T")


def isolated(function: Callable[..., T], *arguments: Any, timeout_s: float, folder: Path) -> T:
    """What a function returns, called in a process of its own.

    To be called from a process without threads: on Linux the other process is a copy of this one, which spares it
    all imports.

    Args:
        function: one that a module has by name.
        arguments: what it is called with; they and what it returns can be pickled.
        timeout_s: how long it may take [s].
        folder: where what the process prints is kept meanwhile.

    Raises:
        ProcessDied: the process ended before the function returned, or did not come back in time.
        FmuError: the function raised it.
    """
    fork = sys.platform == "linux"
    context = multiprocessing.get_context("fork") if fork else multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    with tempfile.TemporaryDirectory(prefix="said-", dir=folder) as place:
        said = Path(place) / "said"
        process = context.Process(target=_work, args=(sender, said, timeout_s, function, arguments))
        process.start()
        sender.close()
        try:
            if not receiver.poll(timeout_s):
                raise ProcessDied(f"does not come back within {timeout_s:g} s")
            answer = receiver.recv()
        except EOFError:
            process.join()
            words = said.read_bytes() if said.exists() else b""
            raise ProcessDied(cause_of_death(process.exitcode or 0, words)) from None
        finally:
            process.kill()
            process.join()
            receiver.close()
    if isinstance(answer, FmuError):
        raise answer
    result: T = answer
    return result


def end_after(seconds: float) -> None:
    """Lets the system end this process after some time, even within a call into a binary that hangs."""
    if hasattr(signal, "setitimer"):
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.setitimer(signal.ITIMER_REAL, seconds)


def _work(sender: Connection, said: Path, timeout_s: float, function: Callable[..., Any], arguments: Any) -> None:
    # Where whoever waits for it is gone, nobody else ends it.
    end_after(timeout_s + 1.0)
    # What binaries print is no part of the caller's own output.
    with said.open("wb") as file:
        os.dup2(file.fileno(), 1)
        os.dup2(file.fileno(), 2)
    try:
        answer = function(*arguments)
    except FmuError as error:
        answer = error
    sender.send(answer)


def cause_of_death(exit_code: int, said: bytes) -> str:
    """How a process ended, and the last line that it printed.

    Args:
        exit_code: as `subprocess` has it, negative for a signal.
        said: what it printed.
    """
    if exit_code < 0:
        number = signal.Signals(-exit_code)
        cause = f"crashes with {number.name} ({signal.strsignal(number)})"
        if hasattr(signal, "SIGALRM") and number == signal.SIGALRM:
            cause = "does not come back in time"
    else:
        cause = f"ends with status {exit_code}"
    lines = [line.strip() for line in said.decode(errors="replace").splitlines() if line.strip()]
    return f"{cause}; its last words: {lines[-1]}" if lines else cause
