"""Finds what is in an MCAP file by walking it record by record, for files that have no summary that proves itself.

Where a record cannot be, as it is longer than the file or of no kind that belongs there, the walk goes on at the next
chunk whose records are those that its checksum is of: nothing else in a file proves that it is what it seems to be.
Of a file that was cut off, everything up to its last whole chunk is found.
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
from bench.mcap.container import COMPRESSION, INDEX_ENTRY, MAGIC
from bench.mcap.contents import RECORD, Contents, chunks_of
from bench.mcap.pages import Pages

CUT_OFF = "it ends before its summary; whole chunks are read up to there"

INDEX = struct.Struct("<HI")
"""What a message index begins with: id of its channel, and the length of its entries in bytes."""

_DATA_END_LENGTH = 4
_PRIVATE = 0x80
"""Opcodes from here on are for others than the format's makers, and may be anywhere."""

# What stands in a chunk's record so far from its beginning: the name of its compression, with its length before it.
_MARK = struct.pack("<I", len(COMPRESSION)) + COMPRESSION.encode()
_MARK_AT = RECORD.size + 28

_MOST_FALSE = 1000
"""Places that look like a chunk and are none that are tried at most, so that no file can keep a reader for ever."""

_TOLD = 3
"""Records that cannot be read that `Contents.damage` names at most."""


@dataclass
class Walked:
    """What a walk has found.

    Attributes:
        contents: what is in the file.
        ended: whether it came to the end of the data section, after which there is only the summary.
        lost: from where to where the file could not be read, bytes.
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
        """Take records from `at` on up to the end of the data section, or to the first that cannot be; return where."""
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
        """Take in one record; return whether there can be one of its kind.

        Raises:
            ValueError, struct.error: it is of another length than it says.
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
            raise ValueError("message index of another length than it says")
        if self._chunks and size % INDEX_ENTRY.itemsize == 0:
            self._indexes.append((len(self._chunks) - 1, channel, at - RECORD.size))
            counts = self.walked.contents.counts
            counts[channel] = counts.get(channel, 0) + size // INDEX_ENTRY.itemsize

    def _next_proven(self) -> int | None:
        """Return where, after the last chunk, the next one starts that its checksum proves; None where none does."""
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
        """Return all that the walk has met, in one line."""
        walked, size = self.walked, len(self._data)
        inside = sum(end - start for start, end in walked.lost if end < size)
        found = [f"{inside} bytes in it cannot be read and are left out"] if inside else []
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
    Opcode.METADATA: "a record of metadata",
    Opcode.ATTACHMENT: "an attachment",
}
_OTHERS = (Opcode.HEADER, Opcode.MESSAGE, Opcode.CHUNK, Opcode.MESSAGE_INDEX)
