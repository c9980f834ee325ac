# cython: boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""Length of a classical CAN data frame on the wire, with the exact stuff bits of its content.

ISO 11898-1: start of frame, identifier, control field, data and the CRC-15 are sent with a stuff bit of the other value
after every five equal bits, stuff bits among them; a stuff bit may also follow the last bit of the CRC. CRC delimiter,
ACK slot, ACK delimiter and the seven bits of end of frame are sent as they are, and three bits of interframe space
separate it from the next frame.

A frame is processed a byte at a time: CRC and stuffing are table-driven automata.
"""

import cython
import numpy as np
import numpy.typing as npt

from bench.bus.link.base import EXTENDED

INTERFRAME_BITS = 3
"""Bits after a frame during which no other may begin."""

_END_BITS = cython.declare(cython.int, 10)
"""CRC delimiter, ACK slot, ACK delimiter, end of frame."""

# Bits subject to stuffing besides the data, with an identifier of 11 bits and of 29.
_STUFFED_SHORT = cython.declare(cython.int, 34)
_STUFFED_LONG = cython.declare(cython.int, 54)

_HEAD_BYTES = cython.declare(cython.int, 5)
_CRC_POLYNOMIAL = cython.declare(cython.int, 0x4599)
_CRC_BITS = cython.declare(cython.int, 15)

_Bytes = npt.NDArray[np.uint8]
_Ints = npt.NDArray[np.int64]


def frame_bits(can_id: npt.NDArray[np.uint32], length: _Bytes, data: _Bytes) -> _Ints:
    """Return the number of bits of each frame from start to end of frame, without the interframe space.

    Args:
        can_id: (n,) identifiers; those of 29 bits have the bit `EXTENDED` set.
        length: (n,) bytes of data, 0..8.
        data: (n, 8) their data; bytes beyond `length` are ignored.

    Returns:
        (n,) bits.
    """
    bits = np.empty(len(can_id), np.int64)
    _count_bits(bits.data, *(np.array(column).data for column in (can_id, length, data)))
    return bits


def longest_bits(length: int, *, extended: bool = False) -> int:
    """Return the maximum number of bits of a frame of `length` bytes, including the interframe space.

    55 + 10 s with short and 80 + 10 s with long identifiers (Davis et al. 2007, equations 1 and 2).
    """
    stuffed = (_STUFFED_LONG if extended else _STUFFED_SHORT) + 8 * length
    bits: int = stuffed + (stuffed - 1) // 4 + _END_BITS + INTERFRAME_BITS
    return bits


def crc15(data: bytes) -> int:
    """Return the table of CAN's CRC (CRC-15/CAN) over whole bytes."""
    crc = 0
    for byte in data:
        crc = _CRC_TABLE[crc >> (_CRC_BITS - 8) ^ byte] ^ crc << 8 & 0x7FFF
    return crc


def priority(can_id: npt.NDArray[np.uint32]) -> _Ints:
    """Return the arbitration priority, (n,): the lowest wins.

    If the 11 leading bits are equal, the short identifier wins, because its next bits are dominant.
    """
    number = can_id.astype(np.int64) & ~EXTENDED
    return np.where(can_id & EXTENDED, (number >> 18) << 19 | 1 << 18 | number & 0x3FFFF, number << 19)


def _count_bits(
    bits: cython.longlong[::1],
    can_id: cython.uint[::1],
    length: cython.uchar[::1],
    data: cython.uchar[:, ::1],
) -> None:
    """Set `bits` of each frame; see `frame_bits`."""
    crc_table: cython.longlong[::1] = _CRC_TABLE
    stuff_byte: cython.longlong[::1] = _STUFF_BYTE
    stuff_seven: cython.longlong[::1] = _STUFF_SEVEN
    extended: cython.longlong = EXTENDED
    row: cython.Py_ssize_t
    at: cython.Py_ssize_t
    for row in range(bits.shape[0]):
        number: cython.longlong = can_id[row]
        size: cython.longlong = length[row]
        # Start of frame, identifier and control field, right-aligned in five bytes. Zeros before start of frame do not
        # change a CRC that starts at zero; alternating ones and zeros need no stuff bit.
        head: cython.longlong
        lead: cython.longlong
        if number & extended:
            # 11 leading bits, then SRR and IDE, which are 1, 18 more, and RTR, r1 and r0, which are 0.
            number ^= extended
            head = (number >> 18) << 27 | 0b11 << 25 | (number & 0x3FFFF) << 7 | size
            lead = 0x8000000000
            bits[row] = _STUFFED_LONG + 8 * size + _END_BITS
        else:
            # No SRR; RTR, IDE and r0 are 0.
            head = number << 7 | size
            lead = 0xAAAAA80000
            bits[row] = _STUFFED_SHORT + 8 * size + _END_BITS
        crc: cython.longlong = 0
        state: cython.longlong = 0
        stuffed: cython.longlong = 0
        for at in range(_HEAD_BYTES + size):
            byte: cython.longlong
            sent: cython.longlong
            if at < _HEAD_BYTES:
                byte = head >> 8 * (_HEAD_BYTES - 1 - at) & 0xFF
                sent = byte | lead >> 8 * (_HEAD_BYTES - 1 - at) & 0xFF
            else:
                byte = sent = data[row, at - _HEAD_BYTES]
            crc = crc_table[crc >> (_CRC_BITS - 8) ^ byte] ^ crc << 8 & 0x7FFF
            found: cython.longlong = stuff_byte[state << 8 | sent]
            state = found & 7
            stuffed += found >> 3
        found = stuff_byte[state << 8 | crc >> 7]
        stuffed += found >> 3
        stuffed += stuff_seven[(found & 7) << 7 | crc & 0x7F] >> 3
        bits[row] += stuffed


def _crc_table() -> _Ints:
    crc: _Ints = np.arange(256, dtype=np.int64) << (_CRC_BITS - 8)
    for _ in range(8):
        crc = np.where(crc & 0x4000, crc << 1 ^ _CRC_POLYNOMIAL, crc << 1) & 0x7FFF
    return crc


def _stuff_table(bits: int) -> _Ints:
    """Return the effect of `bits` more bits, by state << bits | value: number of stuff bits * 8 + next state.

    A state is the last bit and the length of its run: 4 * bit + run - 1, runs of 1 to 4.
    """
    state, value = np.meshgrid(np.arange(8), np.arange(1 << bits), indexing="ij")
    last, run, count = state >> 2, (state & 3) + 1, np.zeros_like(state)
    for shift in reversed(range(bits)):
        bit = value >> shift & 1
        run = np.where(bit == last, run + 1, 1)
        stuffed = run == 5
        count += stuffed
        last = np.where(stuffed, 1 - bit, bit)
        run = np.where(stuffed, 1, run)
    return (count << 3 | last << 2 | run - 1).reshape(-1)


# Interpreted, items of a memoryview are Python's integers, which are faster than numpy's.
_CRC_TABLE = _crc_table().data
_STUFF_BYTE = _stuff_table(8).data
_STUFF_SEVEN = _stuff_table(7).data
