# cython: boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Message records of MCAP and their index entries, thousands at once (https://mcap.dev/spec).

Records that differ only in their values are copied from a template, and their headers filled in here.
"""

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import cython
import numpy as np
import numpy.typing as npt

# A message record: opcode, length of the rest, then the fields up to the payload.
MESSAGE = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_time", "<u8"),
        ("publish_time", "<u8"),
    ]
)
# Bytes that `length` counts in addition to the payload.
MESSAGE_FIELDS = MESSAGE.itemsize - 9
INDEX_ENTRY = np.dtype([("log_time", "<u8"), ("offset", "<u8")])

_MESSAGE_OPCODE = 5
_CHANNEL_AT = cython.declare(cython.int, 9)
_SEQUENCE_AT = cython.declare(cython.int, 11)
_LOG_TIME_AT = cython.declare(cython.int, 15)
_PUBLISH_TIME_AT = cython.declare(cython.int, 23)


class Records(NamedTuple):
    """Consecutive message records, and the index entry of each.

    `channel` (n,) channel ids, `log_time` (n,) ns, `offset` (n,) bytes from the start of `data`.
    """

    data: npt.NDArray[np.uint8]
    channel: npt.NDArray[np.int64]
    log_time: npt.NDArray[np.int64]
    offset: npt.NDArray[np.int64]

    def parted(self, size: int, at_least: int) -> tuple["Records", "Records"]:
        """Return as many records as have `size` bytes, but `at_least` so many, and the rest."""
        ends = np.append(self.offset[1:], len(self.data))
        count = max(int(np.searchsorted(ends, size, side="right")), at_least)
        at = int(ends[count - 1]) if count else 0
        return (
            Records(self.data[:at], self.channel[:count], self.log_time[:count], self.offset[:count]),
            Records(self.data[at:], self.channel[count:], self.log_time[count:], self.offset[count:] - at),
        )

    def by_group(self, group: npt.NDArray[np.int64]) -> Iterator[tuple[int, "Records"]]:
        """Yield each group with its records; the records are sorted by `group` (n,)."""
        starts = np.flatnonzero(np.diff(group, prepend=-1)).tolist()
        for first, last in pairwise([*starts, len(group)]):
            at = int(self.offset[first])
            end = int(self.offset[last]) if last < len(group) else len(self.data)
            rows = slice(first, last)
            part = Records(self.data[at:end], self.channel[rows], self.log_time[rows], self.offset[rows] - at)
            yield int(group[first]), part


class Templates:
    """Records of messages whose values are still to be filled in, side by side, by their payloads."""

    def __init__(self, payloads: Sequence[bytes]) -> None:
        """Make the template of each of `payloads`."""
        records = [_template(payload) for payload in payloads]
        self.size = np.array([len(record) for record in records], np.int64)
        self._start = np.cumsum(self.size) - self.size
        self._bytes = np.frombuffer(b"".join(records), np.uint8).copy()

    def records(
        self,
        template: npt.NDArray[np.int64],
        channel: npt.NDArray[np.int64],
        log_time: npt.NDArray[np.int64],
        sequence: npt.NDArray[np.int64],
    ) -> Records:
        """Return a record of each message, complete but for the values.

        Args:
            template: (n,) number of its template.
            channel: (n,) id of its channel.
            log_time: (n,) its time, ns.
            sequence: by channel id, the sequence number of its next message; counted up.
        """
        size = self.size[template]
        offset = np.cumsum(size)
        data = np.empty(int(offset[-1]) if len(offset) else 0, np.uint8)
        offset -= size
        if len(data):
            _copy(data.data, offset.data, size.data, self._bytes.data, self._start[template].data)
            _fill_headers(data.data, offset.data, channel.data, log_time.data, sequence.data)
        return Records(data, channel, log_time, offset)


def _template(payload: bytes) -> bytes:
    header = np.zeros(1, MESSAGE)
    header["opcode"], header["length"] = _MESSAGE_OPCODE, MESSAGE_FIELDS + len(payload)
    return header.tobytes() + payload


def entries_by_channel(
    channel: npt.NDArray[np.int64], log_time: npt.NDArray[np.int64], offset: npt.NDArray[np.int64]
) -> tuple[dict[int, int], npt.NDArray[Any]]:
    """Return the number of messages (n > 0) of each channel, and all index entries (n,) channel after channel."""
    counts = np.bincount(channel)
    place = np.cumsum(counts) - counts
    entries = np.empty((len(channel), 2), np.int64)
    _sort_entries(entries.data, place.data, channel.data, log_time.data, offset.data)
    used = np.flatnonzero(counts)
    return dict(zip(used.tolist(), counts[used].tolist(), strict=True)), entries.view(INDEX_ENTRY)[:, 0]


def _copy(
    out: cython.uchar[::1],
    offset: cython.longlong[::1],
    size: cython.longlong[::1],
    source: cython.uchar[::1],
    start: cython.longlong[::1],
) -> None:
    """Copy `size` (n,) bytes of `source` from `start` (n,) on to `out` from `offset` (n,) on."""
    row: cython.Py_ssize_t
    at: cython.Py_ssize_t
    for row in range(offset.shape[0]):
        there: cython.Py_ssize_t = offset[row]
        here: cython.Py_ssize_t = start[row]
        for at in range(size[row]):
            out[there + at] = source[here + at]


def _fill_headers(
    out: cython.uchar[::1],
    offset: cython.longlong[::1],
    channel: cython.longlong[::1],
    log_time: cython.longlong[::1],
    sequence: cython.longlong[::1],
) -> None:
    """Fill in the headers of records that start at `offset` (n,)."""
    row: cython.Py_ssize_t
    byte: cython.Py_ssize_t
    for row in range(offset.shape[0]):
        at: cython.Py_ssize_t = offset[row]
        number: cython.Py_ssize_t = channel[row]
        count: cython.longlong = sequence[number]
        sequence[number] = count + 1
        out[at + _CHANNEL_AT] = number & 0xFF
        out[at + _CHANNEL_AT + 1] = number >> 8 & 0xFF
        for byte in range(4):
            out[at + _SEQUENCE_AT + byte] = count >> 8 * byte & 0xFF
        time: cython.longlong = log_time[row]
        for byte in range(8):
            out[at + _LOG_TIME_AT + byte] = out[at + _PUBLISH_TIME_AT + byte] = time >> 8 * byte & 0xFF


def _sort_entries(
    entries: cython.longlong[:, ::1],
    place: cython.longlong[::1],
    channel: cython.longlong[::1],
    log_time: cython.longlong[::1],
    offset: cython.longlong[::1],
) -> None:
    """Put each entry to the next place of its channel, `place` by channel id."""
    row: cython.Py_ssize_t
    for row in range(channel.shape[0]):
        at: cython.Py_ssize_t = place[channel[row]]
        place[channel[row]] = at + 1
        entries[at, 0] = log_time[row]
        entries[at, 1] = offset[row]
