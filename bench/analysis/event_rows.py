"""The events as the page lists them: a change of state or cause that recurs is one row with the times of all.

With noise an ECU may leave and regain its state in every other cycle; what else happened must stay readable.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict
from typing import Any

from bench.events import CauseChange, StateChange
from bench.record import Event

SAME_S = 1.0
"""A change that recurs within this time, s, is a repeat of the one before."""

_FLAPPING = (StateChange.kind, CauseChange.kind)


def event_rows(events: Iterable[Event]) -> list[dict[str, Any]]:
    """Return a dict for each event, with the fields of `Event` and `repeats`: the times of its repeats, s.

    Args:
        events: in the order of time.
    """
    rows: list[dict[str, Any]] = []
    latest: dict[tuple[str, str], dict[str, Any]] = {}
    for event in events:
        what = event.source, event.text
        row = latest.get(what) if event.kind in _FLAPPING else None
        if row is not None and event.time_s - (row["repeats"] or [row["time_s"]])[-1] <= SAME_S:
            row["repeats"].append(event.time_s)
            continue
        rows.append({**asdict(event), "repeats": []})
        latest[what] = rows[-1]
    return rows
