"""One chunk record of an MCAP file: what it says of itself, and its records, without trusting either."""

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
"""A chunk that claims to unpack to more bytes than this is taken for damaged."""

# Of a larger one only as much memory is taken as comes out of it.
_AT_ONCE = 1024 * 1024

_HEAD = struct.Struct("<QQQII")
# What tools other than ours may have packed a log's chunks with.
_LZ4 = "lz4"
_DECOMPRESSOR = zstandard.ZstdDecompressor()


@dataclass(frozen=True, slots=True)
class ChunkHead:
    """What stands before a chunk's packed records.

    Attributes:
        start_ns, end_ns: log_time of its earliest and latest message.
        at: first byte of its packed records.
        packed: how many bytes they are.
        size: bytes when unpacked.
        crc: CRC-32 of the unpacked records, 0 where the writer gave none.
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
        ValueError, struct.error: the record is of another length than it says.
    """
    start_ns, end_ns, size, crc, name_length = _HEAD.unpack_from(data, at)
    name_at = at + _HEAD.size
    packed_at = name_at + name_length + 8
    if packed_at > at + length:
        raise ValueError("chunk shorter than its own header")
    name = str(data[name_at : name_at + name_length], "ascii")
    (packed,) = struct.unpack_from("<Q", data, name_at + name_length)
    if packed != at + length - packed_at:
        raise ValueError("chunk of another length than it says")
    return ChunkHead(start_ns, end_ns, packed_at, packed, size, crc, name)


def unpacked(data: bytes | mmap.mmap, head: ChunkHead) -> bytes:
    """Return the records of a chunk.

    Raises:
        ValueError, zstandard.ZstdError: they are damaged: they do not unpack, not to as many bytes as it says, or not
            to those that its checksum is of.
    """
    records = _decompressed(data[head.at : head.at + head.packed], head)
    if len(records) != head.size:
        raise ValueError("a chunk of another size than it says")
    if head.crc and zlib.crc32(records) != head.crc:
        raise ValueError("a chunk that its checksum is not of")
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
        raise ValueError("the packed records are of another size than the chunk says")
    if head.size <= _AT_ONCE:
        return _DECOMPRESSOR.decompress(packed, max_output_size=head.size)
    with _DECOMPRESSOR.stream_reader(packed) as stream:
        return _read(stream, head.size)


def _read(stream: BinaryIO, size: int) -> bytes:
    """Return what a stream gives: `size` bytes, or if it gives more than that, not all of it."""
    parts = io.BytesIO()
    while parts.tell() <= size and (part := stream.read(_AT_ONCE)):
        parts.write(part)
    return parts.getvalue()
