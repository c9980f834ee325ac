"""All checks of an FMU: fmpy's static ones, and dynamic ones with its binary for this platform."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, TYPE_CHECKING

from platoon_fmu.archive import one_line
from platoon_fmu.checks.findings import Check, Outcome
from platoon_fmu.errors import FmuError
from platoon_fmu.interpreter import python

if TYPE_CHECKING:
    from platoon_fmu.importer import OpenFmu

#: Time after which a dynamic check counts as hung [s].
TIMEOUT_S = 60.0

_LAST_WORDS_BYTES = 4096


def validate(fmu: Path, timeout_s: float = TIMEOUT_S) -> Iterator[Check]:
    """Yield the checks of an FMU, each run on demand.

    Args:
        fmu: the file.
        timeout_s: time limit of one dynamic check [s].

    Raises:
        FmuError: the file is missing, damaged or not an FMU, or its binary for this platform does not load or is
            missing (reported after the static checks).
    """
    from platoon_fmu.importer import opened

    with opened(fmu) as unpacked:
        if not unpacked.kinds:
            yield from static_checks(fmu)
            reason = "the FMU has neither Model Exchange nor Co-Simulation"
            yield Check("dynamic checks", "", Outcome.SKIPPED, reason)
            return
        if not unpacked.runs_here:
            yield from static_checks(fmu)
            raise FmuError(f"{fmu}: {_why_not_run(unpacked)}")
        with _dynamic_checks(fmu, unpacked.folder, timeout_s) as dynamic_checks:
            yield from static_checks(fmu)
            yield from dynamic_checks


def static_checks(fmu: Path) -> Iterator[Check]:
    """Yield fmpy's findings in the archive's names and its modelDescription.xml.

    fmpy stops at the first violation of the XML schema.
    """
    from fmpy.validation import validate_fmu

    problems = [one_line(problem) for problem in validate_fmu(str(fmu.resolve()))]
    for text in problems:
        yield Check("static", "", Outcome.PROBLEM, text)
    if not problems:
        yield Check("static", "", Outcome.PASSED, "fmpy finds no problems in schema, variables and model structure")


def _why_not_run(fmu: OpenFmu) -> str:
    import fmpy

    others = f"it has binaries for {', '.join(fmu.platforms)}" if fmu.platforms else "it has no binaries"
    mend = "; `python -m fmpy compile` builds one from its C sources" if any(fmu.folder.glob("sources/*.c")) else ""
    return f"the FMU cannot be run: it has no binary for this platform, {fmpy.platform_tuple}; {others}{mend}"


@contextmanager
def _dynamic_checks(fmu: Path, folder: Path, timeout_s: float) -> Iterator[Iterator[Check]]:
    """The running check process's findings.

    Raises:
        FmuError: a binary cannot be loaded.
    """
    # In a new session, so that all its child processes can be ended with it.
    with (
        tempfile.TemporaryFile() as words,
        python(
            "platoon_fmu.checks.check_process",
            str(folder),
            str(timeout_s),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            # Not the terminal: what the FMU's libraries write there could control it.
            stderr=words,
            start_new_session=True,
        ) as process,
    ):
        try:
            answers = _answers(process, words)
            unloadable = next(answers)["unloadable"]
            if unloadable:
                raise FmuError(f"{fmu}: {one_line(unloadable).replace(f'{folder}/', '')}")
            yield (Check(a["name"], a["kind"], Outcome(a["outcome"]), a["text"]) for a in answers)
        finally:
            _end(process)


def _end(process: subprocess.Popen[bytes]) -> None:
    if process.poll() is None:
        if hasattr(os, "killpg"):
            os.killpg(process.pid, signal.SIGKILL)
        else:
            process.kill()


def _answers(process: subprocess.Popen[bytes], words: IO[bytes]) -> Iterator[dict[str, str]]:
    """Yield the output of a process line by line until it ends.

    Raises:
        FmuError: it ended before it was done.
    """
    for line in process.stdout or ():
        yield json.loads(line)
    if process.wait():
        words.seek(max(0, words.seek(0, os.SEEK_END) - _LAST_WORDS_BYTES))
        said = words.read().decode(errors="replace").strip().splitlines()
        last = f": {said[-1]}" if said else ""
        raise FmuError(f"the process that checks the FMU ended with status {process.returncode}{last}")
