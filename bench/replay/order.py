"""Recorded frames in the order in which they ended on the wire, over all buses."""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Iterator
from typing import NamedTuple

from bench.record.can_frame import Frame

MOST_HELD = 100_000
"""Frames held back at most while an earlier one may still come."""


class Timed(NamedTuple):
    """A frame that is due: `due_ns` log time in ns; `number` its place in the log, which decides among equal times."""

    due_ns: int
    number: int
    bus: str
    can_id: int
    data: bytes


def in_order(frames: Iterable[Frame]) -> Iterator[Timed]:
    """Yield frames in the order they are due: by their end on the wire if the log has it, else by their cycle.

    A frame that never got onto the wire (the bus had no room) is due with the previous one on its bus. A frame
    that waited for its bus may be due in a later cycle than frames after it in the log, so frames are held until the
    log is past their time.
    """
    held: list[Timed] = []
    newest: dict[str, Timed] = {}
    for number, frame in enumerate(frames):
        while held and (held[0].due_ns < frame.time_ns or len(held) >= MOST_HELD):
            yield heapq.heappop(held)
        due = max(frame.wire_ns, frame.time_ns)
        if not frame.wire_ns and frame.bus in newest:
            due = max(due, newest[frame.bus].due_ns)
        newest[frame.bus] = Timed(due, number, frame.bus, frame.can_id, frame.data)
        heapq.heappush(held, newest[frame.bus])
    while held:
        yield heapq.heappop(held)
