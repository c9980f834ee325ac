"""Finds the records of an MCAP file, whole or broken, without trusting a length it reads.

The file is walked record by record. The walk ends at the first record that does not fit into the file, so that of a
broken file everything up to its last whole chunk is found. Nothing is allocated by a length that was read: sizes are
compared with what is there, and a chunk is unpacked into no more than `MAX_CHUNK` bytes.
"""

from __future__ import annotations

import io
import mmap
import struct
import zlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Header, Metadata, Schema

from bench.errors import BadInput
from bench.record.container import COMPRESSION, INDEX_ENTRY, MAGIC, MESSAGE, MESSAGE_FIELDS

MAX_CHUNK = 64 * 1024 * 1024
"""A chunk that claims to unpack to more bytes than this is taken for damaged."""

_RECORD = struct.Struct("<BQ")
_CHUNK = struct.Struct("<QQQII")
_INDEX = struct.Struct("<HI")
_DECOMPRESSOR = zstandard.ZstdDecompressor()


@dataclass(frozen=True)
class ChunkPlace:
    """Where a chunk is in the file.

    Attributes:
        at: first byte of its packed records.
        packed: how many bytes they are.
        size: bytes when unpacked.
        crc: CRC-32 of the unpacked records, 0 where the writer gave none.
        compression: `zstd` or nothing.
        indexes: channel id -> place and length of its message index entries.
    """

    at: int
    packed: int
    size: int
    crc: int
    compression: str
    indexes: dict[int, tuple[int, int]] = field(default_factory=dict)


@dataclass
class Contents:
    """What the walk found.

    Attributes:
        metadata: name -> values, in the order of the file; records of one name are merged.
        damage: what is wrong with the file, empty for a whole one.
    """

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    attachments: dict[str, bytes] = field(default_factory=dict)
    chunks: list[ChunkPlace] = field(default_factory=list)
    damage: str = ""


class ScannedFile:
    """An MCAP file open for reading, its records found.

    Attributes:
        path: the file.
        contents: what is in it.
    """

    def __init__(self, path: Path) -> None:
        """Open and walk the file.

        Raises:
            BadInput: the file cannot be read or is not MCAP.
        """
        self.path = path
        try:
            with path.open("rb") as stream:
                size = stream.seek(0, io.SEEK_END)
                # An empty file cannot be mapped.
                self._data: bytes | mmap.mmap = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) if size else b""
        except OSError as error:
            raise BadInput(f"cannot read the log {path}: {error.strerror or error}") from error
        if self._data[: len(MAGIC)] != MAGIC:
            raise BadInput(f"{path} is not an MCAP file: it does not begin with MCAP's magic bytes")
        self.contents = Contents()
        try:
            self._walk()
        except (McapError, struct.error, UnicodeDecodeError, ValueError) as error:
            self.contents.damage = f"a record cannot be read ({error})"

    def chunk(self, number: int) -> npt.NDArray[np.uint8] | None:
        """Return the unpacked records of chunk `number`, None where it is damaged."""
        place = self.contents.chunks[number]
        packed = self._data[place.at : place.at + place.packed]
        try:
            data = _unpacked(packed, place)
        except (zstandard.ZstdError, ValueError):
            return None
        if len(data) != place.size or (place.crc and zlib.crc32(data) != place.crc):
            return None
        return np.frombuffer(data, np.uint8)

    def messages(self, number: int, data: npt.NDArray[np.uint8]) -> dict[int, npt.NDArray[np.int64]]:
        """Return where the messages of each channel start in chunk `number`, whose records are `data`.

        From the message indexes where they name every record there is, else from a walk through the records.
        """
        places = self.contents.chunks[number].indexes.values()
        entries = np.frombuffer(b"".join(self._data[at : at + length] for at, length in places), INDEX_ENTRY)
        offsets = np.sort(entries["offset"].astype(np.int64))
        return _by_channel(data, offsets if _are_all_messages(data, offsets) else _walk_messages(data))

    def _walk(self) -> None:
        data, size = self._data, len(self._data)
        at = len(MAGIC)
        ended = False
        while at + _RECORD.size <= size:
            opcode, length = _RECORD.unpack_from(data, at)
            start = at + _RECORD.size
            if length > size - start:
                break
            if opcode == Opcode.FOOTER:
                ended = True
                break
            self._take(opcode, start, length)
            at = start + length
        if not ended or data[size - len(MAGIC) :] != MAGIC:
            self.contents.damage = "it ends before its summary; whole chunks are read up to there"

    def _take(self, opcode: int, at: int, length: int) -> None:
        if opcode == Opcode.CHUNK:
            self._take_chunk(at, length)
        elif opcode == Opcode.MESSAGE_INDEX:
            self._take_index(at, length)
        elif opcode in _SMALL:
            self._take_small(_SMALL[Opcode(opcode)].read(ReadDataStream(io.BytesIO(self._data[at : at + length]))))

    def _take_small(self, record: Header | Schema | Channel | Metadata | Attachment) -> None:
        contents = self.contents
        if isinstance(record, Schema):
            contents.schemas[record.id] = record
        elif isinstance(record, Channel):
            contents.channels[record.id] = record
        elif isinstance(record, Metadata):
            contents.metadata.setdefault(record.name, {}).update(record.metadata)
        elif isinstance(record, Attachment):
            contents.attachments[record.name] = record.data

    def _take_chunk(self, at: int, length: int) -> None:
        _, _, size, crc, name_length = _CHUNK.unpack_from(self._data, at)
        name_at = at + _CHUNK.size
        packed_at = name_at + name_length + 8
        if packed_at > at + length:
            raise ValueError("chunk shorter than its own header")
        name = str(self._data[name_at : name_at + name_length], "ascii")
        (packed,) = struct.unpack_from("<Q", self._data, name_at + name_length)
        if packed != at + length - packed_at:
            raise ValueError("chunk of another length than it says")
        place = ChunkPlace(packed_at, packed, size, crc, name)
        self.contents.chunks.append(place)

    def _take_index(self, at: int, length: int) -> None:
        channel, size = _INDEX.unpack_from(self._data, at)
        if self.contents.chunks and size == length - _INDEX.size and size % INDEX_ENTRY.itemsize == 0:
            self.contents.chunks[-1].indexes[channel] = (at + _INDEX.size, size)


