"""Finds the records of an MCAP file, whole or damaged, without trusting any length in it.

A file with a valid summary is opened by it (`bench.mcap.summary`). Any other is walked record by record
(`bench.mcap.walk`). Nothing is allocated by a length from the file: sizes are compared with what is there, and a
chunk is unpacked into no more than `bench.mcap.chunk.MAX_CHUNK` bytes.
"""

from __future__ import annotations

import io
import mmap
import struct
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import zstandard
from mcap.opcode import Opcode

from bench.errors import BadInput
from bench.mcap import limits
from bench.mcap.chunk import chunk_head, unpacked
from bench.mcap.container import MAGIC
from bench.mcap.contents import RECORD
from bench.mcap.gathering import gathered
from bench.mcap.pages import AROUND, Pages
from bench.mcap.records import INDEX_ENTRY, MESSAGE, MESSAGE_FIELDS
from bench.mcap.summary import read_summary
from bench.mcap.walk import INDEX, Walked, walk

MAX_KEPT = 32 * 1024 * 1024
"""Chunks are kept unpacked if all of a file's together are at most this many bytes; a run of 10 s has about 12 MB."""


class ScannedFile:
    """An MCAP file open for reading, its records found.

    Attributes:
        path: the file.
        contents: what is in it.
        walked: the result of walking it; None for a file opened by its summary.
        size: bytes of the file.
    """

    def __init__(self, path: Path) -> None:
        """Open the file and find out what is in it.

        Raises:
            BadInput: the file cannot be read, is not MCAP or is beyond `limits`.
        """
        self.path = path
        try:
            with path.open("rb") as stream:
                self.size = stream.seek(0, io.SEEK_END)
                # An empty file cannot be mapped.
                self._data: bytes | mmap.mmap = (
                    mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) if self.size else b""
                )
        except OSError as error:
            raise BadInput(f"cannot read the log {path}: {error.strerror or error}") from error
        if not self.size:
            raise BadInput(f"{path} is empty: it holds no log")
        if self._data[: len(MAGIC)] != MAGIC:
            raise BadInput(f"{path} is not an MCAP file: it does not begin with MCAP's magic bytes")
        self._pages = Pages(self._data)
        contents = read_summary(self._data)
        self.walked: Walked | None = None
        if contents is None:
            self.walked = walk(self._data, self._pages)
            contents = self.walked.contents
        limits.check(path, contents)
        self.contents = contents
        small = self.contents.chunks.places["size"].sum(dtype=np.float64) <= MAX_KEPT
        self._kept: dict[int, npt.NDArray[np.uint8]] | None = {} if small else None

    def chunk(self, number: int) -> npt.NDArray[np.uint8] | None:
        """Return the unpacked records of chunk `number`, None where it is damaged."""
        if self._kept is not None and number in self._kept:
            return self._kept[number]
        at, expected = self.contents.chunks.places[["at", "length"]][number].tolist()
        try:
            opcode, length = RECORD.unpack_from(self._data, at)
            if opcode != Opcode.CHUNK or length != expected:
                return None
            head = chunk_head(self._data, at + RECORD.size, length)
            data = unpacked(self._data, head)
        except (zstandard.ZstdError, ValueError, struct.error):
            return None
        self._pages.have_read(head.packed + AROUND)
        records = np.frombuffer(data, np.uint8)
        if self._kept is not None:
            self._kept[number] = records
        return records

    def entries(self, at: int, channel: int) -> bytes | None:
        """Return the message index at `at`, a channel's, as bytes of `INDEX_ENTRY`; None where it is damaged."""
        try:
            opcode, length = RECORD.unpack_from(self._data, at)
            named, size = INDEX.unpack_from(self._data, at + RECORD.size)
        except struct.error:
            return None
        start = at + RECORD.size + INDEX.size
        if opcode != Opcode.MESSAGE_INDEX or named != channel or size != length - INDEX.size:
            return None
        entries = self._data[start : start + size]
        return entries if len(entries) == size and size % INDEX_ENTRY.itemsize == 0 else None

    def messages(self, number: int, data: npt.NDArray[np.uint8]) -> dict[int, npt.NDArray[np.int64]]:
        """Return where the messages of each channel start in chunk `number`, whose records are `data`.

        From the message indexes if they name every record, else from a walk through the records. Indexes found to be
        correct are trusted from then on.
        """
        chunks = self.contents.chunks
        places = chunks.indexes_of(number)[["channel", "at"]].tolist()
        parts = {channel: self.entries(at, channel) or b"" for channel, at in places}
        indexed = {
            channel: np.frombuffer(part, INDEX_ENTRY)["offset"].astype(np.int64) for channel, part in parts.items()
        }
        offsets = np.sort(np.concatenate([np.empty(0, np.int64), *indexed.values()]))
        if not _are_all_messages(data, offsets):
            return _by_channel(data, _walk_messages(data))
        found = _by_channel(data, offsets)
        if found.keys() == indexed.keys() and all(np.array_equal(found[each], indexed[each]) for each in found):
            chunks.note_complete(number)
        return found


def _are_all_messages(data: npt.NDArray[np.uint8], offsets: npt.NDArray[np.int64]) -> bool:
    """Return whether `data` is nothing but messages, one at each of the rising `offsets`, without a gap."""
    if not len(offsets) or offsets[0] != 0 or offsets[-1] > len(data) - MESSAGE.itemsize:
        return False
    heads = message_heads(data, offsets)
    lengths = np.diff(offsets, append=len(data)) - RECORD.size
    messages = (heads["opcode"] == Opcode.MESSAGE) & (heads["length"] == lengths.astype(np.uint64))
    return bool((messages & (lengths >= MESSAGE_FIELDS)).all())


def _by_channel(data: npt.NDArray[np.uint8], offsets: npt.NDArray[np.int64]) -> dict[int, npt.NDArray[np.int64]]:
    """Return the offsets of each channel's messages, in the order of the file."""
    channels = message_heads(data, offsets)["channel"]
    order = np.argsort(channels, kind="stable")
    found, starts = np.unique(channels[order], return_index=True)
    return dict(zip(found.tolist(), np.split(offsets[order], starts[1:]), strict=True)) if len(found) else {}


def message_heads(data: npt.NDArray[np.uint8], offsets: npt.NDArray[np.int64]) -> npt.NDArray[Any]:
    """Return the heads, as `MESSAGE`, of the message records that start at `offsets` (n,) in `data`."""
    heads: npt.NDArray[Any] = gathered(data, offsets, MESSAGE.itemsize).view(MESSAGE).reshape(-1)
    return heads


def _walk_messages(data: npt.NDArray[np.uint8]) -> npt.NDArray[np.int64]:
    """Return where the messages among the records `data` start."""
    found = []
    raw, at = data.tobytes(), 0
    while at + RECORD.size <= len(raw):
        opcode, length = RECORD.unpack_from(raw, at)
        if length > len(raw) - at - RECORD.size:
            break
        if opcode == Opcode.MESSAGE and length >= MESSAGE_FIELDS:
            found.append(at)
        at += RECORD.size + length
    return np.array(found, np.int64)
