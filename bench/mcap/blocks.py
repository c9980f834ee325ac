"""Unpacked chunks, a few at a time, with the offsets of some channels' messages in them.

A message takes some 50 bytes and a chunk has a few dozen of a channel, too few for numpy to be efficient: so chunks
are joined into blocks. Only chunks with requested channels and times are read.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from mcap.opcode import Opcode

from bench.mcap.records import INDEX_ENTRY, MESSAGE, MESSAGE_FIELDS
from bench.mcap.scan import ScannedFile, message_heads
from bench.mcap.time_span import ALL, Span

BLOCK_BYTES = 4 * 1024 * 1024
"""Chunks are joined up to this size; a larger chunk is a separate block."""

Bytes = npt.NDArray[np.uint8]
Places = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Part:
    """Messages of one channel.

    Attributes:
        data: the records of a block, chunk after chunk.
        offsets: where the messages start in it (n,), rising.
        heads: their `MESSAGE` heads (n,).
    """

    data: Bytes
    offsets: Places
    heads: npt.NDArray[Any]

    @property
    def time_ns(self) -> Places:
        """Their log_time (n,), ns."""
        return self.heads["log_time"].astype(np.int64)

    @property
    def payload_at(self) -> Places:
        """Where the payloads start (n,)."""
        return self.offsets + MESSAGE.itemsize

    @property
    def payload_size(self) -> Places:
        """How long the payloads are (n,), bytes."""
        return self.heads["length"].astype(np.int64) - MESSAGE_FIELDS

    def within(self, span: Span) -> Part:
        """Return the messages whose log_time is in `span`."""
        if span == ALL:
            return self
        inside = span.holds(self.time_ns)
        return Part(self.data, self.offsets[inside], self.heads[inside])

    def payloads(self) -> Iterator[bytes]:
        """Give the payloads."""
        for start, size in zip(self.payload_at.tolist(), self.payload_size.tolist(), strict=True):
            yield self.data[start : start + size].tobytes()


def blocks(
    file: ScannedFile, channels: Sequence[int], numbers: Sequence[int], on_damage: Callable[[int], None]
) -> Iterator[dict[int, Part]]:
    """Yield the messages of some channels from these chunks, block by block in file order, each by channel.

    Args:
        file: the file.
        channels: ids of the channels.
        numbers: the chunks, as `Chunks.having` gives them.
        on_damage: called with the number of each damaged chunk, which is skipped.
    """
    for group in _groups(file.contents.chunks.places["size"][list(numbers)].tolist(), numbers):
        found = {}
        for number in group:
            records = file.chunk(number)
            if records is None:
                on_damage(number)
            else:
                found[number] = records
        if found:
            block = _Block(file, found)
            # In a truncated file the last message indexes may be missing.
            indexed = file.contents.chunks.are_indexed(list(found))
            yield (block.indexed(channels) if indexed else None) or block.walked(channels)


def _groups(sizes: Sequence[int], numbers: Sequence[int]) -> Iterator[list[int]]:
    group: list[int] = []
    held = 0
    for number, size in zip(numbers, sizes, strict=True):
        if group and held + size > BLOCK_BYTES:
            yield group
            group, held = [], 0
        group.append(number)
        held += size
    if group:
        yield group


class _Block:
    """Some unpacked chunks (number -> records), put together."""

    def __init__(self, file: ScannedFile, chunks: dict[int, Bytes]) -> None:
        self._file = file
        self._chunks = chunks
        self._data = np.concatenate(list(chunks.values())) if len(chunks) > 1 else next(iter(chunks.values()))
        ends = itertools.accumulate(len(records) for records in chunks.values())
        self._rooms = {number: (end - len(chunks[number]), end) for number, end in zip(chunks, ends, strict=True)}

    def indexed(self, channels: Sequence[int]) -> dict[int, Part] | None:
        """Return the messages of each channel that has any, from the message indexes; None if one is wrong."""
        parts = {}
        for channel in channels:
            part = self._indexed(channel)
            if part is None:
                return None
            if len(part.offsets):
                parts[channel] = part
        return parts

    def walked(self, channels: Sequence[int]) -> dict[int, Part]:
        """Return the messages of each channel that has any, from the records themselves."""
        found: dict[int, list[Places]] = {channel: [] for channel in channels}
        for number, records in self._chunks.items():
            for channel, offsets in self._file.messages(number, records).items():
                if channel in found:
                    found[channel].append(offsets + self._rooms[number][0])
        return {channel: self._part(np.concatenate(places)) for channel, places in found.items() if places}

    def _indexed(self, channel: int) -> Part | None:
        indexes = self._file.contents.chunks.indexes(channel)
        first, last = np.searchsorted(indexes["chunk"], (min(self._chunks), max(self._chunks) + 1))
        parts, rooms = [], []
        for number, at in indexes[["chunk", "at"]][first:last].tolist():
            if number in self._rooms:
                entries = self._file.entries(at, channel)
                if entries is None:
                    return None
                parts.append(entries)
                rooms.append((*self._rooms[number], len(entries) // INDEX_ENTRY.itemsize))
        start, end, count = np.array(rooms, np.int64).reshape(-1, 3).T
        offsets = np.frombuffer(b"".join(parts), INDEX_ENTRY)["offset"].astype(np.int64)
        ends = np.repeat(end, count)
        if (offsets < 0).any() or (offsets > np.repeat(end - start, count) - MESSAGE.itemsize).any():
            return None
        offsets += np.repeat(start, count)
        if (offsets[1:] <= offsets[:-1]).any():
            return None
        part = self._part(offsets)
        good = (part.heads["opcode"] == Opcode.MESSAGE) & (part.heads["channel"] == channel)
        good &= (part.payload_size >= 0) & (part.payload_size <= ends - part.payload_at)
        return part if good.all() else None

    def _part(self, offsets: Places) -> Part:
        return Part(self._data, offsets, message_heads(self._data, offsets))
