"""The live server as a run has it: started before the run, ended with it; if it dies the run continues."""

from __future__ import annotations

import json
import os
import select
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import asdict
from importlib.util import find_spec
from pathlib import Path

from bench.conductor.linux import is_stopped
from bench.errors import BadInput
from bench.live.address import LiveAddress
from platoon_fmu.interpreter import python

START_S = 60.0
"""Wall-clock time in s that the server may take to start; only a machine in trouble needs more."""

END_S = 30.0
"""Wall-clock time in s that it may take to show the complete run to viewers, before it is killed."""

MOST_RESUMED = 2
"""Number of times that it is resumed at the end after somebody has stopped it."""

_ASK_S = 0.5

PACKAGES = ("websockets",)
"""What the server needs beyond the bench."""


def check_available() -> None:
    """Refuse to serve without the packages for it.

    Raises:
        BadInput: they are not installed.
    """
    missing = [name for name in PACKAGES if find_spec(name) is None]
    if missing:
        raise BadInput(f"the live page needs {' and '.join(missing)}; install it with: pip install {' '.join(missing)}")


class LiveSession:
    """A server in a separate process."""

    def __init__(self, log: Path, address: LiveAddress, warn: Callable[[str], None]) -> None:
        """Start serving `log`, which need not be there yet; `warn` is called if that ends early."""
        self._warn = warn
        self._warned = False
        self._closing = ExitStack()
        self._last_words = self._closing.enter_context(tempfile.TemporaryFile())  # noqa: SIM115 - it is
        given = {"log": str(log.absolute()), "address": asdict(address), "parent": os.getpid()}
        self._process = python(
            "bench.live.process",
            json.dumps(given),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._last_words,
        )

    def served(self) -> str:
        """Wait until it listens; return where, as a line for a person.

        Raises:
            BadInput: it cannot listen there.
        """
        told = b""
        if self._process.stdout is not None and select.select([self._process.stdout], [], [], START_S)[0]:
            told = self._process.stdout.readline()
        answer = json.loads(told or "{}")
        if "served" not in answer:
            how = f"it is stopped after {START_S:g} s" if is_stopped(self._process.pid) else self._words()
            raise BadInput(answer.get("refused") or f"the live server did not start: {how}")
        return str(answer["served"])

    def check(self) -> None:
        """Warn, once, where the server has failed."""
        code = self._process.poll()
        if code and not self._warned:
            self._warned = True
            ended = f"was killed by signal {-code}" if code < 0 else f"ended with exit code {code}"
            self._warn(f"the live server {ended}{self._words(': ')}; the run goes on without it")

    def end(self) -> None:
        """Let viewers get the end, then end the server."""
        if self._process.stdin is not None:
            self._process.stdin.close()
        try:
            self._await_end()
            self.check()
        except subprocess.TimeoutExpired:
            how = "is stopped" if is_stopped(self._process.pid) else f"has not ended in {END_S:g} s"
            self._warn(f"the live server {how} and is killed")
        finally:
            self.kill()

    def _await_end(self) -> None:
        """Wait until it has ended. If somebody has stopped it (SIGSTOP), viewers get the end nevertheless.

        Raises:
            subprocess.TimeoutExpired: it takes longer than `END_S`, or is stopped again and again.
        """
        deadline = time.monotonic() + END_S
        times_resumed = 0
        while True:
            if is_stopped(self._process.pid):
                self._process.send_signal(signal.SIGCONT)
                times_resumed += 1
            try:
                self._process.wait(min(_ASK_S, max(0.0, deadline - time.monotonic())))
            except subprocess.TimeoutExpired:
                if time.monotonic() >= deadline or times_resumed > MOST_RESUMED:
                    raise
                continue
            return

    def kill(self) -> None:
        """End the server at once."""
        if self._process.poll() is None:
            self._process.kill()
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout):
            if stream is not None:
                stream.close()
        self._closing.close()

    def _words(self, before: str = "") -> str:
        """The last line it has written to its standard error."""
        self._last_words.seek(0)
        lines = self._last_words.read().decode(errors="replace").strip().splitlines()
        return before + lines[-1] if lines else ""


@contextmanager
def live(log: Path, address: LiveAddress, warn: Callable[[str], None]) -> Iterator[LiveSession]:
    """Serve a log while the context lasts.

    Raises:
        BadInput: the packages for it are not installed.
    """
    check_available()
    session = LiveSession(log, address, warn)
    try:
        yield session
    finally:
        session.end()
