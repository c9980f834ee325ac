"""What happened in a run, as its log has it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Event:
    """Something that happened: `level` as in `foxglove.LEVELS`, `source` who says so."""

    time_s: float
    level: str
    source: str
    text: str
