"""A piece of a log as a complete log: records and chunks byte for byte, with a summary of its own."""

from __future__ import annotations

import io
import struct
import zlib
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import BinaryIO

from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    ChunkIndex,
    DataEnd,
    Footer,
    McapRecord,
    Metadata,
    MetadataIndex,
    Statistics,
)

from bench.mcap.container import MAGIC

_RECORD = struct.Struct("<BQ")
_CHUNK = struct.Struct("<QQQII")

Indexes = Mapping[int, tuple[int, int]]
"""Of a chunk: channel id -> place of its message index, from the chunk's first byte, and number of its messages."""


def write_piece(
    stream: BinaryIO, head: Sequence[tuple[int, bytes]], chunks: Iterable[tuple[bytes, int, Indexes]]
) -> None:
    """Write a log.

    Args:
        stream: where to, at its start.
        head: opcode and bytes of each record outside chunks: header, metadata, attachments, schemas, channels.
        chunks: each with the message indexes that follow it, the number of bytes of these, and where they are.
    """
    at = stream.write(MAGIC)
    summary: dict[int, RecordBuilder] = {}
    counts: Counter[int] = Counter()
    kinds = Counter(opcode for opcode, _ in head)
    for opcode, record in head:
        if opcode in (Opcode.ATTACHMENT, Opcode.METADATA):
            _index_of(opcode, record, at).write(summary.setdefault(opcode, RecordBuilder()))
        at += stream.write(record)
    times: list[int] = []
    for chunk, indexes_size, indexes in chunks:
        index = _chunk_index(chunk, indexes_size, indexes, at)
        index.write(summary.setdefault(Opcode.CHUNK_INDEX, RecordBuilder()))
        times += [index.message_start_time, index.message_end_time]
        counts.update({channel: count for channel, (_, count) in indexes.items()})
        at += stream.write(chunk)
    at += stream.write(_encoded(DataEnd(0)))
    statistics = Statistics(
        attachment_count=kinds[Opcode.ATTACHMENT],
        channel_count=kinds[Opcode.CHANNEL],
        channel_message_counts=dict(counts),
        chunk_count=len(times) // 2,
        message_count=counts.total(),
        message_start_time=min(times, default=0),
        message_end_time=max(times, default=0),
        metadata_count=kinds[Opcode.METADATA],
        schema_count=kinds[Opcode.SCHEMA],
    )
    named = b"".join(record for opcode, record in head if opcode in (Opcode.SCHEMA, Opcode.CHANNEL))
    section = named + _encoded(statistics) + b"".join(_taken(builder) for builder in summary.values())
    footer = struct.pack("<BQQQ", Opcode.FOOTER, 20, at, 0)
    stream.write(section + _encoded(Footer(at, 0, zlib.crc32(footer, zlib.crc32(section)))) + MAGIC)


def _index_of(opcode: int, record: bytes, at: int) -> AttachmentIndex | MetadataIndex:
    """Return the index of an attachment or metadata record that is written at `at`."""
    fields = ReadDataStream(io.BytesIO(record[_RECORD.size :]))
    if opcode == Opcode.METADATA:
        return MetadataIndex(offset=at, length=len(record), name=Metadata.read(fields).name)
    attachment = Attachment.read(fields)
    return AttachmentIndex(
        offset=at,
        length=len(record),
        create_time=attachment.create_time,
        log_time=attachment.log_time,
        data_size=len(attachment.data),
        name=attachment.name,
        media_type=attachment.media_type,
    )


def _chunk_index(chunk: bytes, indexes_size: int, indexes: Indexes, at: int) -> ChunkIndex:
    start, end, unpacked, _, name_length = _CHUNK.unpack_from(chunk, _RECORD.size)
    name_at = _RECORD.size + _CHUNK.size
    (packed,) = struct.unpack_from("<Q", chunk, name_at + name_length)
    return ChunkIndex(
        chunk_start_offset=at,
        chunk_length=len(chunk) - indexes_size,
        message_start_time=start,
        message_end_time=end,
        message_index_offsets={channel: at + place for channel, (place, _) in indexes.items()},
        message_index_length=indexes_size,
        compression=chunk[name_at : name_at + name_length].decode(errors="replace"),
        compressed_size=packed,
        uncompressed_size=unpacked,
    )


def _encoded(record: McapRecord) -> bytes:
    builder = RecordBuilder()
    record.write(builder)
    return _taken(builder)


def _taken(builder: RecordBuilder) -> bytes:
    return bytes(builder.end())  # type: ignore[no-untyped-call]
