"""Links over Linux sockets: python-can opens the bus, frames are read from its socket.

python-can defines what frames look like on the wire, so every python-can tool takes part. Reading the socket here is
several times faster than python-can's `recv`, and only the socket gives access to the size of the receive buffer and
the kernel's count of dropped frames.
"""

import os
import socket
import struct
from abc import abstractmethod
from typing import Protocol

from bench.bus.frame import CanFrame
from bench.bus.link.base import MOST_FRAMES, Link, LinkError
from bench.errors import BadInput

RECEIVE_BUFFER_BYTES = 8 * 1024 * 1024
"""The default buffer holds about 256 frames; further frames are dropped."""

_DATAGRAM_BYTES = 1024
_SO_RCVBUFFORCE = 33
_SO_MEMINFO = 55
_SO_TIMESTAMPNS = 35
"""The old option number, which on 64-bit systems gives the same result as the new one."""
_TIMESPEC = struct.Struct("=qq")
_ANCILLARY_BYTES = socket.CMSG_SPACE(_TIMESPEC.size)
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

    def __init__(self, name: str, bus: Opened) -> None:
        """Take over `bus`.

        Raises:
            BadInput: the kernel does not report the number of dropped frames.
        """
        super().__init__(name)
        self._bus = bus
        self._socket = socket.socket(fileno=os.dup(bus.fileno()))
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

    def receive(self) -> list[CanFrame]:
        """See `Link`."""
        frames: list[CanFrame] = []
        try:
            if self.times is None:
                self._receive(frames)
            else:
                self.times.clear()
                self._receive_timed(frames, self.times)
        except BlockingIOError:
            pass
        except OSError as error:
            raise LinkError(f"bus {self.name}: no frames can be received: {error.strerror}") from error
        return frames

    def _receive(self, frames: list[CanFrame]) -> None:
        """Append the frames that have arrived to `frames`, until `BlockingIOError` when there are no more."""
        receive, parse = self._socket.recv, self._parse
        for _ in range(MOST_FRAMES):
            frame = parse(receive(_DATAGRAM_BYTES, socket.MSG_DONTWAIT))
            if frame is not None:
                frames.append(frame)

    def _receive_timed(self, frames: list[CanFrame], times: list[int]) -> None:
        """The same, with the time at which the kernel received each."""
        receive, parse = self._socket.recvmsg, self._parse
        for _ in range(MOST_FRAMES):
            datagram, ancillary, _, _ = receive(_DATAGRAM_BYTES, _ANCILLARY_BYTES, socket.MSG_DONTWAIT)
            frame = parse(datagram)
            if frame is not None:
                seconds, nanoseconds = _TIMESPEC.unpack(ancillary[-1][2])
                frames.append(frame)
                times.append(seconds * 1_000_000_000 + nanoseconds)

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
