# cython: boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""The decoded-signal messages of a log, generated from the DBC, and the decoding of many frames at once into them.

Each DBC message becomes one flat protobuf message with a field per signal: whole numbers for signals without a
fractional scale, an enumeration for signals with a value table, float for IEEE floats, double for all others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cython
import numpy as np
import numpy.typing as npt

from bench.bus.codec import Codec, SignalBits
from bench.bus.description import SignalDescription
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
    message = codec.described(name)
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
        can_id=message.can_id,
        name=name,
        length=message.length,
        layout=layout,
        bits=codec.bits(name),
        schema_name=schema_name,
        schema=file_descriptor_set(schema_name, layout, message.comment),
        channel_metadata={
            "can_id": f"0x{message.can_id:03X}",
            "sender": ", ".join(message.senders),
            "wall_clock": "yes" if codec.is_wall_clock(message.can_id) else "no",
            **units,
        },
    )


def _field(signal: SignalDescription) -> Field:
    return Field(identifier(signal.name), _kind(signal), signal.unit, signal.comment, signal.texts)


def _kind(signal: SignalDescription) -> Kind:
    if signal.is_float:
        return "float"
    whole = signal.scale.is_integer() and signal.offset.is_integer()
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

    def __init__(self, messages: Sequence[SignalMessage]) -> None:
        """Line up the signals of `messages`."""
        bits = [bits for message in messages for bits in message.bits]
        counts = [len(message.bits) for message in messages]
        self.count = np.array(counts, np.int64)
        self.first = np.concatenate([[0], np.cumsum(self.count)])[:-1].astype(np.int64)
        self._shift = np.array([b.shift for b in bits], np.uint64)
        self._mask = np.array([b.mask for b in bits], np.uint64)
        self._sign = np.array([b.sign for b in bits], np.int64)
        self._is_float = np.array([b.is_float for b in bits], np.uint8)
        self._scale = np.array([b.scale for b in bits], np.float64)
        self._offset = np.array([b.offset for b in bits], np.float64)
        kinds = [field.kind for message in messages for field in message.layout.fields]
        self._width = np.array([_WIDTHS[kind] for kind in kinds], np.uint8)
        self._is_whole = np.array([kind in _WHOLE for kind in kinds], np.uint8)
        places = [message.layout.offset(field.name) for message in messages for field in message.layout.fields]
        self._place = np.array(places, np.int64)

    def decode(
        self, data: npt.NDArray[np.uint8], message: npt.NDArray[np.int64]
    ) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.float64]]:
        """Return all signals of frames `data` (n, 8), zero-padded, whose messages are `message` (n,).

        Returns:
            For each frame, the index of its first value; and the physical values of all signals, frame by frame, in
            the order of their messages.
        """
        count = self.count[message]
        first = np.cumsum(count)
        value = np.empty(int(first[-1]) if len(first) else 0)
        first -= count
        number = np.array(data, order="C").view("<u8").reshape(-1)
        floats = np.zeros(1, np.float32)
        if len(value):
            _decode(
                value.data,
                number.data,
                *(item.data for item in (self.first[message], count, self._shift, self._mask, self._sign)),
                *(item.data for item in (self._is_float, self._scale, self._offset, floats, floats.view(np.uint32))),
            )
        return first, value

    def fill(
        self,
        out: npt.NDArray[np.uint8],
        at: npt.NDArray[np.int64],
        message: npt.NDArray[np.int64],
        value: npt.NDArray[np.float64],
    ) -> None:
        """Write values as `decode` returns them to records of messages (n,), which start at `at` (n,) in `out`."""
        double, single = np.zeros(1), np.zeros(1, np.float32)
        if len(value):
            _fill(
                out.data,
                value.data,
                *(item.data for item in (at, self.first[message], self.count[message])),
                *(item.data for item in (self._place, self._width, self._is_whole)),
                *(item.data for item in (double, double.view(np.uint8), single, single.view(np.uint8))),
            )


_WIDTHS: dict[Kind, int] = {"double": 8, "float": 4, "fixed32": 4, "sfixed32": 4, "enum": 1}
_WHOLE: frozenset[Kind] = frozenset(("fixed32", "sfixed32", "enum"))


def _decode(
    value: cython.double[::1],
    number: cython.ulonglong[::1],
    first: cython.longlong[::1],
    count: cython.longlong[::1],
    shift: cython.ulonglong[::1],
    mask: cython.ulonglong[::1],
    sign: cython.longlong[::1],
    is_float: cython.uchar[::1],
    scale: cython.double[::1],
    offset: cython.double[::1],
    single: cython.float[::1],
    single_bits: cython.uint[::1],
) -> None:
    """Set `value`, frame by frame; `single` and `single_bits` are the same bytes."""
    frame: cython.Py_ssize_t
    signal: cython.Py_ssize_t
    at: cython.Py_ssize_t = 0
    for frame in range(number.shape[0]):
        for signal in range(first[frame], first[frame] + count[frame]):
            raw: cython.ulonglong = number[frame] >> shift[signal] & mask[signal]
            if is_float[signal]:
                single_bits[0] = raw
                value[at] = single[0]
            else:
                whole: cython.longlong = raw
                whole = (whole ^ sign[signal]) - sign[signal]
                value[at] = whole * scale[signal] + offset[signal]
            at += 1


def _fill(
    out: cython.uchar[::1],
    value: cython.double[::1],
    record: cython.longlong[::1],
    first: cython.longlong[::1],
    count: cython.longlong[::1],
    place: cython.longlong[::1],
    width: cython.uchar[::1],
    is_whole: cython.uchar[::1],
    double: cython.double[::1],
    double_bytes: cython.uchar[::1],
    single: cython.float[::1],
    single_bytes: cython.uchar[::1],
) -> None:
    """Write each value little-endian; `double` and `double_bytes` are the same bytes, and so are the last two."""
    frame: cython.Py_ssize_t
    signal: cython.Py_ssize_t
    byte: cython.Py_ssize_t
    index: cython.Py_ssize_t = 0
    for frame in range(record.shape[0]):
        for signal in range(first[frame], first[frame] + count[frame]):
            at: cython.Py_ssize_t = record[frame] + place[signal]
            if is_whole[signal]:
                whole: cython.longlong = cython.cast(cython.longlong, value[index])
                for byte in range(width[signal]):
                    out[at + byte] = whole >> 8 * byte & 0xFF
            elif width[signal] == 8:
                double[0] = value[index]
                for byte in range(8):
                    out[at + byte] = double_bytes[byte]
            else:
                single[0] = value[index]
                for byte in range(4):
                    out[at + byte] = single_bytes[byte]
            index += 1
