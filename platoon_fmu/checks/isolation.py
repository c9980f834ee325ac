"""Runs a function in a separate process, so that a binary that crashes or hangs does not affect the caller."""

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
    """The return value of a function called in a separate process.

    The calling process must not have threads: on Linux the other process is forked from it, which saves all imports.

    Args:
        function: a module-level function.
        arguments: its arguments; they and its return value must be picklable.
        timeout_s: its time limit [s].
        folder: for the temporary file with the process's output.

    Raises:
        ProcessDied: the process ended before the function returned, or timed out.
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
                raise ProcessDied(f"does not return within {timeout_s:g} s")
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
    """Has the system terminate this process after some time, even inside a binary that hangs."""
    if hasattr(signal, "setitimer"):
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.setitimer(signal.ITIMER_REAL, seconds)


def _work(sender: Connection, said: Path, timeout_s: float, function: Callable[..., Any], arguments: Any) -> None:
    # If the waiting parent has died, nothing else would end it.
    end_after(timeout_s + 1.0)
    # Keeps the binaries' output out of the caller's.
    with said.open("wb") as file:
        os.dup2(file.fileno(), 1)
        os.dup2(file.fileno(), 2)
    try:
        answer = function(*arguments)
    except FmuError as error:
        answer = error
    sender.send(answer)


def cause_of_death(exit_code: int, said: bytes) -> str:
    """How a process ended, with its last line of output.

    Args:
        exit_code: as `subprocess` has it, negative for a signal.
        said: its output.
    """
    if exit_code < 0:
        number = signal.Signals(-exit_code)
        cause = f"crashes with {number.name} ({signal.strsignal(number)})"
        if hasattr(signal, "SIGALRM") and number == signal.SIGALRM:
            cause = "does not return in time"
    else:
        cause = f"ends with status {exit_code}"
    lines = [line.strip() for line in said.decode(errors="replace").splitlines() if line.strip()]
    return f"{cause}; its last output: {lines[-1]}" if lines else cause
