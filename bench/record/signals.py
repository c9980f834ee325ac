"""The decoded-signal messages of a log, generated from the DBC, and the decoding of many frames at once into them.

Each DBC message becomes one flat protobuf message with a field per signal: whole numbers for signals without a
fractional scale, an enumeration for signals with a value table, float for IEEE floats, double for all others.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from cantools.database.can.signal import Signal

from bench.bus.codec import Codec, SignalBits
from bench.errors import BadInput
from bench.record.can_frame import MAX_DATA
from bench.record.layout import Field, Kind, Layout, file_descriptor_set, identifier

# A double holds whole numbers exactly up to 2**53; a wider signal would lose precision.
_WIDEST = 53


@dataclass(frozen=True)
class SignalMessage:
    """One DBC message in the log's form.

    Attributes:
        can_id: identifier on the bus.
        name: DBC name.
        length: bytes in a frame.
        layout: the decoded record.
        bits: bit layout of each field of `layout`.
        schema_name, schema: full protobuf name and serialised FileDescriptorSet.
        channel_metadata: description of the channel for readers: identifier, sender, units, wall clock or not.
    """

    can_id: int
    name: str
    length: int
    layout: Layout
    bits: tuple[SignalBits, ...]
    schema_name: str
    schema: bytes
    channel_metadata: dict[str, str]


def signal_message(package: str, codec: Codec, name: str) -> SignalMessage:
    """Return the log's form of the DBC message `name`.

    Raises:
        BadInput: the message is longer than 8 bytes, or has a signal wider than 53 bits.
    """
    message = codec.message(name)
    if message.length > MAX_DATA:
        raise BadInput(f"DBC message {name}: {message.length} bytes; the recorder takes messages of at most {MAX_DATA}")
    for signal in message.signals:
        if signal.length > _WIDEST:
            raise BadInput(
                f"DBC message {name}, signal {signal.name}: {signal.length} bits; "
                f"the recorder keeps whole numbers of at most {_WIDEST} bits"
            )
    layout = Layout([_field(signal) for signal in message.signals])
    schema_name = f"{package}.{identifier(name)}"
    units = {f"unit {field.name}": field.unit for field in layout.fields if field.unit}
    return SignalMessage(
        can_id=message.frame_id,
        name=name,
        length=message.length,
        layout=layout,
        bits=codec.bits(name),
        schema_name=schema_name,
        schema=file_descriptor_set(schema_name, layout, message.comment or ""),
        channel_metadata={
            "can_id": f"0x{message.frame_id:03X}",
            "sender": ", ".join(message.senders),
            "wall_clock": "yes" if codec.is_wall_clock(message.frame_id) else "no",
            **units,
        },
    )


def _field(signal: Signal) -> Field:
    names = {int(number): str(name) for number, name in (signal.choices or {}).items()}
    return Field(identifier(signal.name), _kind(signal), signal.unit or "", signal.comment or "", names)


def _kind(signal: Signal) -> Kind:
    if signal.is_float:
        return "float"
    whole = float(signal.scale).is_integer() and float(signal.offset).is_integer()
    if signal.choices and not signal.is_signed and signal.length <= 7 and signal.scale == 1 and signal.offset == 0:
        return "enum"
    if whole and signal.scale == 1 and signal.offset == 0 and signal.length <= 32:
        return "sfixed32" if signal.is_signed else "fixed32"
    return "double"


class SignalTable:
    """The signals of many messages side by side, to decode any mix of frames at once.

    Attributes:
        first, count: for each message, index of its first signal in the table and number of signals.
    """

    def __init__(self, messages: list[SignalMessage]) -> None:
        """Line up the signals of `messages`."""
        bits = [bits for message in messages for bits in message.bits]
        counts = [len(message.bits) for message in messages]
        self.count = np.array(counts, np.int64)
        self.first = np.concatenate([[0], np.cumsum(self.count)])[:-1].astype(np.int64)
        self._shift = np.array([b.shift for b in bits], np.uint64)
        self._mask = np.array([b.mask for b in bits], np.uint64)
        self._sign = np.array([b.sign for b in bits], np.int64)
        self._is_float = np.array([b.is_float for b in bits], np.bool_)
        self._scale = np.array([b.scale for b in bits], np.float64)
        self._offset = np.array([b.offset for b in bits], np.float64)

    def decode(
        self, data: npt.NDArray[np.uint8], message: npt.NDArray[np.int64]
    ) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64], npt.NDArray[np.float64]]:
        """Return all signals of frames `data` (n, 8), zero-padded, whose messages are `message` (n,).

        Returns:
            For each signal of each frame, frame by frame: the frame's index, the signal's index in the table and
            the physical value.
        """
        count = self.count[message]
        frame = np.repeat(np.arange(len(message)), count)
        within = np.arange(len(frame)) - np.repeat(np.cumsum(count) - count, count)
        signal = self.first[message][frame] + within
        number = np.ascontiguousarray(data).view("<u8").reshape(-1)
        raw = (number[frame] >> self._shift[signal]) & self._mask[signal]
        sign = self._sign[signal]
        value = ((raw.view(np.int64) ^ sign) - sign).astype(np.float64)
        floats = self._is_float[signal]
        if floats.any():
            value[floats] = raw[floats].astype("<u4").view("<f4")
        return frame, signal, value * self._scale[signal] + self._offset[signal]
