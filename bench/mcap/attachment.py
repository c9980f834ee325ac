"""An attachment record, accepted only if its checksum is valid."""

from __future__ import annotations

import io
import struct
import zlib

from mcap.data_stream import ReadDataStream
from mcap.records import Attachment

_CRC = struct.Struct("<I")


def read_attachment(record: bytes) -> Attachment:
    """Return an attachment from its record's content.

    Raises:
        McapError, struct.error, UnicodeDecodeError: it is truncated.
        ValueError: it is damaged.
    """
    attachment: Attachment = Attachment.read(ReadDataStream(io.BytesIO(record)))
    (crc,) = _CRC.unpack(record[-_CRC.size :])
    if crc and zlib.crc32(memoryview(record)[: -_CRC.size]) != crc:
        raise ValueError(f"the attachment {attachment.name} is damaged")
    return attachment
