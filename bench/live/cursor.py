"""How far a log that is being written has been delivered, and what comes next."""

from __future__ import annotations

from typing import NamedTuple

from bench.live.tail import Chunk, Tail

BEHIND_NS = 500_000_000
"""A group of channels further behind the others than this has ended."""

LAG_NS = 80_000_000
"""Frames of a busy bus may be logged some cycles after the truth of their time, and a curve of diagnostics goes on to
their next frame; only older data is delivered."""

BEFORE_NS = 100_000_000
"""Cycle time of the slowest diagnostics: a frame from so long before a span is still valid at its start."""

SPAN_NS = 2_000_000_000
"""Simulated time delivered at once; a viewer that joins late gets the log piece by piece."""


class Span(NamedTuple):
    """A span of simulated time of which the log holds everything.

    Attributes:
        start_ns, end_ns: from the first, until before the second.
        chunks: those that hold data of it, of the time just before that is valid in its first cycles, or of the time
            just after to which its curves lead.
    """

    start_ns: int
    end_ns: int
    chunks: list[Chunk]


class Cursor:
    """A position in a log that only moves forward.

    Attributes:
        told_ns: everything before this time has been delivered.
    """

    def __init__(self) -> None:
        """Begin at the start of the log."""
        self.told_ns = 0
        self._first = 0

    def next(self, tail: Tail) -> Span | None:
        """Return the span to deliver next; None if none is complete yet."""
        chunks = tail.chunks
        before = self.told_ns - BEFORE_NS
        while self._first < len(chunks) and chunks[self._first].end_ns < before:
            self._first += 1
        later = [chunk for chunk in chunks[self._first :] if chunk.end_ns >= before]
        if not later:
            return None
        complete = max(tail.groups.complete_ns, tail.newest_ns - BEHIND_NS) - LAG_NS
        start = max(self.told_ns, min(chunk.start_ns for chunk in later))
        end = min(start + SPAN_NS, tail.newest_ns + 1 if tail.ended else complete)
        if end <= start:
            return None
        # A curve goes straight on to the frame after the span.
        return Span(start, end, [chunk for chunk in later if chunk.start_ns < end + LAG_NS])
