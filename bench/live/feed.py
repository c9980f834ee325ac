"""What the viewers of the page are told: columns and events that grow, and in the end the whole data.

Nothing waits here for a viewer. Each viewer asks for what came after the place it has got to; one that reads slowly
asks less often and is told more at once, one that does not read costs no more than the message it was sent last.
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
    """How far a viewer has got.

    Attributes:
        rows: length of each column that it has been told.
        events: number of events that it has been told.
        status: the last status that it has been told.
        ended: whether it has been told the end.
    """

    rows: Mapping[str, int] = field(default_factory=dict)
    events: int = 0
    status: str = ""
    ended: bool = False


class Feed:
    """All that has been told so far."""

    def __init__(self) -> None:
        """Begin with nothing."""
        self._columns: dict[str, list[float | None]] = {}
        self._events: list[Sequence[Any]] = []
        self._status = ""
        self._end: str | None = None
        self._news = asyncio.Event()
        self._last: tuple[Place, str, Place] | None = None

    def append(self, pool: Pool, events: Sequence[Sequence[Any]]) -> None:
        """Tell values, of each column those that follow, and events: time in s, level, source, text."""
        for name, values in pool.items():
            self._columns.setdefault(name, []).extend(values)
        self._events += events
        self._tell()

    def say(self, status: str) -> None:
        """Tell what is going on."""
        self._status = status
        self._tell()

    def end(self, data: Mapping[str, Any]) -> None:
        """Tell the whole data object of the run, which takes the place of all before."""
        self._end = encoded({"replace": data})
        self._tell()

    async def after(self, place: Place) -> tuple[str, Place]:
        """Wait until there is more than at `place`; return it as one JSON message, and where that leads."""
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
        # Most viewers are at one place.
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
    """Return a message as JSON, as short as can be."""
    return json.dumps(message, separators=(",", ":"), allow_nan=False)
