"""Where the signals of a message are in its frames, and how values become bits and back: what each frame goes through.

The DBC gives the numbers (`bench.bus.codec`). Frames of up to 8 bytes, all of classical CAN, are coded as one number
of 64 bits.
"""

import struct
from collections.abc import Mapping
from typing import Any

import cython

from bench.bus.e2e import COUNTER_MODULUS, protect

if cython.compiled:
    from cython.cimports.bench.bus.e2e import crc_from
    from cython.cimports.cpython.bytes import PyBytes_FromStringAndSize
    from cython.cimports.libc.math import rint
else:
    from bench.bus.e2e import crc_from

    rint = round

_FLOAT32 = struct.Struct("<f")
_WORD_BYTES = 8
_MODULUS = COUNTER_MODULUS


class Replaced:
    """Counts the values that could not be sent as they were.

    Attributes:
        not_numbers: number of NaN values replaced by the signal's start value.
        saturated: number of values outside their signal's range, replaced by the end of the range.
    """

    def __init__(self) -> None:
        """Begin with none."""
        self.not_numbers = 0
        self.saturated = 0


class Field:
    """The place of one signal in a frame, and the meaning of its bits.

    Attributes:
        signal: its name.
        shift, mask: its bits in the frame as one little-endian number: `number >> shift & mask`.
        sign: value of the sign bit of a signed signal (two's complement); 0 for an unsigned one and for a float.
        scale, offset: value = raw * scale + offset.
        low, high: its range.
        start: its start value.
        is_float: whether the bits are an IEEE 754 float of 32 bits.
    """

    def __init__(
        self,
        signal: str,
        shift: int,
        mask: int,
        sign: int,
        scale: float,
        offset: float,
        low: float,
        high: float,
        start: float,
        is_float: bool,
    ) -> None:
        """Describe a signal."""
        self.signal = signal
        self.shift = shift
        self.mask = mask
        self.sign = sign
        self.scale = scale
        self.offset = offset
        self.low = low
        self.high = high
        self.start = start
        self.is_float = is_float

    def value(self, raw: cython.ulonglong) -> cython.double:
        """Return the physical value of the signal's bits `raw`."""
        if self.is_float:
            return _FLOAT32.unpack(raw.to_bytes(4, "little"))[0]
        if self.sign:
            signed: cython.longlong = (raw ^ self.sign) - self.sign
            return signed * self.scale + self.offset
        return raw * self.scale + self.offset

    def raw(self, value: cython.double, replaced: Replaced) -> cython.ulonglong:
        """Return the bits of a value: round((value - offset) / scale), of a value in [low, high]."""
        if not self.low <= value <= self.high:
            if value < self.low:
                replaced.saturated += 1
                value = self.low
            elif value > self.high:
                replaced.saturated += 1
                value = self.high
            else:
                replaced.not_numbers += 1
                value = self.start
        if self.is_float:
            return int.from_bytes(_FLOAT32.pack(value), "little")
        number: cython.double = rint((value - self.offset) / self.scale)
        if number < 0.0:
            negative: cython.longlong = cython.cast(cython.longlong, number)
            return negative & self.mask
        return cython.cast(cython.ulonglong, number) & self.mask


class Layout:
    """The layout of one message.

    Attributes:
        name: its name.
        can_id: its identifier.
        length: number of bytes of its frames.
        data_id: its E2E data identifier, 0 for an unprotected message.
        crc_of_id: CRC of the data identifier, see `bench.bus.e2e.crc_of_id`.
        fields: all signals.
        encoded: the same without CRC and counter, which `encode` computes.
        states: the signals that have a value table, each with its values.
    """

    def __init__(
        self,
        name: str,
        can_id: int,
        length: int,
        data_id: int,
        crc_of_id: int,
        fields: tuple[Field, ...],
        encoded: tuple[Field, ...],
        states: tuple[tuple[str, frozenset[int]], ...],
    ) -> None:
        """Describe a message."""
        self.name = name
        self.can_id = can_id
        self.length = length
        self.data_id = data_id
        self.crc_of_id = crc_of_id
        self.fields = fields
        self.encoded = encoded
        self.states = states

    def encode(
        self, values: Mapping[str, float], counter: cython.int, replaced: Replaced, with_start_values: cython.bint
    ) -> bytes:
        """Return the bytes of the frame with these physical values.

        Args:
            values: by signal, without CRC and AliveCounter, in the DBC's units; other names are ignored.
            counter: the alive counter, taken modulo 15.
            replaced: counts values out of range.
            with_start_values: whether a signal without a value has its start value.

        Raises:
            KeyError: a signal has no value.
        """
        known: dict[str, Any] = values if type(values) is dict else dict(values)
        word: cython.ulonglong = 0
        number: Any = 0
        field: Field
        for field in self.encoded:
            given = known.get(field.signal)
            if given is None and field.signal not in known:
                if not with_start_values:
                    raise KeyError(field.signal)
                given = field.start
            raw: cython.ulonglong = field.raw(given, replaced)
            if self.length <= _WORD_BYTES:
                word |= raw << field.shift
            else:
                number |= int(raw) << field.shift
        if self.length > _WORD_BYTES:
            return self._long_frame(number, counter)
        if not self.data_id:
            return _bytes_of(word, self.length)
        alive_counter: cython.ulonglong = counter % _MODULUS
        word |= alive_counter << 8
        crc: cython.ulonglong = crc_from(self.crc_of_id, _bytes_of(word, self.length))
        return _bytes_of(word | crc, self.length)

    def _long_frame(self, number: Any, counter: cython.int) -> bytes:
        """Return a frame of more than 8 bytes, which only other buses' DBC files have."""
        data = bytearray(number.to_bytes(self.length, "little"))
        if self.data_id:
            protect(data, self.data_id, counter)
        return bytes(data)

    def decode(self, data: bytes) -> dict[str, float]:
        """Return the physical values of all signals of a frame of `length` bytes; CRC and counter unchecked."""
        values = {}
        field: Field
        if self.length <= _WORD_BYTES:
            word: cython.ulonglong = _word_of(data)
            for field in self.fields:
                values[field.signal] = field.value(word >> field.shift & field.mask)
        else:
            number: Any = int.from_bytes(data, "little")
            for field in self.fields:
                values[field.signal] = field.value(number >> field.shift & field.mask)
        return values

    def is_possible(self, values: Mapping[str, float]) -> cython.bint:
        """Return whether all states among a message's values are in their value tables."""
        return not [signal for signal, states in self.states if values[signal] not in states]


def _word_of(data: bytes) -> cython.ulonglong:
    """Return up to 8 bytes as one little-endian number."""
    word: cython.ulonglong = 0
    place: cython.Py_ssize_t
    for place in range(len(data)):
        byte: cython.ulonglong = data[place]
        word |= byte << 8 * place
    return word


def _bytes_of(word: cython.ulonglong, length: cython.int) -> bytes:
    """Return a little-endian number as up to 8 bytes."""
    if not cython.compiled:
        return bytes(word.to_bytes(length, "little"))
    buffer = cython.declare(cython.char[8])
    place: cython.int
    for place in range(length):
        buffer[place] = cython.cast(cython.char, word >> 8 * place & 0xFF)
    data: bytes = PyBytes_FromStringAndSize(buffer, length)
    return data
