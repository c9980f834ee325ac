"""The MCAP container, written chunk by chunk from message records that are already encoded.

`mcap.writer` takes messages one at a time (3.5 us each); the recorder has thousands of them ready as one array.
Record types, field order and the summary are those of https://mcap.dev/spec; everything but the messages goes
through `mcap.records`. Header, metadata, attachments, schemas and channels stand before the chunks that need them,
so that a damaged file still has them.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import BinaryIO

import numpy as np
import numpy.typing as npt
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)

from bench.mcap.records import INDEX_ENTRY, entries_by_channel

MAGIC = b"\x89MCAP0\r\n"
COMPRESSION = "zstd"

_CHUNK_HEAD = struct.Struct("<BQQQQII4sQ")
_INDEX_HEAD = struct.Struct("<BQHI")
_INDEX_PLACE = struct.Struct("<HQ")
# A chunk index record: opcode, length of the rest, first and last time, place and length of the chunk, length of the
# places of its message indexes; after these their length, then compression, compressed and uncompressed size.
_CHUNK_INDEX_HEAD = struct.Struct("<BQQQQQI")
_CHUNK_INDEX_END = struct.Struct("<QI4sQQ")


class McapFile:
    """One MCAP file being written.

    Every method that takes data writes it through to the operating system before it returns.
    """

    def __init__(self, stream: BinaryIO, library: str) -> None:
        """Open the file on `stream`, which is at its start, naming `library` as the writer."""
        self._stream = stream
        self._position = 0
        self._compressor = zstandard.ZstdCompressor(level=1)
        self._schemas: list[Schema] = []
        self._schema_ids: dict[tuple[str, bytes], int] = {}
        self._channels: list[Channel] = []
        # As they are in the file; the summary has them once more.
        self._declared: dict[int, bytes] = {}
        self._declared_schemas: dict[int, bytes] = {}
        self._counts: dict[int, int] = {}
        self._span: tuple[int, int] | None = None
        self._chunk_indexes = bytearray()
        self._chunks = 0
        self._attachments: list[AttachmentIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._write(MAGIC)
        self._record(Header(profile="", library=library))

    def add_schema(self, name: str, data: bytes, encoding: str = "protobuf") -> int:
        """Return the id of the schema `name`, created on first use."""
        if (name, data) not in self._schema_ids:
            self._schemas.append(Schema(id=len(self._schemas) + 1, name=name, encoding=encoding, data=data))
            self._schema_ids[name, data] = self._schemas[-1].id
        return self._schema_ids[name, data]

    def add_channel(self, topic: str, schema_id: int, metadata: Mapping[str, str], encoding: str = "protobuf") -> int:
        """Return the id of a new channel, which enters the file with its first message; 0 is no schema."""
        self._channels.append(
            Channel(
                id=len(self._channels) + 1,
                topic=topic,
                message_encoding=encoding,
                metadata=dict(metadata),
                schema_id=schema_id,
            )
        )
        return self._channels[-1].id

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write one metadata record."""
        offset = self._position
        self._record(Metadata(name=name, metadata={storable(key): storable(text) for key, text in values.items()}))
        self._metadata.append(MetadataIndex(offset=offset, length=self._position - offset, name=name))

    def add_attachment(self, name: str, media_type: str, data: bytes) -> None:
        """Write one attachment."""
        offset = self._position
        self._record(Attachment(create_time=0, log_time=0, name=name, media_type=media_type, data=data))
        self._attachments.append(
            AttachmentIndex(
                offset=offset,
                length=self._position - offset,
                log_time=0,
                create_time=0,
                data_size=len(data),
                name=name,
                media_type=media_type,
            )
        )

    def add_chunk(
        self,
        records: bytes | memoryview,
        channel: npt.NDArray[np.int64],
        log_time: npt.NDArray[np.int64],
        offset: npt.NDArray[np.int64],
    ) -> None:
        """Write message records as one chunk, with its message indexes.

        Args:
            records: whole message records, one after the other.
            channel: channel id of each message (n,).
            log_time: time of each message (n,), ns.
            offset: place of each message in `records` (n,), bytes.
        """
        if not len(channel):
            return
        counts, entries = entries_by_channel(channel, log_time, offset)
        self._declare(counts)
        start, end = int(log_time.min()), int(log_time.max())
        packed = self._compressor.compress(records)
        chunk_at = self._position
        rest = _CHUNK_HEAD.size - 9 + len(packed)
        head = _CHUNK_HEAD.pack(
            Opcode.CHUNK, rest, start, end, len(records), zlib.crc32(records), 4, COMPRESSION.encode(), len(packed)
        )
        index_at = chunk_at + len(head) + len(packed)
        indexes, places, first = bytearray(), bytearray(), 0
        for number, count in counts.items():
            places += _INDEX_PLACE.pack(number, index_at + len(indexes))
            size = INDEX_ENTRY.itemsize * count
            indexes += _INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, 6 + size, number, size)
            indexes += entries[first : first + count].tobytes()
            self._counts[number] = self._counts.get(number, 0) + count
            first += count
        self._write(b"".join((head, packed, indexes)))
        self._chunk_indexes += _CHUNK_INDEX_HEAD.pack(
            Opcode.CHUNK_INDEX,
            _CHUNK_INDEX_HEAD.size - 9 + len(places) + _CHUNK_INDEX_END.size,
            start,
            end,
            chunk_at,
            index_at - chunk_at,
            len(places),
        )
        self._chunk_indexes += places
        self._chunk_indexes += _CHUNK_INDEX_END.pack(
            len(indexes), len(COMPRESSION), COMPRESSION.encode(), len(packed), len(records)
        )
        self._chunks += 1
        self._span = (min(self._span[0], start), max(self._span[1], end)) if self._span else (start, end)

    def finish(self) -> None:
        """Write the summary and the footer; the stream stays open."""
        self._record(DataEnd(0))
        summary_start = self._position
        statistics = Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self._declared),
            channel_message_counts=dict(self._counts),
            chunk_count=self._chunks,
            message_count=sum(self._counts.values()),
            metadata_count=len(self._metadata),
            message_start_time=self._span[0] if self._span else 0,
            message_end_time=self._span[1] if self._span else 0,
            schema_count=len(self._declared_schemas),
        )
        summary, offsets = bytearray(), RecordBuilder()
        groups = (
            (Opcode.SCHEMA, _in_order(self._declared_schemas)),
            (Opcode.CHANNEL, _in_order(self._declared)),
            (Opcode.STATISTICS, _encoded([statistics])),
            (Opcode.CHUNK_INDEX, bytes(self._chunk_indexes)),
            (Opcode.ATTACHMENT_INDEX, _encoded(self._attachments)),
            (Opcode.METADATA_INDEX, _encoded(self._metadata)),
        )
        for opcode, data in groups:
            if data:
                SummaryOffset(
                    group_opcode=opcode, group_start=summary_start + len(summary), group_length=len(data)
                ).write(offsets)
                summary += data
        offset_start = summary_start + len(summary)
        summary += _taken(offsets)
        footer_head = struct.pack("<BQQQ", Opcode.FOOTER, 20, summary_start, offset_start)
        self._write(bytes(summary))
        self._record(
            Footer(
                summary_start=summary_start,
                summary_offset_start=offset_start,
                summary_crc=zlib.crc32(footer_head, zlib.crc32(summary)),
            )
        )
        self._write(MAGIC)

    def _declare(self, channels: Iterable[int]) -> None:
        """Write the channels, and their schemas, that no record has named yet."""
        for number in (n for n in channels if n not in self._declared):
            channel = self._channels[number - 1]
            if channel.schema_id and channel.schema_id not in self._declared_schemas:
                self._declared_schemas[channel.schema_id] = self._record(self._schemas[channel.schema_id - 1])
            self._declared[number] = self._record(channel)

    def _record(self, record: McapRecord) -> bytes:
        """Write a record; return its bytes."""
        data = _encoded([record])
        self._write(data)
        return data

    def _write(self, data: bytes) -> None:
        self._stream.write(data)
        self._stream.flush()
        self._position += len(data)


def storable(text: str) -> str:
    r"""Return `text` as UTF-8 can hold it: of file names and exceptions, what is no character as an escape (\udc9b)."""
    return text.encode(errors="backslashreplace").decode()


def media_type(name: str) -> str:
    """Return the media type of an attachment of this file name."""
    kinds = {".toml": "application/toml", ".xml": "application/xml", ".json": "application/json"}
    return kinds.get(Path(name).suffix, "text/plain")


def _in_order(records: Mapping[int, bytes]) -> bytes:
    return b"".join(records[number] for number in sorted(records))


def _encoded(records: Sequence[McapRecord]) -> bytes:
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    return _taken(builder)


def _taken(builder: RecordBuilder) -> bytes:
    return bytes(builder.end())  # type: ignore[no-untyped-call]
