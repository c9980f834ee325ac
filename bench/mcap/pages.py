"""A file that is read through a mapping, without its pages piling up in this process's memory."""

from __future__ import annotations

import mmap

_RESIDENT = 16 * 1024 * 1024
"""How much of the file may be read before the system may take its pages back; they count as this process's memory."""

AROUND = 64 * 1024
"""What the system maps around a place that is read, if what is before it was not."""


class Pages:
    """The pages of a mapped file."""

    def __init__(self, data: bytes | mmap.mmap) -> None:
        """Begin with none of them read."""
        self._data = data
        self._read = 0

    def have_read(self, count: int) -> None:
        """Take note that `count` bytes in a row were read, and give pages back now and then."""
        self._read += count
        if self._read >= _RESIDENT and isinstance(self._data, mmap.mmap):
            self._read = 0
            self._data.madvise(mmap.MADV_DONTNEED)
