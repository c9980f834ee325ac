"""Links over Linux sockets: python-can opens the bus, frames are read from its socket.

python-can defines what frames look like on the wire, so every python-can tool takes part. Reading the socket here is
several times faster than python-can's `recv`, and only the socket gives access to the size of the receive buffer and
the kernel's count of dropped frames.
"""

import os
import socket
import struct
from abc import abstractmethod
from collections.abc import Sequence
from typing import Protocol

from bench.bus.frame import CanFrame
from bench.bus.link.base import MOST_FRAMES, Link, LinkError
from bench.bus.link.datagrams import BATCH, Datagrams
from bench.errors import BadInput

RECEIVE_BUFFER_BYTES = 8 * 1024 * 1024
"""The default buffer holds about 256 frames; further frames are dropped."""

_SO_RCVBUFFORCE = 33
_SO_MEMINFO = 55
_SO_TIMESTAMPNS = 35
"""The old option number, which on 64-bit systems gives the same result as the new one."""
_MEMINFO = struct.Struct("=9I")
_MEMINFO_DROPS = 8


class Opened(Protocol):
    """The owner of an open socket, which closes it: a python-can bus or similar."""

    def fileno(self) -> int:
        """Return the socket's file descriptor."""

    def shutdown(self) -> None:
        """Close the socket."""


class SocketLink(Link):
    """A link over the socket of a bus, which it takes over and closes."""

    def __init__(self, name: str, bus: Opened, destination: tuple[str, int] | None = None) -> None:
        """Take over `bus`; its datagrams go to the address and port `destination` if it needs one.

        Raises:
            BadInput: the kernel does not report the number of dropped frames.
        """
        super().__init__(name)
        self._bus = bus
        self._socket = socket.socket(fileno=os.dup(bus.fileno()))
        self._datagrams = Datagrams(self._socket, destination)
        _raise_receive_buffer(self._socket)
        try:
            self.frames_lost()
        except OSError as error:
            self.close()
            raise BadInput(
                f"bus {name}: this kernel does not count lost frames (SO_MEMINFO, Linux 4.12 or newer)"
            ) from error

    @abstractmethod
    def _parse(self, datagram: bytes) -> CanFrame | None:
        """Return the frame in a datagram; None if sent by this link, or if ignored (and counted)."""

    @abstractmethod
    def _packed(self, can_id: int, data: bytes) -> bytes:
        """Return the datagram of a frame."""

    def _mend(self, error: OSError) -> str:
        """Return why a frame cannot be sent, and what helps."""
        return str(error)

    def send(self, can_id: int, data: bytes | bytearray) -> None:
        """See `Link`."""
        self.send_all([CanFrame(can_id, bytes(data))])

    def send_all(self, frames: Sequence[CanFrame]) -> None:
        """See `Link`."""
        try:
            self._datagrams.send([self._packed(can_id, data) for can_id, data in frames])
        except OSError as error:
            can_id, _ = frames[self._datagrams.sent]
            raise LinkError(f"bus {self.name}: frame 0x{can_id:03X} cannot be sent: {self._mend(error)}") from error

    def receive(self) -> list[CanFrame]:
        """See `Link`."""
        frames: list[CanFrame] = []
        times = self.times
        arrived: list[int] | None = None if times is None else []
        if times is not None:
            times.clear()
        try:
            for _ in range(MOST_FRAMES // BATCH):
                datagrams = self._datagrams.receive(arrived)
                for place, datagram in enumerate(datagrams):
                    frame = self._parse(datagram)
                    if frame is not None:
                        frames.append(frame)
                        if times is not None and arrived is not None:
                            times.append(arrived[place])
                if len(datagrams) < BATCH:
                    break
                if arrived is not None:
                    arrived.clear()
        except OSError as error:
            raise LinkError(f"bus {self.name}: no frames can be received: {error.strerror}") from error
        return frames

    def keep_times(self) -> None:
        """See `Link`."""
        self._socket.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
        self.times = []

    def fileno(self) -> int:
        """See `Link`."""
        return self._socket.fileno()

    def frames_lost(self) -> int:
        """Return the kernel's drop counter of the socket (sk_drops, which SO_RXQ_OVFL reports too).

        SO_MEMINFO gives it at any time. SO_RXQ_OVFL gives it only with the next frame that was not dropped, so the last
        losses would go unnoticed, and python-can's `recv` fails on a second ancillary message.
        """
        memory = self._socket.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, _MEMINFO.size)
        return int(_MEMINFO.unpack(memory)[_MEMINFO_DROPS])

    def close(self) -> None:
        """See `Link`."""
        self._socket.close()
        self._bus.shutdown()


def _raise_receive_buffer(sock: socket.socket) -> None:
    """Request a large receive buffer; without the privilege to force it, the limit is the system's rmem_max."""
    try:
        sock.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, RECEIVE_BUFFER_BYTES)
    except PermissionError:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)
