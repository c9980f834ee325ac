"""A memory-mapped file whose pages do not accumulate in this process's memory."""

from __future__ import annotations

import mmap

_RESIDENT = 16 * 1024 * 1024
"""Bytes read before pages are released to the system; until then they count as this process's memory."""

AROUND = 64 * 1024
"""Bytes that the system maps around a read position."""


class Pages:
    """The pages of a mapped file."""

    def __init__(self, data: bytes | mmap.mmap) -> None:
        """Start with no page read."""
        self._data = data
        self._read = 0

    def have_read(self, count: int) -> None:
        """Note that `count` consecutive bytes were read, and release pages from time to time."""
        self._read += count
        if self._read >= _RESIDENT and isinstance(self._data, mmap.mmap):
            self._read = 0
            self._data.madvise(mmap.MADV_DONTNEED)