_SMALL: dict[Opcode, Any] = {
    Opcode.SCHEMA: Schema,
    Opcode.CHANNEL: Channel,
    Opcode.METADATA: Metadata,
    Opcode.ATTACHMENT: Attachment,
}


def _unpacked(packed: bytes, place: ChunkPlace) -> bytes:
    if place.size > MAX_CHUNK:
        raise ValueError(f"a chunk of {place.size} bytes")
    if place.compression == "":
        return packed
    if place.compression != COMPRESSION:
        raise ValueError(f"compression {place.compression!r}")
    if zstandard.frame_content_size(packed) not in (-1, place.size):
        raise ValueError("the packed records are of another size than the chunk says")
    return _DECOMPRESSOR.decompress(packed, max_output_size=place.size)


def _are_all_messages(data: npt.NDArray[np.uint8], offsets: npt.NDArray[np.int64]) -> bool:
    """Return whether `data` is nothing but messages, one at each of the rising `offsets`, without a gap."""
    if not len(offsets) or offsets[0] != 0 or offsets[-1] > len(data) - MESSAGE.itemsize:
        return False
    heads = message_heads(data, offsets)
    lengths = np.diff(offsets, append=len(data)) - _RECORD.size
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
    heads: npt.NDArray[Any] = data[offsets[:, None] + np.arange(MESSAGE.itemsize)].view(MESSAGE).reshape(-1)
    return heads


def _walk_messages(data: npt.NDArray[np.uint8]) -> npt.NDArray[np.int64]:
    """Return where the messages among the records `data` start."""
    found = []
    raw, at = data.tobytes(), 0
    while at + _RECORD.size <= len(raw):
        opcode, length = _RECORD.unpack_from(raw, at)
        if length > len(raw) - at - _RECORD.size:
            break
        if opcode == Opcode.MESSAGE and length >= MESSAGE_FIELDS:
            found.append(at)
        at += _RECORD.size + length
    return np.array(found, np.int64)
