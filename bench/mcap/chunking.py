"""Sorts encoded records into chunks by topic group, so that a reader unpacks only what it needs.

A chunk holds records of one group of channels: the raw frames of all buses (in their order), the decoded signals of one
bus, the truth, or the rest. All groups are written together, so that all groups of a truncated log end at nearly the
same time. MCAP lets the writer choose which channels share a chunk (https://mcap.dev/spec); readers that need time
order merge overlapping chunks by their index.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from bench.mcap.records import Records


class ChunkGroups:
    """Collects encoded records until they are written, each group's in chunks of about `size` bytes."""

    def __init__(self, size: int) -> None:
        """Begin with nothing."""
        self._size = size
        self._chunks: dict[int, list[list[Records]]] = {}
        self.bytes = 0

    def add(self, group: int, records: Records) -> None:
        """Append records to the group, to its newest chunk as far as they fit."""
        chunks = self._chunks.setdefault(group, [[]])
        self.bytes += len(records.data)
        while len(records.data):
            room = self._size - sum(len(part.data) for part in chunks[-1])
            first, rest = records.parted(room, at_least=0 if chunks[-1] else 1)
            if len(first.data):
                chunks[-1].append(first)
            if len(rest.data):
                chunks.append([])
            records = rest

    def take(self) -> Iterator[Records]:
        """Yield the collected records as chunks, group by group, and empty the groups."""
        held, self._chunks, self.bytes = self._chunks, {}, 0
        for group in sorted(held):
            yield from (_joined(parts) for parts in held[group] if parts)


def _joined(parts: list[Records]) -> Records:
    lengths = np.array([len(part.data) for part in parts])
    shifts = np.cumsum(lengths) - lengths
    return Records(
        np.concatenate([part.data for part in parts]),
        np.concatenate([part.channel for part in parts]),
        np.concatenate([part.log_time for part in parts]),
        np.concatenate([part.offset + shift for part, shift in zip(parts, shifts, strict=True)]),
    )
