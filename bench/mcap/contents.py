"""What is in an MCAP file, and where, according to its records or its summary."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
from mcap.records import Channel, Schema

from bench.mcap.time_span import ALL, FOREVER_NS, Span

RECORD = struct.Struct("<BQ")
"""The start of a record: opcode, and the length of the rest."""

CHUNK_PLACE = np.dtype([("at", "<i8"), ("length", "<i8"), ("size", "<i8"), ("start_ns", "<i8"), ("end_ns", "<i8")])
"""A chunk: first byte of its record, bytes of that without `RECORD`, bytes when unpacked, log_time from and to."""

INDEX_PLACE = np.dtype([("chunk", "<i8"), ("channel", "<i8"), ("at", "<i8")])
"""A message index: number of its chunk, id of its channel, first byte of its record."""

Places = npt.NDArray[np.int64]


class Chunks:
    """The chunks of a file, in its order, and their message indexes.

    Attributes:
        places: as `CHUNK_PLACE` (n,).
    """

    def __init__(self, places: npt.NDArray[Any], indexes: npt.NDArray[Any], *, complete: bool) -> None:
        """Hold the chunks.

        Args:
            places: as `CHUNK_PLACE` (n,).
            indexes: as `INDEX_PLACE` (m,), in the order of the chunks.
            complete: whether every chunk that has indexes is known to have all of them.
        """
        self.places = places
        self._indexes = indexes
        by_channel = np.argsort(indexes["channel"], kind="stable")
        found, starts = np.unique(indexes["channel"][by_channel], return_index=True)
        rows = np.split(by_channel, starts[1:]) if len(found) else []
        self._rows = dict(zip(found.tolist(), rows, strict=True))
        self._indexed = np.zeros(len(places), np.bool_)
        if complete:
            self._indexed[indexes["chunk"]] = True

    def __len__(self) -> int:
        """Return the number of chunks."""
        return len(self.places)

    def having(self, channels: Sequence[int], span: Span = ALL) -> list[int]:
        """Return the numbers of the chunks that may have messages of these channels and times."""
        wanted = ~self._indexed
        for channel in channels:
            if channel in self._rows:
                wanted[self._indexes["chunk"][self._rows[channel]]] = True
        wanted &= (self.places["end_ns"] >= span.start_ns) & (self.places["start_ns"] < span.end_ns)
        found: list[int] = np.flatnonzero(wanted).tolist()
        return found

    def note_complete(self, number: int) -> None:
        """Note that a chunk's indexes are complete and correct."""
        self._indexed[number] = True

    def are_indexed(self, numbers: Sequence[int]) -> bool:
        """Return whether all messages of these chunks are known to be in their indexes."""
        return bool(self._indexed[list(numbers)].all())

    def indexes(self, channel: int) -> npt.NDArray[Any]:
        """Return the message indexes of a channel as `INDEX_PLACE`, in the order of the chunks."""
        found: npt.NDArray[Any] = self._indexes[self._rows.get(channel, [])]
        return found

    def indexes_of(self, number: int) -> npt.NDArray[Any]:
        """Return the message indexes of a chunk as `INDEX_PLACE`."""
        first, last = np.searchsorted(self._indexes["chunk"], (number, number + 1))
        found: npt.NDArray[Any] = self._indexes[first:last]
        return found


def chunks_of(places: Sequence[tuple[int, ...]], indexes: Sequence[tuple[int, ...]]) -> Chunks:
    """Return chunks whose records were read one by one; numbers too large are clipped to the largest possible."""
    tables = [
        np.array([tuple(min(number, FOREVER_NS - 1) for number in row) for row in rows], kind)
        for rows, kind in ((places, CHUNK_PLACE), (indexes, INDEX_PLACE))
    ]
    return Chunks(*tables, complete=False)


@dataclass
class Contents:
    """The contents of a file.

    Attributes:
        schemas, channels: by their ids.
        metadata: name -> values, in the order of the file; records of one name are merged.
        attachments: name -> content.
        chunks: where the messages are.
        counts: channel id -> number of messages, from the summary or the message indexes.
        damage: what is wrong with the file, empty for a whole one.
    """

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)
    chunks: Chunks = field(default_factory=lambda: chunks_of([], []))
    counts: dict[int, int] = field(default_factory=dict)
    damage: str = ""
