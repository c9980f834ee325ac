"""One chunk record of an MCAP file: its header and its records, trusting neither."""

from __future__ import annotations

import io
import mmap
import struct
import zlib
from dataclasses import dataclass
from typing import BinaryIO

import lz4.frame
import zstandard

from bench.mcap.container import COMPRESSION

MAX_CHUNK = 64 * 1024 * 1024
"""A chunk that claims a larger unpacked size (bytes) counts as damaged."""

# For a larger one, memory grows only with its actual output.
_AT_ONCE = 1024 * 1024

_HEAD = struct.Struct("<QQQII")
# LZ4, which other tools may have packed a log's chunks with.
_LZ4 = "lz4"
_DECOMPRESSOR = zstandard.ZstdDecompressor()


@dataclass(frozen=True, slots=True)
class ChunkHead:
    """The header before a chunk's packed records.

    Attributes:
        start_ns, end_ns: log_time of its earliest and latest message.
        at: first byte of its packed records.
        packed: their size in bytes.
        size: bytes when unpacked.
        crc: CRC-32 of the unpacked records, 0 if the writer gave none.
        compression: `zstd`, `lz4` or nothing.
    """

    start_ns: int
    end_ns: int
    at: int
    packed: int
    size: int
    crc: int
    compression: str


def chunk_head(data: bytes | mmap.mmap, at: int, length: int) -> ChunkHead:
    """Return the head of a chunk record whose content starts at `at` and is `length` bytes, all of them in `data`.

    Raises:
        ValueError, struct.error: the record's length contradicts its header.
    """
    start_ns, end_ns, size, crc, name_length = _HEAD.unpack_from(data, at)
    name_at = at + _HEAD.size
    packed_at = name_at + name_length + 8
    if packed_at > at + length:
        raise ValueError("chunk shorter than its own header")
    name = str(data[name_at : name_at + name_length], "ascii")
    (packed,) = struct.unpack_from("<Q", data, name_at + name_length)
    if packed != at + length - packed_at:
        raise ValueError("chunk whose length contradicts its header")
    return ChunkHead(start_ns, end_ns, packed_at, packed, size, crc, name)


def unpacked(data: bytes | mmap.mmap, head: ChunkHead) -> bytes:
    """Return the records of a chunk.

    Raises:
        ValueError, zstandard.ZstdError: they are damaged: they do not unpack, or their size or checksum is wrong.
    """
    records = _decompressed(data[head.at : head.at + head.packed], head)
    if len(records) != head.size:
        raise ValueError("a chunk whose size contradicts its header")
    if head.crc and zlib.crc32(records) != head.crc:
        raise ValueError("a chunk with a wrong checksum")
    return records


def _decompressed(packed: bytes, head: ChunkHead) -> bytes:
    if head.size > MAX_CHUNK:
        raise ValueError(f"a chunk of {head.size} bytes")
    if head.compression == "":
        return packed
    if head.compression == _LZ4:
        try:
            with lz4.frame.open(io.BytesIO(packed)) as stream:
                return _read(stream, head.size)
        except (EOFError, RuntimeError) as error:
            raise ValueError("the packed records cannot be unpacked") from error
    if head.compression != COMPRESSION:
        raise ValueError(f"compression {head.compression!r}")
    if zstandard.frame_content_size(packed) not in (-1, head.size):
        raise ValueError("the packed records have another size than the chunk's header says")
    if head.size <= _AT_ONCE:
        return _DECOMPRESSOR.decompress(packed, max_output_size=head.size)
    with _DECOMPRESSOR.stream_reader(packed) as stream:
        return _read(stream, head.size)


def _read(stream: BinaryIO, size: int) -> bytes:
    """Return the output of a stream: `size` bytes, or slightly more if there is more."""
    parts = io.BytesIO()
    while parts.tell() <= size and (part := stream.read(_AT_ONCE)):
        parts.write(part)
    return parts.getvalue()
