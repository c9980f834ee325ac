# cython: boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""The log's raw CAN frame, `platoon.CanFrame`: host receive time, identifier, time on the wire, data.

The simulated time of a frame's cycle is the log_time of its message. Data comes last, so that all other fields have a
fixed position.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import cython
import numpy as np
import numpy.typing as npt
from google.protobuf import descriptor_pb2

from bench.record.layout import Field, Layout, file_descriptor_set, tag

NAME = "platoon.CanFrame"
MOST_BUSES = 100
"""Limit on CAN buses of a log; a run with 16 vehicles has 17."""

MAX_DATA = 8
LONGEST_RESPONSE_NS = 0xFFFF_FFFF

_RECEIVED = (Field("receive_time", "fixed64", "ns", "host clock"), Field("id", "fixed32", "", "identifier"))
_HEAD = Layout(
    [
        *_RECEIVED,
        Field("wire_time", "fixed64", "ns", "simulated time of the end of the frame on the wire; 0: it is on none"),
        Field("response_time", "fixed32", "ns", "from its wait for the bus on to wire_time; 0xFFFFFFFF: that or more"),
    ]
)
_DATA_NUMBER = len(_HEAD.fields) + 1
_DATA_TAG = tag(_DATA_NUMBER, 2)
# The length of the data precedes the data, as a varint of one byte.
DATA_AT = _HEAD.dtype.itemsize + len(_DATA_TAG) + 1
# The fields of older logs, without times on the wire.
_OLD_HEAD, _OLD_DATA_TAG = Layout(_RECEIVED), tag(3, 2)


class Frame(NamedTuple):
    """One recorded frame; times in ns.

    `time_ns` is the simulated time of its cycle, `receive_ns` the host's when it was received, `wire_ns` the simulated
    time of its end on the wire (0 if never on the wire), `response_ns` the time from its release to that end.
    """

    time_ns: int
    bus: str
    can_id: int
    data: bytes
    receive_ns: int
    wire_ns: int = 0
    response_ns: int = 0


def _schema() -> bytes:
    files = descriptor_pb2.FileDescriptorSet.FromString(
        file_descriptor_set(NAME, _HEAD, "One frame as it was on the bus.")
    )
    kind = descriptor_pb2.FieldDescriptorProto
    files.file[0].message_type[0].field.add(
        name="data", number=_DATA_NUMBER, label=kind.LABEL_OPTIONAL, type=kind.TYPE_BYTES
    )
    return files.SerializeToString()


SCHEMA = _schema()


def template(length: int) -> bytes:
    """Return an encoded frame of `length` data bytes, all values zero."""
    return _HEAD.template + _DATA_TAG + bytes([length]) + bytes(length)


def fill(out: npt.NDArray[np.uint8], at: npt.NDArray[np.int64], frames: npt.NDArray[Any]) -> None:
    """Write frames (n,) into templates that start at `at` (n,).

    The frames have columns receive, can_id, wire, response, length and data.
    """
    if len(frames):
        columns = (frames[name].data for name in ("receive", "can_id", "wire", "response", "length", "data"))
        _fill(out.data, at.data, *columns, *map(_HEAD.offset, ("receive_time", "id", "wire_time", "response_time")))


def _fill(
    out: cython.uchar[::1],
    at: cython.longlong[::1],
    receive: cython.longlong[:],
    can_id: cython.uint[:],
    wire: cython.longlong[:],
    response: cython.longlong[:],
    length: cython.uchar[:],
    data: cython.uchar[:, :],
    receive_at: cython.Py_ssize_t,
    id_at: cython.Py_ssize_t,
    wire_at: cython.Py_ssize_t,
    response_at: cython.Py_ssize_t,
) -> None:
    longest: cython.longlong = LONGEST_RESPONSE_NS
    data_at: cython.Py_ssize_t = DATA_AT
    row: cython.Py_ssize_t
    byte: cython.Py_ssize_t
    for row in range(at.shape[0]):
        begin: cython.Py_ssize_t = at[row]
        responded: cython.longlong = min(response[row], longest)
        for byte in range(8):
            out[begin + receive_at + byte] = receive[row] >> 8 * byte & 0xFF
            out[begin + wire_at + byte] = wire[row] >> 8 * byte & 0xFF
        for byte in range(4):
            out[begin + id_at + byte] = can_id[row] >> 8 * byte & 0xFF
            out[begin + response_at + byte] = responded >> 8 * byte & 0xFF
        for byte in range(length[row]):
            out[begin + data_at + byte] = data[row, byte]


def read(
    data: npt.NDArray[np.uint8], at: npt.NDArray[np.int64], length: npt.NDArray[np.int64], table: npt.NDArray[Any]
) -> bool:
    """Read encoded frames of `length` (n,) bytes at `at` (n,) into columns of `table`, those that `fill` takes.

    Frames of an older log have no times on the wire; those columns are left unchanged.

    Returns:
        Whether all frames have a layout written by this or an older version.
    """
    return _read(data, at, length, table, _HEAD, _DATA_TAG) or _read(data, at, length, table, _OLD_HEAD, _OLD_DATA_TAG)


def _read(
    data: npt.NDArray[np.uint8],
    at: npt.NDArray[np.int64],
    length: npt.NDArray[np.int64],
    table: npt.NDArray[Any],
    head: Layout,
    data_tag: bytes,
) -> bool:
    data_at = head.dtype.itemsize + len(data_tag) + 1
    size = length - data_at
    if (size < 0).any() or (size > MAX_DATA).any():
        return False
    heads = data[at[:, None] + np.arange(data_at)]
    view = head.view(heads[:, : head.dtype.itemsize])
    if view is None or (heads[:, -2] != data_tag[0]).any() or (heads[:, -1] != size).any():
        return False
    table["receive"], table["can_id"], table["length"] = view["receive_time"].astype(np.int64), view["id"], size
    if head is _HEAD:
        table["wire"], table["response"] = view["wire_time"].astype(np.int64), view["response_time"]
    inside = np.arange(MAX_DATA) < size[:, None]
    table["data"][inside] = data[(at[:, None] + (data_at + np.arange(MAX_DATA)))[inside]]
    return True
