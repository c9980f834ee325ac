"""Opens an MCAP file by the summary at its end, if that is intact: then nothing else of the file need be read.

It is accepted only if its checksum is valid and it has as many records of each kind as its statistics say. What it
points to is checked when it is read, like anything else in the file.
https://mcap.dev/spec#summary-section
"""

from __future__ import annotations

import io
import mmap
import struct
import zlib
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import AttachmentIndex, Channel, Metadata, MetadataIndex, Schema, Statistics

from bench.mcap.attachment import read_attachment
from bench.mcap.container import MAGIC
from bench.mcap.contents import CHUNK_PLACE, INDEX_PLACE, RECORD, Chunks, Contents
from bench.mcap.gathering import gathered
from bench.mcap.time_span import FOREVER_NS

_FOOTER = struct.Struct("<BQQQI")
# A chunk index record: head, a map of channel ids to message indexes, tail, name of the compression, sizes.
_CHUNK_HEAD = np.dtype([("start", "<u8"), ("end", "<u8"), ("at", "<u8"), ("length", "<u8"), ("map_length", "<u4")])
_MAP_ENTRY = np.dtype([("channel", "<u2"), ("at", "<u8")])
_CHUNK_TAIL = np.dtype([("indexes_length", "<u8"), ("name_length", "<u4")])
_CHUNK_SIZES = np.dtype([("packed", "<u8"), ("unpacked", "<u8")])


def read_summary(data: bytes | mmap.mmap) -> Contents | None:
    """Return a file's contents according to its summary; None if it has no valid and complete one."""
    end = len(data) - len(MAGIC)
    if end < len(MAGIC) + _FOOTER.size or data[end:] != MAGIC:
        return None
    opcode, length, start, _, crc = _FOOTER.unpack_from(data, end - _FOOTER.size)
    if (opcode, length) != (Opcode.FOOTER, _FOOTER.size - RECORD.size) or not crc:
        return None
    if not len(MAGIC) <= start <= end - _FOOTER.size:
        return None
    # All up to the checksum itself, which ends the footer.
    section = data[start : end - 4]
    if zlib.crc32(section) != crc:
        return None
    try:
        return _contents(data, section)
    except (McapError, struct.error, UnicodeDecodeError, ValueError, IndexError):
        return None


def _contents(data: bytes | mmap.mmap, section: bytes) -> Contents | None:
    contents, statistics, places, chunks = Contents(), None, [], []
    for opcode, at, length in _records(section):
        if opcode == Opcode.CHUNK_INDEX:
            chunks.append((at, length))
            continue
        stream = ReadDataStream(io.BytesIO(section[at : at + length]))
        if opcode == Opcode.SCHEMA:
            schema = Schema.read(stream)
            contents.schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = Channel.read(stream)
            contents.channels[channel.id] = channel
        elif opcode == Opcode.STATISTICS:
            statistics = Statistics.read(stream)
        elif opcode == Opcode.ATTACHMENT_INDEX:
            places.append((Opcode.ATTACHMENT, AttachmentIndex.read(stream)))
        elif opcode == Opcode.METADATA_INDEX:
            places.append((Opcode.METADATA, MetadataIndex.read(stream)))
    contents.chunks = _chunks(np.frombuffer(section, np.uint8), np.array(chunks, np.int64).reshape(-1, 2))
    if statistics is None or not _is_complete(contents, statistics, [opcode for opcode, _ in places]):
        return None
    contents.counts = statistics.channel_message_counts
    for opcode, place in sorted(places, key=lambda item: item[1].offset):
        _take(contents, opcode, data[place.offset : place.offset + place.length])
    return contents


def _records(section: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, position and length of the records, without `RECORD`."""
    at = 0
    # The footer is cut off before its checksum, so it is not a complete record here.
    while at + RECORD.size <= len(section):
        opcode, length = RECORD.unpack_from(section, at)
        if opcode == Opcode.FOOTER:
            return
        at += RECORD.size
        if length > len(section) - at:
            raise ValueError("a record that is longer than the summary")
        yield opcode, at, length
        at += length


def _chunks(section: npt.NDArray[np.uint8], records: npt.NDArray[np.int64]) -> Chunks:
    """Return the chunks of the chunk index records (place, length) (n, 2); there may be tens of thousands."""
    at, length = records.T
    heads = gathered(section, at, _CHUNK_HEAD.itemsize).view(_CHUNK_HEAD).reshape(-1)
    map_at = at + _CHUNK_HEAD.itemsize
    tail_at = map_at + heads["map_length"].astype(np.int64) + _CHUNK_TAIL.itemsize
    tails = gathered(section, tail_at - _CHUNK_TAIL.itemsize, _CHUNK_TAIL.itemsize).view(_CHUNK_TAIL).reshape(-1)
    sizes_at = tail_at + tails["name_length"].astype(np.int64)
    sizes = gathered(section, sizes_at, _CHUNK_SIZES.itemsize).view(_CHUNK_SIZES).reshape(-1)
    if (sizes_at + _CHUNK_SIZES.itemsize != at + length).any():
        raise ValueError("a chunk index whose length contradicts its header")
    order = np.argsort(heads["at"], kind="stable")
    places = np.empty(len(order), CHUNK_PLACE)
    columns = {"at": heads["at"], "size": sizes["unpacked"], "start_ns": heads["start"], "end_ns": heads["end"]}
    columns["length"] = np.maximum(heads["length"], RECORD.size) - np.uint64(RECORD.size)
    for name, values in columns.items():
        places[name] = np.minimum(values, np.uint64(FOREVER_NS - 1))[order]
    count = heads["map_length"].astype(np.int64)[order] // _MAP_ENTRY.itemsize
    within = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    entry_at = np.repeat(map_at[order], count) + within * _MAP_ENTRY.itemsize
    entries = gathered(section, entry_at, _MAP_ENTRY.itemsize).view(_MAP_ENTRY).reshape(-1)
    indexes = np.empty(len(entries), INDEX_PLACE)
    indexes["chunk"] = np.repeat(np.arange(len(order)), count)
    indexes["channel"], indexes["at"] = entries["channel"], np.minimum(entries["at"], np.uint64(FOREVER_NS - 1))
    return Chunks(places, indexes, complete=True)


def _is_complete(contents: Contents, statistics: Statistics, others: list[int]) -> bool:
    found = (
        len(contents.chunks),
        len(contents.channels),
        len(contents.schemas),
        others.count(Opcode.ATTACHMENT),
        others.count(Opcode.METADATA),
    )
    said = (
        statistics.chunk_count,
        statistics.channel_count,
        statistics.schema_count,
        statistics.attachment_count,
        statistics.metadata_count,
    )
    return found == said


def _take(contents: Contents, expected: int, record: bytes) -> None:
    opcode, length = RECORD.unpack_from(record)
    if opcode != expected or length != len(record) - RECORD.size:
        raise ValueError("the summary points outside the file")
    if expected == Opcode.ATTACHMENT:
        attachment = read_attachment(record[RECORD.size :])
        contents.attachments[attachment.name] = attachment.data
    else:
        metadata = Metadata.read(ReadDataStream(io.BytesIO(record[RECORD.size :])))
        contents.metadata.setdefault(metadata.name, {}).update(metadata.metadata)
