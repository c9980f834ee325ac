"""AUTOSAR E2E Profile 1, variant DATAID_BOTH: CRC, alive counter and age of protected messages.

AUTOSAR Foundation, "E2E Protocol Specification" (PRS_E2EProtocol), Profile 1: byte 0 holds the CRC, the low
nibble of byte 1 the counter 0..14. The CRC is the CRC-8 of SAE J1850 (polynomial 0x1D, start and final value
0) over the data identifier's low byte, its high byte and then bytes 1, 2, ... of the message.
"""

from collections.abc import Sequence
from enum import Enum

import cython

CRC_SIGNAL, COUNTER_SIGNAL = "CRC", "AliveCounter"
"""The DBC's names for the two signals of a protected message."""

COUNTER_MODULUS = 15
"""The counter runs 0..14; 15 is never sent."""

_POLYNOMIAL = 0x1D
_COUNTER_MASK = 0x0F


def _crc_table() -> tuple[int, ...]:
    table = []
    for byte in range(256):
        crc = byte
        for _ in range(8):
            crc = ((crc << 1) ^ _POLYNOMIAL if crc & 0x80 else crc << 1) & 0xFF
        table.append(crc)
    return tuple(table)


CRC_TABLE = _crc_table()
_TABLE = bytes(CRC_TABLE)
_MODULUS = COUNTER_MODULUS


def crc_of_id(data_id: int) -> int:
    """Return the CRC over the two bytes of `data_id` (0..65535): the start value for its message's CRC."""
    return CRC_TABLE[CRC_TABLE[data_id & 0xFF] ^ data_id >> 8]


def crc_from(start: cython.int, data: bytes) -> cython.int:
    """Return the CRC that byte 0 of the message `data` must hold, from that of its data identifier."""
    crc: cython.int = start
    place: cython.Py_ssize_t
    for place in range(1, len(data)):
        crc = _TABLE[crc ^ data[place]]
    return crc


def crc_of_message(data: Sequence[int], data_id: int) -> int:
    """Return the CRC that byte 0 of the message `data` must hold; byte 0 itself is ignored."""
    return int(crc_from(crc_of_id(data_id), bytes(data)))


def protect(data: bytearray, data_id: int, counter: int) -> None:
    """Write counter (modulo 15, low nibble of byte 1) and CRC (byte 0) into `data`, 2 bytes or more."""
    data[1] = data[1] & 0xF0 | counter % COUNTER_MODULUS
    data[0] = crc_of_message(data, data_id)


def is_whole(data: bytes, start: cython.int) -> cython.bint:
    """Return whether `data` is valid: its CRC that from `start`, that of its data identifier, its counter not 15."""
    return len(data) >= 2 and data[1] & _COUNTER_MASK < _MODULUS and data[0] == crc_from(start, data)


def check(data: Sequence[int], data_id: int) -> bool:
    """Return whether `data` is a valid frame of message `data_id`: correct CRC, counter not 15."""
    return bool(is_whole(bytes(data), crc_of_id(data_id)))


class Status(Enum):
    """Result of a check by `Receiver`."""

    OK = "ok"
    """Valid frame, counter as expected: use it."""
    REPEATED = "repeated"
    """CRC correct, but the counter is that of the previous frame: a repeated frame, do not use."""
    WRONG_SEQUENCE = "wrong_sequence"
    """CRC correct, but the counter jumped by more than the elapsed cycles allow: do not use."""
    ERROR = "error"
    """Wrong CRC, invalid counter or too short: do not use."""
    NONE = "none"
    """No frame has arrived in this cycle, or none ever."""


# A member of an enumeration is looked up in 50 ns.
_OK, _REPEATED, _WRONG_SEQUENCE = Status.OK, Status.REPEATED, Status.WRONG_SEQUENCE
_ERROR, _NONE = Status.ERROR, Status.NONE

_NO_COUNTER = -1
"""Before the first frame."""


class Receiver:
    """Checks the received frames of one protected message, cycle by cycle.

    Call `check` for a frame, or `missed` at the end of a cycle without one. As in the profile, each cycle without a
    frame allows the counter one more step, so that a lost frame does not invalidate the next one. After a wrong
    sequence the received counter is the new start: a restarted sender is accepted from its second frame on.

    Attributes:
        status: the result of the last call.
        age: cycles since the last valid frame, 0 is this cycle; before the first one, since the start.
        errors: number of frames rejected (repeated, wrong sequence, error).
    """

    def __init__(self, data_id: int, max_step: int = 1) -> None:
        """Expect the message of `data_id`, whose counter increases by at most `max_step` (1..14) per frame."""
        self._crc_of_id = crc_of_id(data_id)
        self._max_step = max_step
        self._allowed_step = max_step
        self._counter = _NO_COUNTER
        self.status = Status.NONE
        self.age = 0
        self.errors = 0

    def check(self, data: Sequence[int]) -> Status:
        """Check one frame; use it only if the result is `Status.OK`."""
        self.status = self._status_of(bytes(data))
        if self.status is _OK:
            self.age = 0
        else:
            self.errors += 1
        return self.status

    def missed(self) -> Status:
        """Note that a cycle ended without a valid frame."""
        self.age += 1
        self._allowed_step = min(self._allowed_step + 1, _MODULUS - 1)
        self.status = _NONE
        return self.status

    def _status_of(self, data: bytes) -> Status:
        if not is_whole(data, self._crc_of_id):
            return _ERROR
        counter: cython.int = data[1] & _COUNTER_MASK
        previous: cython.int = self._counter
        self._counter = counter
        if previous == _NO_COUNTER:
            return _OK
        step: cython.int = (counter - previous) % _MODULUS
        if step == 0:
            return _REPEATED
        allowed: cython.int = self._allowed_step
        self._allowed_step = self._max_step
        return _OK if step <= allowed else _WRONG_SEQUENCE
