"""The findings of an FMU's checks."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Outcome(StrEnum):
    """How a check ended."""

    PASSED = "passed"
    SKIPPED = "skipped"
    PROBLEM = "problem"


@dataclass(frozen=True)
class Finding:
    """The result of one check.

    Attributes:
        outcome: how it ended.
        text: one line: what was compared, why it was skipped, or which variable is wrong and both values.
    """

    outcome: Outcome
    text: str


@dataclass(frozen=True)
class Check:
    """One check of an FMU and its finding.

    Attributes:
        name: what was checked.
        kind: the interface type that was checked; empty for the FMU as a whole.
        outcome: how it ended.
        text: one line, as in `Finding`.
    """

    name: str
    kind: str
    outcome: Outcome
    text: str


def passed(text: str) -> Finding:
    """A check that found nothing wrong."""
    return Finding(Outcome.PASSED, text)


def skipped(why: str) -> Finding:
    """A check that was not run."""
    return Finding(Outcome.SKIPPED, why)


def problem(text: str) -> Finding:
    """A check that found something wrong."""
    return Finding(Outcome.PROBLEM, text)
