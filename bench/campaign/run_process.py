"""The worker's end of a process that makes runs (`bench.campaign.one_run`)."""

from __future__ import annotations

import json
import os
import select
import signal
import tempfile
import time
from contextlib import suppress
from pathlib import Path
from subprocess import PIPE
from typing import Any

from platoon_fmu.interpreter import python

MOST_WORDS = 2000
"""Characters kept of what a crashed process said last."""
START_S = 120.0
"""Time in s in which a process must have started, in addition to a run's time limit."""


class Crashed(Exception):
    """The process has died; the text says how."""


class TooLong(Exception):
    """The process has not answered in time, and was killed."""


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
        self._starting = True

    def ask(self, number: int, values: dict[str, Any], log: Path, limit_s: float) -> dict[str, Any]:
        """Have a run made, and return the answer, see `bench.campaign.one_run.answer_to`.

        Args:
            number: of the run.
            values: of the study's inputs.
            log: where its log is written.
            limit_s: the longest time it may take, s.

        Raises:
            Crashed: the process has died.
            TooLong: the run took too long; the process is killed.
        """
        request = json.dumps({"number": number, "values": values, "log": str(log)}) + "\n"
        try:
            os.write(self._process.stdin.fileno(), request.encode())  # type: ignore[union-attr]
        except BrokenPipeError:
            raise Crashed(self._how_it_ended()) from None
        line = self._line(time.monotonic() + limit_s + (START_S if self._starting else 0.0))
        if line is None:
            self.close()
            raise TooLong(f"took longer than {limit_s:g} s and was ended")
        if not line:
            raise Crashed(self._how_it_ended())
        self._starting = False
        answer: dict[str, Any] = json.loads(line)
        return answer

    def close(self) -> None:
        """Kill it."""
        with suppress(ProcessLookupError):
            self._process.kill()
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout, self._said):
            if stream is not None:
                with suppress(OSError):
                    stream.close()

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
        """Return how the process ended and what it said last, and forget it."""
        code = self._process.wait()
        size = self._said.seek(0, os.SEEK_END)
        self._said.seek(max(0, size - MOST_WORDS))
        said = self._said.read().decode(errors="replace").strip()
        self.close()
        if code >= 0:
            how = f"its process ended with exit code {code}"
        else:
            try:
                how = f"its process was killed by {signal.Signals(-code).name}"
            except ValueError:
                how = f"its process was killed by signal {-code}"
        return f"{how}; it said: {said}" if said else how
