"""The label in a log, and the names of two runs that are compared."""

from __future__ import annotations

from collections.abc import Sequence

from bench.label import LABEL, MAX_LABEL, cleaned, shortened
from bench.record.reader import Run


def label_of(run: Run) -> str:
    """Return the label in a log, cleaned and shortened; empty if it has none."""
    return shortened(cleaned(run.metadata.get(LABEL, "")), MAX_LABEL)


def name_of(run: Run) -> str:
    """Return the label of a run, or if it has none, the name of its file."""
    return label_of(run) or _file_of(run)


def resim_label(run: Run, ecus: Sequence[str]) -> str:
    """Return the label of a log in which these ECUs of `run` were run again."""
    which = ecus[0] if len(ecus) == 1 else f"{len(ecus)} ECUs"
    told = f", resim of {which}"
    return shortened(name_of(run), MAX_LABEL - len(told)) + told


def names_of(a: Run, b: Run) -> tuple[str, str]:
    """Return names that tell two runs apart: their labels, or of their files if these are equal or absent."""
    for told in (name_of, _file_of):
        names = told(a), told(b)
        if names[0] != names[1]:
            return names
    return cleaned(str(a.path)), cleaned(str(b.path))


def _file_of(run: Run) -> str:
    return cleaned(run.path.name)
