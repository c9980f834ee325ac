"""The process that runs the dynamic checks; its arguments are FOLDER and SECONDS.

FOLDER contains the unpacked FMU, SECONDS is the time limit of a check. Each check runs in a separate process, forked
from this one. Standard output has one JSON object per line: first whether the binaries can be loaded, then the checks
in order.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path

# Imported here for the checks' forked processes; `trial` imports it only when needed.
import scipy.integrate  # noqa: F401

from platoon_fmu.checks.dynamic_checks import CHECKS, DynamicCheck, Subject
from platoon_fmu.checks.findings import Check, Finding, problem, skipped
from platoon_fmu.checks.isolation import isolated
from platoon_fmu.errors import FmuError, ProcessDied
from platoon_fmu.importer import Kind, OpenFmu, load


def unloadable(fmu: OpenFmu, timeout_s: float) -> str:
    """Why a binary of the FMU cannot be loaded; empty if all can."""
    for kind in fmu.kinds:
        try:
            isolated(_load, fmu.folder, kind, timeout_s=timeout_s, folder=fmu.folder)
        except ProcessDied as death:
            return f"its binary for {kind} cannot be loaded: it {death}"
        except FmuError as error:
            return str(error)
    return ""


def _load(folder: Path, kind: Kind) -> None:
    load(OpenFmu.unpacked(folder), kind)


def checks(fmu: OpenFmu, timeout_s: float) -> Iterator[Check]:
    """Yield the dynamic checks, each run on demand.

    If the short run of a kind crashes or hangs, its other checks would too, so they are skipped.
    """
    for kind in fmu.kinds:
        subject = Subject(fmu, kind, timeout_s)
        dead = ""
        for check in CHECKS:
            if not check.concerns(subject):
                continue
            why_not = dead or check.why_not(subject)
            finding = skipped(why_not) if why_not else _made(check, subject)
            if check is CHECKS[0] and isinstance(finding, _Death):
                dead = "the short run did not complete"
            yield Check(check.name, kind, finding.outcome, finding.text)


class _Death(Finding):
    """The finding of a check whose process died."""


def _made(check: DynamicCheck, subject: Subject) -> Finding:
    try:
        return isolated(_make, check.name, subject, timeout_s=subject.timeout_s, folder=subject.fmu.folder)
    except ProcessDied as death:
        found = problem(str(death))
        return _Death(found.outcome, found.text)


def _make(name: str, subject: Subject) -> Finding:
    return next(check for check in CHECKS if check.name == name)(subject)


def main() -> None:
    """Writes the results to standard output."""
    fmu, timeout_s = OpenFmu.unpacked(Path(sys.argv[1])), float(sys.argv[2])
    reason = unloadable(fmu, timeout_s)
    _answer({"unloadable": reason})
    if not reason:
        for check in checks(fmu, timeout_s):
            _answer(asdict(check))


def _answer(content: dict[str, str]) -> None:
    sys.stdout.write(json.dumps(content) + "\n")
    sys.stdout.flush()
