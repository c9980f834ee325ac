"""Length of a classical CAN data frame on the wire, with the exact stuff bits of its content.

ISO 11898-1: start of frame, identifier, control field, data and the CRC-15 are sent with a stuff bit of the other value
after every five equal bits, stuff bits among them; a stuff bit may also follow the last bit of the CRC. CRC delimiter,
ACK slot, ACK delimiter and the seven bits of end of frame are sent as they are, and three bits of interframe space
separate it from the next frame.

Many frames are processed at once, one byte of each at a time: CRC and stuffing are table-driven automata.
"""

import numpy as np
import numpy.typing as npt

from bench.bus.link.base import EXTENDED

INTERFRAME_BITS = 3
"""Bits after a frame during which no other may begin."""

_END_BITS = 10
"""CRC delimiter, ACK slot, ACK delimiter, end of frame."""

_HEAD_BYTES = 5
_CRC_POLYNOMIAL = 0x4599
_CRC_BITS = 15
_STUFFED_BITS = {False: 34, True: 54}
"""Bits subject to stuffing besides the data, indexed by whether the identifier has 29 bits."""

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
    extended = (can_id & EXTENDED) != 0
    head = _heads(can_id.astype(np.int64), extended, length)
    bits = np.where(extended, _STUFFED_BITS[True], _STUFFED_BITS[False]) + 8 * length.astype(np.int64) + _END_BITS
    for size in np.flatnonzero(np.bincount(length)).tolist():
        rows = np.flatnonzero(length == size)
        bits[rows] += _stuff_bits(head[rows], extended[rows], data[rows, :size])
    return bits


def longest_bits(length: int, *, extended: bool = False) -> int:
    """Return the maximum number of bits of a frame of `length` bytes, including the interframe space.

    55 + 10 s with short and 80 + 10 s with long identifiers (Davis et al. 2007, equations 1 and 2).
    """
    stuffed = _STUFFED_BITS[extended] + 8 * length
    return stuffed + (stuffed - 1) // 4 + _END_BITS + INTERFRAME_BITS


def crc15(data: bytes) -> int:
    """Return the table of CAN's CRC (CRC-15/CAN) over whole bytes."""
    return int(_crc(np.frombuffer(data, np.uint8).reshape(1, -1))[0])


def priority(can_id: npt.NDArray[np.uint32]) -> _Ints:
    """Return the arbitration priority, (n,): the lowest wins.

    If the 11 leading bits are equal, the short identifier wins, because its next bits are dominant.
    """
    number = can_id.astype(np.int64) & ~EXTENDED
    return np.where(can_id & EXTENDED, (number >> 18) << 19 | 1 << 18 | number & 0x3FFFF, number << 19)


def _heads(can_id: _Ints, extended: npt.NDArray[np.bool_], length: _Bytes) -> _Bytes:
    """Return start of frame, identifier and control field of each frame, (n, 5), right-aligned.

    The bits before start of frame are zeros, which do not change a CRC that starts at zero.
    """
    number = can_id & ~EXTENDED
    # 11 leading bits, SRR = IDE = 1, 18 more, RTR = r1 = r0 = 0; and 11 bits, RTR = IDE = r0 = 0.
    long = (number >> 18) << 27 | 0b11 << 25 | (number & 0x3FFFF) << 7
    word = np.where(extended, long, number << 7) | length
    return word.astype(">u8").view(np.uint8).reshape(-1, 8)[:, -_HEAD_BYTES:]


def _crc(frames: _Bytes) -> _Ints:
    """Return the CRC over the bytes of each row, (n,)."""
    crc = np.zeros(len(frames), np.int64)
    for column in frames.T.astype(np.int64):
        crc = _CRC_TABLE.take(crc >> (_CRC_BITS - 8) ^ column) ^ crc << 8 & 0x7FFF
    return crc


def _stuff_bits(head: _Bytes, extended: npt.NDArray[np.bool_], data: _Bytes) -> _Ints:
    """Return the number of stuff bits of frames that all have the same length, (n,)."""
    frames = np.hstack([head, data])
    crc = _crc(frames)
    # Before start of frame alternating ones and zeros: they need no stuff bit, and start of frame begins a new run.
    frames[:, :_HEAD_BYTES] |= np.where(extended[:, None], _LEAD_LONG, _LEAD_SHORT)
    state = np.zeros(len(frames), np.int64)
    count = np.zeros(len(frames), np.int64)
    for column in (*frames.T.astype(np.int64), crc >> 7):
        found = _STUFF_BYTE.take(state << 8 | column)
        state = found & 7
        count += found >> 3
    return count + (_STUFF_SEVEN.take(state << 7 | crc & 0x7F) >> 3)


def _crc_table() -> _Ints:
    crc = np.arange(256, dtype=np.int64) << (_CRC_BITS - 8)
    for _ in range(8):
        crc = np.where(crc & 0x4000, crc << 1 ^ _CRC_POLYNOMIAL, crc << 1) & 0x7FFF
    return crc


def _stuff_table(bits: int) -> _Ints:
    """Return the effect of `bits` more bits, by state and their value: number of stuff bits * 8 + next state.

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
    return count << 3 | last << 2 | run - 1


_CRC_TABLE = _crc_table()
_STUFF_BYTE = _stuff_table(8)
_STUFF_SEVEN = _stuff_table(7)
_LEAD_SHORT = np.frombuffer(bytes.fromhex("AAAAA80000"), np.uint8)
_LEAD_LONG = np.frombuffer(bytes.fromhex("8000000000"), np.uint8)
