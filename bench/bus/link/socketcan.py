"""The bus `vcan` and every other CAN link of the Linux kernel (SocketCAN), virtual or real."""

import errno
import socket
import struct
import sys
from collections.abc import Collection

from bench.bus.frame import CanFrame
from bench.bus.link.kernel_links import check_links
from bench.bus.link.sockets import Opened, SocketLink
from bench.errors import BadInput
from bench.events import Refusal

_FRAME = struct.Struct("=IB3x8s")
"""struct can_frame of linux/can.h: identifier and flags, length, data."""

_FILTER = struct.Struct("=II")
"""struct can_filter of linux/can.h: identifier and flags, and the mask of bits that must match."""

_EXACTLY = 0xDFFF_FFFF
"""All bits of identifier and flags except the error flag, which in a mask selects error frames only."""

_REMOTE, _ERROR = 0x4000_0000, 0x2000_0000
_REMOTE_OR_ERROR = _REMOTE | _ERROR


class SocketcanLink(SocketLink):
    """A raw CAN socket bound to one link of the kernel."""

    def __init__(self, name: str, channel: str) -> None:
        """Join the bus `name` on the kernel's link `channel`, e.g. vcan0.

        Raises:
            BadInput: it cannot be opened; the message gives the reason.
        """
        super().__init__(name, _open(name, channel))
        self._channel = channel
        # Without this, the kernel keeps CAN FD frames to itself, and nobody would know of them.
        self._socket.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FD_FRAMES, 1)

    def _packed(self, can_id: int, data: bytes) -> bytes:
        return _FRAME.pack(can_id, len(data), data)

    def _mend(self, error: OSError) -> str:
        mend = f"try: sudo ip link set {self._channel} txqueuelen 1000"
        return f"{error.strerror}; {mend}" if error.errno == errno.ENOBUFS else str(error.strerror)

    def select(self, can_ids: Collection[int]) -> None:
        """See `Link`; the kernel filters the frames."""
        filters = b"".join(_FILTER.pack(can_id, _EXACTLY) for can_id in can_ids)
        self._socket.setsockopt(socket.SOL_CAN_RAW, socket.CAN_RAW_FILTER, filters)

    def _parse(self, datagram: bytes) -> CanFrame | None:
        if len(datagram) != _FRAME.size:
            # struct canfd_frame begins likewise.
            self._ignore(Refusal.FD, int.from_bytes(datagram[:4], sys.byteorder))
            return None
        can_id, length, data = _FRAME.unpack(datagram)
        if can_id & _REMOTE_OR_ERROR:
            self._ignore(*(Refusal.ERROR, None) if can_id & _ERROR else (Refusal.REMOTE, can_id & ~_REMOTE))
            return None
        return CanFrame(can_id, data[:length])


def _open(name: str, channel: str) -> Opened:
    check_links([channel])
    # Imported here: no other bus needs python-can.
    from can.interfaces.socketcan import SocketcanBus

    try:
        return SocketcanBus(channel)
    except OSError as error:
        raise BadInput(f"bus {name}: CAN link {channel} cannot be opened: {error.strerror}") from error
