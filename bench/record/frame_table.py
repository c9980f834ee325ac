"""Raw frames as numpy tables."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from bench.errors import BadInput
from bench.mcap.blocks import Part
from bench.record import can_frame
from bench.record.topic_decoder import TopicDecoder

FRAME_TABLE = np.dtype(
    [
        ("time", "<i8"),
        ("receive", "<i8"),
        ("wire", "<i8"),
        ("response", "<i8"),
        ("can_id", "<u4"),
        ("length", "u1"),
        ("data", "u1", (can_frame.MAX_DATA,)),
    ]
)
"""One frame: times in ns as in `can_frame.Frame`, data padded with zeros."""


def frames_of(part: Part, decoder: TopicDecoder) -> npt.NDArray[Any]:
    """Return the frames of messages (n,) as a `FRAME_TABLE` (n,).

    Raises:
        BadInput: a message is not a frame of at most 8 bytes.
    """
    table = np.zeros(len(part.offsets), FRAME_TABLE)
    table["time"] = part.heads["log_time"].astype(np.int64)
    if not can_frame.read(part.data, part.payload_at, part.payload_size, table):
        # Another writer used a different encoding.
        for number, payload in enumerate(part.payloads()):
            table[number] = (table["time"][number], *_parsed(decoder, payload))
    return table


def _parsed(decoder: TopicDecoder, payload: bytes) -> tuple[Any, ...]:
    message = decoder.message(payload)
    try:
        data: bytes = message.data
        if len(data) > can_frame.MAX_DATA:
            raise BadInput(f"topic {decoder.topic} has a frame of {len(data)} bytes, not 0 to {can_frame.MAX_DATA}")
        # The columns that `can_frame.read` fills, whatever they are.
        times = np.array([message.receive_time, message.wire_time, message.response_time], np.uint64).astype(np.int64)
        return *times, np.uint32(message.id), len(data), list(data.ljust(can_frame.MAX_DATA, b"\0"))
    except (AttributeError, TypeError, OverflowError) as error:
        raise BadInput(f"topic {decoder.topic} has messages that are not {can_frame.NAME}") from error
