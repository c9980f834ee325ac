"""Which recorded frames are whole: anybody may have sent frames of any length and content, which are in the log too."""

from typing import Any

import numpy as np
import numpy.typing as npt

from bench.bus.codec import Codec
from bench.bus.e2e import COUNTER_MODULUS, CRC_TABLE, crc_of_id

_CRC_TABLE = np.array(CRC_TABLE, np.uint8)


def whole(table: npt.NDArray[Any], codec: Codec) -> npt.NDArray[np.bool_]:
    """Return which frames (n,) of a bus have an identifier of its DBC, the length of their message and a good CRC.

    Args:
        table: the frames, see `bench.record.reader.FRAME_TABLE`.
        codec: codec of their bus.
    """
    found = np.zeros(len(table), np.bool_)
    for name in codec.names:
        length, data_id = codec.layout(name).length, codec.data_id(name)
        rows = np.flatnonzero((table["can_id"] == codec.can_id(name)) & (table["length"] == length))
        if data_id:
            rows = rows[_is_valid(table["data"][rows, :length], data_id)]
        found[rows] = True
    return found


def whole_length(table: npt.NDArray[Any], codec: Codec) -> npt.NDArray[np.bool_]:
    """Return which frames (n,) of a bus have the length that its DBC gives their message."""
    lengths = {codec.can_id(name): codec.layout(name).length for name in codec.names}
    found = np.zeros(len(table), np.bool_)
    for can_id, length in lengths.items():
        found |= (table["can_id"] == can_id) & (table["length"] == length)
    return found


def _is_valid(data: npt.NDArray[np.uint8], data_id: int) -> npt.NDArray[np.bool_]:
    """Return which messages (n, length) `bench.bus.e2e.check` accepts."""
    crc = np.full(len(data), crc_of_id(data_id), np.uint8)
    for column in data.T[1:]:
        crc = _CRC_TABLE[crc ^ column]
    valid: npt.NDArray[np.bool_] = (crc == data[:, 0]) & (data[:, 1] & 0x0F < COUNTER_MODULUS)
    return valid
