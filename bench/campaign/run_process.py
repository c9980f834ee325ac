"""The worker's end of a process that makes runs (`bench.campaign.one_run`)."""

from __future__ import annotations

import json
import os
import select
import signal
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from subprocess import PIPE
from typing import Any

from platoon_fmu.interpreter import python

MOST_WORDS = 1000
"""Characters kept of what a process said before it died: the error, and where it was."""
START_S = 120.0
"""Time in s in which a process must have started."""


class Crashed(Exception):
    """The process has died; the text says how."""


class NotStarted(Crashed):
    """The process has died before it could make a run, or took too long to start."""


class TooLong(Exception):
    """The process has not answered in time, and was killed."""


class Ended(Exception):
    """No run is made any more."""


class RunProcess:
    """A process that makes runs, one after the other."""

    def __init__(self, study: Path, fmu: Path) -> None:
        """Start it.

        Args:
            study: file with the pickled study.
            fmu: the vehicle's FMU.

        Raises:
            OSError: the system does not permit another process.
        """
        self._said = tempfile.TemporaryFile()  # noqa: SIM115 - closed by `close`
        self._process = python(
            "bench.campaign.one_run",
            str(study),
            str(fmu),
            stdin=PIPE,
            stdout=PIPE,
            stderr=self._said,
            # Signals of the terminal are for the command.
            start_new_session=True,
        )
        self._rest = b""
        self._is_ready = False

    def ask(self, number: int, values: dict[str, Any], log: Path, limit_s: float) -> dict[str, Any]:
        """Have a run made, and return the answer, see `bench.campaign.one_run.answer_to`.

        Args:
            number: of the run.
            values: of the study's inputs.
            log: where its log is written.
            limit_s: the longest time it may take, s.

        Raises:
            NotStarted: the process has died before that.
            Crashed: the process has died.
            TooLong: the run took too long; the process is killed.
        """
        if not self._is_ready:
            self._start()
        self._said.seek(0)
        self._said.truncate()
        request = json.dumps({"number": number, "values": values, "log": str(log)}) + "\n"
        try:
            os.write(self._process.stdin.fileno(), request.encode())  # type: ignore[union-attr]
        except BrokenPipeError:
            raise Crashed(self._how_it_ended()) from None
        return self._answer(limit_s, f"took longer than {limit_s:g} s and was ended")

    def _start(self) -> None:
        """Wait until it can make runs.

        Raises:
            NotStarted: it cannot.
        """
        try:
            self._answer(START_S, f"its process did not start within {START_S:g} s")
        except (Crashed, TooLong) as error:
            raise NotStarted(str(error)) from error
        self._is_ready = True

    def kill(self) -> None:
        """Kill it; a thread that waits in `ask` sees that it has died."""
        with suppress(ProcessLookupError):
            self._process.kill()
        self._process.wait()

    def close(self) -> None:
        """Kill it, and close its streams."""
        self.kill()
        for stream in (self._process.stdin, self._process.stdout, self._said):
            if stream is not None:
                with suppress(OSError):
                    stream.close()

    def _answer(self, limit_s: float, too_long: str) -> dict[str, Any]:
        """Return the next answer.

        Raises:
            Crashed, TooLong: see `ask`; `too_long` is what the latter says.
        """
        line = self._line(time.monotonic() + limit_s)
        if line is None:
            self.close()
            raise TooLong(too_long)
        if not line:
            raise Crashed(self._how_it_ended())
        answer: dict[str, Any] = json.loads(line)
        return answer

    def _line(self, until: float) -> bytes | None:
        """Return the next line; empty if the process has ended, None if there was none in time."""
        descriptor = self._process.stdout.fileno()  # type: ignore[union-attr]
        readable = select.poll()
        readable.register(descriptor, select.POLLIN)
        while b"\n" not in self._rest:
            left = until - time.monotonic()
            if left <= 0 or not readable.poll(1000.0 * left):
                return None
            part = os.read(descriptor, 1 << 16)
            if not part:
                return b""
            self._rest += part
        line, _, self._rest = self._rest.partition(b"\n")
        return line

    def _how_it_ended(self) -> str:
        """Return how the process ended and what it said, and forget it."""
        code = self._process.wait()
        self._said.seek(0)
        said = self._said.read(MOST_WORDS).decode(errors="replace").strip()
        self.close()
        if code >= 0:
            how = f"its process ended with exit code {code}"
        else:
            try:
                how = f"its process was killed by {signal.Signals(-code).name}"
            except ValueError:
                how = f"its process was killed by signal {-code}"
        return f"{how}; it said: {said}" if said else how


class RunProcesses:
    """The processes of a worker that make runs, as many as it has runs at a time."""

    def __init__(self, study: Path, fmu: Path) -> None:
        """Begin without one.

        Args:
            study: file with the pickled study.
            fmu: the vehicle's FMU.
        """
        self._study = study
        self._fmu = fmu
        self._lock = threading.Lock()
        self._idle: list[RunProcess] = []
        self._busy: set[RunProcess] = set()
        self._is_ended = False

    @contextmanager
    def one(self) -> Iterator[RunProcess]:
        """Yield a process for one run, and keep it for the next if that has ended without an error.

        Raises:
            Ended: `end` has been called.
            OSError: the system does not permit another process.
        """
        process = self._taken()
        try:
            yield process
        except BaseException:
            self._put_back(process, is_usable=False)
            raise
        self._put_back(process, is_usable=True)

    def end(self) -> None:
        """Kill all of them, also those that are making a run."""
        with self._lock:
            self._is_ended = True
            for idle in self._idle:
                idle.close()
            self._idle.clear()
            for busy in self._busy:
                busy.kill()

    def _taken(self) -> RunProcess:
        with self._lock:
            if self._is_ended:
                raise Ended("the campaign has ended")
            process = self._idle.pop() if self._idle else RunProcess(self._study, self._fmu)
            self._busy.add(process)
            return process

    def _put_back(self, process: RunProcess, *, is_usable: bool) -> None:
        with self._lock:
            self._busy.discard(process)
            if is_usable and not self._is_ended:
                self._idle.append(process)
            else:
                process.close()
