"""The data sent to the page's viewers: growing columns and events, and finally the complete data.

Nothing waits here for a viewer. Each viewer asks for what follows its position; a slow one
asks less often and gets more at once, and one that does not read costs no more than its last message.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

Pool = Mapping[str, Sequence[float | None]]


@dataclass(frozen=True)
class Place:
    """A viewer's position.

    Attributes:
        rows: length of each column that it has.
        events: number of events that it has.
        status: the last status that it has.
        ended: whether it knows the end.
    """

    rows: Mapping[str, int] = field(default_factory=dict)
    events: int = 0
    status: str = ""
    ended: bool = False


class Feed:
    """Everything sent so far."""

    def __init__(self) -> None:
        """Begin with nothing."""
        self._columns: dict[str, list[float | None]] = {}
        self._events: list[Mapping[str, Any]] = []
        self._status = ""
        self._end: str | None = None
        self._news = asyncio.Event()
        self._last: tuple[Place, str, Place] | None = None

    def append(self, pool: Pool, events: Sequence[Mapping[str, Any]]) -> None:
        """Append values to the columns, and events as `bench.analysis.page_data.events_of` returns them."""
        for name, values in pool.items():
            self._columns.setdefault(name, []).extend(values)
        self._events += events
        self._tell()

    def say(self, status: str) -> None:
        """Set the status line."""
        self._status = status
        self._tell()

    def end(self, data: Mapping[str, Any]) -> None:
        """Set the complete data of the run, which replaces everything before."""
        self._end = encoded({"replace": data})
        self._tell()

    async def after(self, place: Place) -> tuple[str, Place]:
        """Wait until there is more than at `place`; return it as one JSON message, and the new position."""
        while True:
            news, told = self._news, self._after(place)
            if told is not None:
                return told
            await news.wait()

    def has_more(self, place: Place) -> bool:
        """Return whether there is more than at `place`."""
        return self._after(place) is not None

    def _after(self, place: Place) -> tuple[str, Place] | None:
        if place.ended:
            return None
        if self._end is not None:
            return self._end, Place(ended=True)
        # Most viewers are at the same position.
        if self._last is not None and self._last[0] == place:
            return self._last[1:]
        rows = {name: len(values) for name, values in self._columns.items()}
        if (rows, len(self._events)) != (place.rows, place.events):
            pool = {name: values[place.rows.get(name, 0) :] for name, values in self._columns.items()}
            told: dict[str, Any] = {"append": {"pool": pool, "events": self._events[place.events :]}}
            reached = replace(place, rows=rows, events=len(self._events))
        elif self._status != place.status:
            told, reached = {"status": self._status}, replace(place, status=self._status)
        else:
            return None
        self._last = (place, encoded(told), reached)
        return self._last[1:]

    def _tell(self) -> None:
        self._last = None
        news, self._news = self._news, asyncio.Event()
        news.set()


def encoded(message: Mapping[str, Any]) -> str:
    """Return a message as compact JSON."""
    return json.dumps(message, separators=(",", ":"), allow_nan=False)
