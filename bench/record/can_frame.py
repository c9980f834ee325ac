"""The log's raw CAN frame, `platoon.CanFrame`: host receive time, identifier, data.

The simulated time of a frame is the log_time of its message. Data comes last, so that all before it has a fixed place.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from google.protobuf import descriptor_pb2

from bench.record.layout import Field, Layout, file_descriptor_set, tag

NAME = "platoon.CanFrame"
MAX_DATA = 8
_HEAD = Layout([Field("receive_time", "fixed64", "ns", "host clock"), Field("id", "fixed32", "", "identifier")])
_DATA_TAG = tag(3, 2)
# The length of the data stands before the data, as a varint of one byte.
DATA_AT = _HEAD.dtype.itemsize + len(_DATA_TAG) + 1


class Frame(NamedTuple):
    """One recorded frame; times in ns, `time_ns` simulated, `receive_ns` of the host."""

    time_ns: int
    bus: str
    can_id: int
    data: bytes
    receive_ns: int


def _schema() -> bytes:
    files = descriptor_pb2.FileDescriptorSet.FromString(
        file_descriptor_set(NAME, _HEAD, "One frame as it was on the bus.")
    )
    kind = descriptor_pb2.FieldDescriptorProto
    files.file[0].message_type[0].field.add(name="data", number=3, label=kind.LABEL_OPTIONAL, type=kind.TYPE_BYTES)
    return files.SerializeToString()


SCHEMA = _schema()


def template(length: int) -> bytes:
    """Return an encoded frame of `length` data bytes, all values zero."""
    return _HEAD.template + _DATA_TAG + bytes([length]) + bytes(length)


def fill(out: npt.NDArray[np.uint8], at: npt.NDArray[np.int64], frames: npt.NDArray[Any]) -> None:
    """Write frames (n,) with columns receive, can_id, length and data into templates that start at `at` (n,)."""
    for name, values in (("receive_time", frames["receive"].astype("<u8")), ("id", frames["can_id"].astype("<u4"))):
        width = values.dtype.itemsize
        out[at[:, None] + (_HEAD.offset(name) + np.arange(width))] = values.view(np.uint8).reshape(-1, width)
    inside = np.arange(MAX_DATA) < frames["length"][:, None]
    out[(at[:, None] + (DATA_AT + np.arange(MAX_DATA)))[inside]] = frames["data"][inside]


def read(
    data: npt.NDArray[np.uint8], at: npt.NDArray[np.int64], length: npt.NDArray[np.uint64], table: npt.NDArray[Any]
) -> bool:
    """Read encoded frames of `length` (n,) bytes at `at` (n,) into columns receive, can_id, length and data of `table`.

    Returns:
        Whether all of them were in the form that `fill` writes.
    """
    size = length.astype(np.int64) - DATA_AT
    if (size < 0).any() or (size > MAX_DATA).any():
        return False
    heads = data[at[:, None] + np.arange(DATA_AT)]
    view = _HEAD.view(heads[:, : _HEAD.dtype.itemsize])
    if view is None or (heads[:, -2] != _DATA_TAG[0]).any() or (heads[:, -1] != size).any():
        return False
    table["receive"], table["can_id"], table["length"] = view["receive_time"].astype(np.int64), view["id"], size
    inside = np.arange(MAX_DATA) < size[:, None]
    table["data"][inside] = data[(at[:, None] + (DATA_AT + np.arange(MAX_DATA)))[inside]]
    return True
