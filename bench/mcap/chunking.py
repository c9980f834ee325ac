"""Sorts encoded records into chunks by topic group, so that a reader unpacks only what it needs.

A chunk holds records of one group of channels: the raw frames of all buses (in their order), the decoded signals of one
bus, the truth, or the rest. All groups are written together, so that all groups of a truncated log end at nearly the
same time. MCAP lets the writer choose which channels share a chunk (https://mcap.dev/spec); readers that need time
order merge overlapping chunks by their index.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import numpy.typing as npt


class Records(NamedTuple):
    """Consecutive message records, and the index entry of each.

    `channel` (n,) channel ids, `log_time` (n,) ns, `offset` (n,) bytes from the start of `data`.
    """

    data: npt.NDArray[np.uint8]
    channel: npt.NDArray[np.int64]
    log_time: npt.NDArray[np.int64]
    offset: npt.NDArray[np.int64]

    def by_group(self, group: npt.NDArray[np.int64]) -> Iterator[tuple[int, Records]]:
        """Yield each group with its records; the records are sorted by `group` (n,)."""
        starts = np.flatnonzero(np.diff(group, prepend=-1)).tolist()
        for first, last in zip(starts, [*starts[1:], len(group)], strict=True):
            at = int(self.offset[first])
            end = int(self.offset[last]) if last < len(group) else len(self.data)
            rows = slice(first, last)
            yield (
                int(group[first]),
                Records(self.data[at:end], self.channel[rows], self.log_time[rows], self.offset[rows] - at),
            )


class ChunkGroups:
    """Collects encoded records until they are written, each group's in chunks of about `size` bytes."""

    def __init__(self, size: int) -> None:
        """Begin with nothing."""
        self._size = size
        self._chunks: dict[int, list[list[Records]]] = {}
        self.bytes = 0

    def add(self, group: int, records: Records) -> None:
        """Append records to the group; they go into one chunk."""
        chunks = self._chunks.setdefault(group, [[]])
        if chunks[-1] and sum(len(part.data) for part in chunks[-1]) + len(records.data) > self._size:
            chunks.append([])
        chunks[-1].append(records)
        self.bytes += len(records.data)

    def take(self) -> Iterator[Records]:
        """Yield the collected records as chunks, group by group, and empty the groups."""
        held, self._chunks, self.bytes = self._chunks, {}, 0
        for group in sorted(held):
            for parts in held[group]:
                yield _joined(parts)


def _joined(parts: list[Records]) -> Records:
    lengths = np.array([len(part.data) for part in parts])
    shifts = np.cumsum(lengths) - lengths
    return Records(
        np.concatenate([part.data for part in parts]),
        np.concatenate([part.channel for part in parts]),
        np.concatenate([part.log_time for part in parts]),
        np.concatenate([part.offset + shift for part, shift in zip(parts, shifts, strict=True)]),
    )
