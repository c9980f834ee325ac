"""Follows an MCAP log that is still being written, and cuts pieces out of it that are complete logs.

Only record heads are read here; the content of a chunk is read with `bench.record`, from a piece: a file with
everything between the chunks (scenario, DBC files, schemas, channels) and some of the chunks, byte for byte.
"""

from __future__ import annotations

import os
import struct
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

from mcap.opcode import Opcode

from bench.errors import BadInput
from bench.live.groups import ChannelGroups
from bench.live.piece import write_piece
from bench.mcap.container import MAGIC
from bench.mcap.records import INDEX_ENTRY

_RECORD = struct.Struct("<BQ")
_CHUNK_TIMES = struct.Struct("<QQ")
_INDEX = struct.Struct("<HI")
_OPENING = _RECORD.size + _CHUNK_TIMES.size
_HEAD = {Opcode.HEADER, Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA, Opcode.ATTACHMENT}


@dataclass
class Chunk:
    """A whole chunk in the file.

    Attributes:
        at: where its record begins.
        size: bytes of its record and of the message indexes that follow it.
        start_ns, end_ns: log_time of its earliest and latest message.
        indexes_size: bytes of the message indexes.
        indexes: where they are, see `bench.live.piece.Indexes`.
    """

    at: int
    size: int
    start_ns: int
    end_ns: int
    indexes_size: int = 0
    indexes: dict[int, tuple[int, int]] = field(default_factory=dict)


class Tail:
    """A log that grows.

    Attributes:
        path: the log, which need not be there yet.
        chunks: all whole chunks so far, in the order of the file.
        groups: how far the channels in them are complete.
        newest_ns: log_time of the latest message so far, -1 where there is none.
        quiet: whether nothing was written between the last two calls of `poll`.
        ended: whether the end of the recorded data has been reached.
    """

    def __init__(self, path: Path) -> None:
        """Follow the log at `path` from its beginning."""
        self.path = path
        self.chunks: list[Chunk] = []
        self.groups = ChannelGroups()
        self.newest_ns = -1
        self.quiet = False
        self.ended = False
        self._head: list[tuple[int, bytes]] = []
        self._file: BinaryIO | None = None
        self._at = len(MAGIC)
        self._size = 0
        self._noted = 0

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()

    @property
    def heads(self) -> int:
        """Number of records outside chunks so far; a larger one may mean new channels."""
        return len(self._head)

    def poll(self) -> None:
        """Find what has been written since the last call.

        Raises:
            BadInput: the file cannot be read or is not MCAP.
        """
        size = self._size
        try:
            if self._file is None:
                self._file = self._opened()
            if self._file is not None:
                size = os.fstat(self._file.fileno()).st_size
                while not self.ended and self._take_record(size):
                    pass
        except OSError as error:
            raise BadInput(f"cannot read the log {self.path}: {error.strerror or error}") from error
        # The last one's indexes may not all be there yet.
        for chunk in self.chunks[self._noted :]:
            self.groups.note(chunk.indexes.keys(), chunk.end_ns)
        self._noted = max(0, len(self.chunks) - 1)
        self.quiet, self._size = size == self._size, size

    @contextmanager
    def piece(self, chunks: Sequence[Chunk]) -> Iterator[Path]:
        """Yield a log with these chunks and all records outside chunks so far.

        A reader that has the file open or mapped may continue to read it afterwards. May be called in another thread
        than `poll`.

        Raises:
            BadInput: the log cannot be read.
        """
        try:
            # Unnamed, so that nothing stays behind when this process is killed.
            with tempfile.TemporaryFile() as piece:
                bodies = ((self._read(c.at, c.size), c.indexes_size, c.indexes) for c in chunks)
                write_piece(piece, self._head.copy(), bodies)
                piece.flush()
                yield Path(f"/dev/fd/{piece.fileno()}")
        except OSError as error:
            raise BadInput(f"cannot read the log {self.path}: {error.strerror or error}") from error

    def _opened(self) -> BinaryIO | None:
        """Open the file, once its first bytes are there."""
        try:
            stream = self.path.open("rb", buffering=0)
        except FileNotFoundError:
            return None
        magic = os.pread(stream.fileno(), len(MAGIC), 0)
        if magic == MAGIC:
            return stream
        stream.close()
        if MAGIC.startswith(magic):
            return None
        raise BadInput(f"{self.path} is not an MCAP file: it does not begin with MCAP's magic bytes")

    def _take_record(self, size: int) -> bool:
        """Take the next record where it is whole in a file of `size` bytes; return whether it was."""
        at = self._at
        if at + _RECORD.size > size:
            return False
        # Reads the first fields of most records, too.
        opening = self._read(at, min(_OPENING, size - at))
        opcode, length = _RECORD.unpack_from(opening)
        whole = _RECORD.size + length
        if whole > size - at:
            return False
        if opcode in (Opcode.DATA_END, Opcode.FOOTER):
            self.ended = True
        elif opcode == Opcode.CHUNK and length >= _CHUNK_TIMES.size:
            self.chunks.append(Chunk(at, whole, *_CHUNK_TIMES.unpack_from(opening, _RECORD.size)))
            self.newest_ns = max(self.newest_ns, self.chunks[-1].end_ns)
        elif opcode == Opcode.MESSAGE_INDEX and length >= _INDEX.size:
            self._take_index(at, whole, *_INDEX.unpack_from(opening, _RECORD.size))
        elif opcode in _HEAD:
            self._head.append((opcode, self._read(at, whole)))
        self._at = at + whole
        return True

    def _take_index(self, at: int, whole: int, channel: int, entries_size: int) -> None:
        chunk = self.chunks[-1] if self.chunks else None
        if chunk is not None and chunk.at + chunk.size == at:
            chunk.indexes[channel] = chunk.size, entries_size // INDEX_ENTRY.itemsize
            chunk.size += whole
            chunk.indexes_size += whole

    def _read(self, at: int, count: int) -> bytes:
        """Return `count` bytes from `at` on, all of which are in the file."""
        if self._file is None:
            raise BadInput(f"the log {self.path} is not there yet")
        return os.pread(self._file.fileno(), count, at)
