"""Finds what is in an MCAP file by walking it record by record, for files without a valid summary.

At an impossible record (longer than the file, or of a kind that does not belong there) the walk continues at the next
chunk with a valid checksum: nothing else in a file proves what it is. In a truncated file, everything up to the last
complete chunk is found.
"""

from __future__ import annotations

import io
import mmap
import struct
from dataclasses import dataclass, field
from typing import Any

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Metadata, Schema

from bench.mcap.attachment import read_attachment
from bench.mcap.chunk import chunk_head, unpacked
from bench.mcap.container import COMPRESSION, MAGIC
from bench.mcap.contents import RECORD, Contents, chunks_of
from bench.mcap.pages import Pages
from bench.mcap.records import INDEX_ENTRY

CUT_OFF = "it ends before its summary; complete chunks are read up to there"

INDEX = struct.Struct("<HI")
"""The start of a message index: id of its channel, and the length of its entries in bytes."""

_DATA_END_LENGTH = 4
_PRIVATE = 0x80
"""Opcodes from here on are reserved for applications, and may occur anywhere."""

# What stands in a chunk's record so far from its beginning: the name of its compression, with its length before it.
_MARK = struct.pack("<I", len(COMPRESSION)) + COMPRESSION.encode()
_MARK_AT = RECORD.size + 28

_MOST_FALSE = 1000
"""Limit on false chunk candidates tried, so that no file can keep a reader busy for ever."""

_TOLD = 3
"""Limit on unreadable records named in `Contents.damage`."""


@dataclass
class Walked:
    """The result of a walk.

    Attributes:
        contents: what is in the file.
        ended: whether it reached the end of the data section, after which only the summary follows.
        lost: unreadable byte ranges of the file.
        damaged: records that could not be read, a few words each.
    """

    contents: Contents = field(default_factory=Contents)
    ended: bool = False
    lost: list[tuple[int, int]] = field(default_factory=list)
    damaged: list[str] = field(default_factory=list)


def walk(data: bytes | mmap.mmap, pages: Pages) -> Walked:
    """Return what is in a file; `data` is all of it and begins with the magic bytes."""
    walker = _Walker(data, pages)
    walker.walk()
    return walker.walked


class _Walker:
    def __init__(self, data: bytes | mmap.mmap, pages: Pages) -> None:
        self.walked = Walked()
        self._data = data
        self._pages = pages
        self._chunks: list[tuple[int, ...]] = []
        self._indexes: list[tuple[int, ...]] = []
        self._proven = len(MAGIC)
        self._false = 0

    def walk(self) -> None:
        found: int | None = len(MAGIC)
        while found is not None and not self.walked.ended:
            broken = self._walk_from(found)
            if not self.walked.ended:
                found = self._next_proven()
                end = len(self._data) if found is None else found
                self.walked.lost.append((min(broken, end), end))
        self.walked.contents.chunks = chunks_of(self._chunks, self._indexes)
        self.walked.contents.damage = self._damage()

    def _walk_from(self, at: int) -> int:
        """Read records from `at` to the end of the data section or the first impossible one; return the position."""
        size = len(self._data)
        while at + RECORD.size <= size:
            opcode, length = RECORD.unpack_from(self._data, at)
            if length > size - at - RECORD.size:
                return at
            if opcode == Opcode.DATA_END and length == _DATA_END_LENGTH:
                self.walked.ended = True
                return at
            try:
                if not self._take(opcode, at + RECORD.size, length):
                    return at
            except (ValueError, struct.error):
                return at
            self._pages.have_read(RECORD.size + length)
            at += RECORD.size + length
        return at

    def _take(self, opcode: int, at: int, length: int) -> bool:
        """Read one record; return whether its kind is possible here.

        Raises:
            ValueError, struct.error: its length contradicts its header.
        """
        if opcode == Opcode.CHUNK:
            head = chunk_head(self._data, at, length)
            self._chunks.append((at - RECORD.size, length, head.size, head.start_ns, head.end_ns))
            self._proven = at + length
        elif opcode == Opcode.MESSAGE_INDEX:
            self._take_index(at, length)
        elif opcode in _SMALL:
            self._take_small(opcode, self._data[at : at + length])
        return opcode in _SMALL or opcode in _OTHERS or opcode >= _PRIVATE

    def _take_small(self, opcode: int, record: bytes) -> None:
        contents = self.walked.contents
        try:
            if opcode == Opcode.ATTACHMENT:
                attachment = read_attachment(record)
                contents.attachments.setdefault(attachment.name, attachment.data)
                return
            read = _SMALL[opcode].read(ReadDataStream(io.BytesIO(record)))
        except (McapError, ValueError, struct.error) as error:
            what = _NAMES[opcode]
            self.walked.damaged.append(f"{what} cannot be read ({str(error) or type(error).__name__})")
            return
        if isinstance(read, Schema):
            contents.schemas.setdefault(read.id, read)
        elif isinstance(read, Channel):
            contents.channels.setdefault(read.id, read)
        else:
            contents.metadata.setdefault(read.name, {}).update(read.metadata)

    def _take_index(self, at: int, length: int) -> None:
        channel, size = INDEX.unpack_from(self._data, at)
        if size != length - INDEX.size:
            raise ValueError("message index whose length contradicts its header")
        if self._chunks and size % INDEX_ENTRY.itemsize == 0:
            self._indexes.append((len(self._chunks) - 1, channel, at - RECORD.size))
            counts = self.walked.contents.counts
            counts[channel] = counts.get(channel, 0) + size // INDEX_ENTRY.itemsize

    def _next_proven(self) -> int | None:
        """Return where, after the last chunk, the next one with a valid checksum starts; None if there is none."""
        mark = self._data.find(_MARK, self._proven + _MARK_AT)
        while mark >= 0 and self._false < _MOST_FALSE:
            if self._is_proven(mark - _MARK_AT):
                return mark - _MARK_AT
            self._false += 1
            mark = self._data.find(_MARK, mark + 1)
        return None

    def _is_proven(self, at: int) -> bool:
        opcode, length = RECORD.unpack_from(self._data, at)
        if opcode != Opcode.CHUNK or length > len(self._data) - at - RECORD.size:
            return False
        try:
            head = chunk_head(self._data, at + RECORD.size, length)
            unpacked(self._data, head)
        except (zstandard.ZstdError, ValueError, struct.error):
            return False
        return head.crc != 0

    def _damage(self) -> str:
        """Return all problems of the walk, in one line."""
        walked, size = self.walked, len(self._data)
        inside = sum(end - start for start, end in walked.lost if end < size)
        found = [f"{inside} bytes in it cannot be read and are skipped"] if inside else []
        if not walked.ended or self._data[size - len(MAGIC) :] != MAGIC:
            found.append(CUT_OFF)
        found += walked.damaged[:_TOLD]
        if len(walked.damaged) > _TOLD:
            found.append(f"{len(walked.damaged) - _TOLD} more records cannot be read")
        return "; ".join(found)


_SMALL: dict[int, Any] = {
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.METADATA: Metadata,
    Opcode.ATTACHMENT: None,
}
_NAMES: dict[int, str] = {
    Opcode.SCHEMA: "a schema",
    Opcode.CHANNEL: "a channel",
    Opcode.METADATA: "a metadata record",
    Opcode.ATTACHMENT: "an attachment",
}
_OTHERS = (Opcode.HEADER, Opcode.MESSAGE, Opcode.CHUNK, Opcode.MESSAGE_INDEX)
