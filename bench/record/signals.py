"""The decoded-signal messages of a log, generated from the DBC, and the numpy decoding of frames into them.

Each DBC message becomes one flat protobuf message with a field per signal: whole numbers for signals without a
fractional scale, an enumeration for signals with a value table, float for IEEE floats, double for the rest.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cantools.database.can
import numpy as np
import numpy.typing as npt
from cantools.database.can.signal import Signal

from bench.errors import BadInput
from bench.record.layout import Field, Kind, Layout, file_descriptor_set, identifier

# A double holds whole numbers up to 2**53 exactly; no wider signal keeps its value.
_WIDEST = 53


@dataclass(frozen=True)
class SignalBits:
    """Where one signal stands in a frame of up to 8 bytes and how it is scaled: value = raw * scale + offset."""

    shift: int
    width: int
    big_endian: bool
    signed: bool
    is_float: bool
    scale: float
    offset: float


@dataclass(frozen=True)
class SignalMessage:
    """One DBC message as the log keeps it.

    Attributes:
        can_id: identifier on the bus.
        name: DBC name.
        length: bytes in a frame.
        layout: the decoded record.
        bits: a `SignalBits` for each field of `layout`.
        schema_name, schema: full protobuf name and serialised FileDescriptorSet.
        channel_metadata: what a reader wants to know of the channel: identifier, sender, units, wall clock or not.
    """

    can_id: int
    name: str
    length: int
    layout: Layout
    bits: tuple[SignalBits, ...]
    schema_name: str
    schema: bytes
    channel_metadata: dict[str, str]


def signal_message(package: str, message: cantools.database.can.Message, *, wall_clock: bool) -> SignalMessage:
    """Return the log's form of a DBC message.

    Raises:
        BadInput: the message is longer than 8 bytes, multiplexed, or has a signal wider than 53 bits.
    """
    if message.length > 8 or message.is_multiplexed():
        raise BadInput(
            f"DBC message {message.name}: {message.length} bytes, multiplexed: {message.is_multiplexed()}; "
            "the recorder takes plain messages of at most 8 bytes"
        )
    layout = Layout([_field(signal) for signal in message.signals])
    name = f"{package}.{identifier(message.name)}"
    units = {f"unit {field.name}": field.unit for field in layout.fields if field.unit}
    return SignalMessage(
        can_id=message.frame_id,
        name=message.name,
        length=message.length,
        layout=layout,
        bits=tuple(_bits(message, signal) for signal in message.signals),
        schema_name=name,
        schema=file_descriptor_set(name, layout, message.comment or ""),
        channel_metadata={
            "can_id": f"0x{message.frame_id:03X}",
            "sender": ", ".join(message.senders),
            "wall_clock": "yes" if wall_clock else "no",
            **units,
        },
    )


def _field(signal: Signal) -> Field:
    names = {int(number): str(name) for number, name in (signal.choices or {}).items()}
    return Field(identifier(signal.name), _kind(signal), signal.unit or "", signal.comment or "", names)


def _kind(signal: Signal) -> Kind:
    if signal.is_float:
        return "float" if signal.length == 32 else "double"
    whole = float(signal.scale).is_integer() and float(signal.offset).is_integer()
    if signal.choices and not signal.is_signed and signal.length <= 7 and signal.scale == 1 and signal.offset == 0:
        return "enum"
    if whole and signal.scale == 1 and signal.offset == 0 and signal.length <= 32:
        return "sfixed32" if signal.is_signed else "fixed32"
    return "double"


def _bits(message: cantools.database.can.Message, signal: Signal) -> SignalBits:
    if signal.length > _WIDEST and not signal.is_float:
        raise BadInput(
            f"DBC message {message.name}, signal {signal.name}: {signal.length} bits; "
            f"the recorder keeps whole numbers of at most {_WIDEST} bits"
        )
    big_endian = signal.byte_order == "big_endian"
    if big_endian:
        # DBC names the most significant bit: byte * 8 + bit in the byte. Seen as one big-endian word of 64 bits,
        # that bit is at 8 * (7 - byte) + bit.
        byte, bit = divmod(signal.start, 8)
        shift = 8 * (7 - byte) + bit - signal.length + 1
    else:
        shift = signal.start
    return SignalBits(
        shift, signal.length, big_endian, signal.is_signed, signal.is_float, float(signal.scale), float(signal.offset)
    )


class SignalTable:
    """The signals of many messages side by side, to decode any mix of frames at once.

    Attributes:
        first, count: for each message, where its signals start in the table and how many there are.
    """

    def __init__(self, messages: list[SignalMessage]) -> None:
        """Line up the signals of `messages`."""
        bits = [bits for message in messages for bits in message.bits]
        counts = [len(message.bits) for message in messages]
        self.count = np.array(counts, np.int64)
        self.first = np.concatenate([[0], np.cumsum(self.count)])[:-1].astype(np.int64)
        self._shift = np.array([b.shift for b in bits], np.uint64)
        self._mask = np.array([(1 << b.width) - 1 for b in bits], np.uint64)
        self._sign = np.array([1 << (b.width - 1) if b.signed and not b.is_float else 0 for b in bits], np.int64)
        self._big = np.array([b.big_endian for b in bits], np.bool_)
        self._float32 = np.array([b.is_float and b.width == 32 for b in bits], np.bool_)
        self._float64 = np.array([b.is_float and b.width == 64 for b in bits], np.bool_)
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
        little = np.ascontiguousarray(data).view("<u8").reshape(-1)
        word = little[frame]
        if self._big.any():
            word = np.where(self._big[signal], little.byteswap()[frame], word)
        raw = (word >> self._shift[signal]) & self._mask[signal]
        sign = self._sign[signal]
        value = ((raw.view(np.int64) ^ sign) - sign).astype(np.float64)
        for wide, bits_type, float_type in ((self._float32, "<u4", "<f4"), (self._float64, "<u8", "<f8")):
            chosen: npt.NDArray[Any] = wide[signal]
            if chosen.any():
                value[chosen] = raw[chosen].astype(bits_type).view(float_type)
        return frame, signal, value * self._scale[signal] + self._offset[signal]
