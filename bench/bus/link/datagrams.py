"""Many datagrams with one call of the system: the way of a link's frames through a socket of the kernel.

Linux reads and sends many at once (recvmmsg, sendmmsg), and divides a long UDP datagram into many of one length
(UDP_SEGMENT), which costs a third of sending them one after the other; receivers see no difference. Interpreted, or
where the kernel cannot, each datagram has a call of its own.
"""

import errno
import os
import socket
import struct
from collections.abc import Sequence

import cython

if cython.compiled:
    from cython.cimports.bench.bus.link.datagrams import (
        CMSG_DATA,
        CMSG_FIRSTHDR,
        CMSG_LEN,
        CMSG_SPACE,
        MSG_DONTWAIT,
        cmsghdr,
        mmsghdr,
        recvmmsg,
        sendmmsg,
        sendmsg,
    )
    from cython.cimports.cpython.bytes import PyBytes_FromStringAndSize
    from cython.cimports.libc.errno import errno as last_error
    from cython.cimports.libc.string import memcpy, memset

BATCH = 32
"""Number of datagrams that one call reads."""

MOST_SEGMENTS = 64
"""Number of datagrams that Linux makes of a long one."""

DATAGRAM_BYTES = 1024
"""Longer datagrams, which are no frames, are cut off."""

_UDP_SEGMENT = 103
_TIMESPEC = struct.Struct("=qq")
_ANCILLARY_BYTES = 64
_CANNOT = frozenset((errno.EIO, errno.EINVAL, errno.ENOPROTOOPT, errno.EOPNOTSUPP, errno.EMSGSIZE, errno.ENOSYS))
_BATCH, _MOST_SEGMENTS, _DATAGRAM_BYTES = BATCH, MOST_SEGMENTS, DATAGRAM_BYTES

Times = list[int] | None
"""Arrival times in ns; None if nobody wants them."""


class Datagrams:
    """The datagrams of one socket, which it does not own.

    Attributes:
        sent: number of datagrams sent by the newest `send`, also if it failed.
    """

    def __init__(self, sock: socket.socket, destination: tuple[str, int] | None = None) -> None:
        """Send to the IPv4 address and port `destination`; None for a socket that has one."""
        self.sent = 0
        self._socket = sock
        self._destination = destination
        self._segments = destination is not None
        if cython.compiled:
            memset(cython.address(self._name), 0, cython.sizeof(self._name))
            if destination is not None:
                packed: bytes = socket.inet_aton(destination[0])
                self._name.sin_family = socket.AF_INET
                self._name.sin_port = socket.htons(destination[1])
                memcpy(cython.address(self._name.sin_addr), cython.cast("const char *", packed), 4)

    def receive(self, times: Times) -> list[bytes]:
        """Return up to `BATCH` datagrams that have arrived, without waiting; append their arrival to `times` (ns).

        Raises:
            OSError: the socket fails.
        """
        if not cython.compiled:
            return self._receive_one_by_one(times)
        place: cython.int
        for place in range(_BATCH):
            self._vectors[place].iov_base = cython.address(self._data[place * _DATAGRAM_BYTES])
            self._vectors[place].iov_len = _DATAGRAM_BYTES
            memset(cython.address(self._headers[place]), 0, cython.sizeof(mmsghdr))
            self._headers[place].msg_hdr.msg_iov = cython.address(self._vectors[place])
            self._headers[place].msg_hdr.msg_iovlen = 1
            if times is not None:
                self._headers[place].msg_hdr.msg_control = cython.address(self._ancillary[place * 64])
                self._headers[place].msg_hdr.msg_controllen = 64
        count: cython.int = recvmmsg(self._socket.fileno(), self._headers, _BATCH, MSG_DONTWAIT, cython.NULL)
        if count < 0:
            if last_error == errno.EAGAIN:
                return []
            if last_error == errno.ENOSYS:
                return self._receive_one_by_one(times)
            raise OSError(last_error, os.strerror(last_error))
        received = []
        for place in range(count):
            data = cython.address(self._data[place * _DATAGRAM_BYTES])
            received.append(PyBytes_FromStringAndSize(data, self._headers[place].msg_len))
            if times is not None:
                ancillary = cython.address(self._ancillary[place * 64])
                length: cython.Py_ssize_t = self._headers[place].msg_hdr.msg_controllen
                times.append(_nanoseconds(PyBytes_FromStringAndSize(ancillary, length)[-_TIMESPEC.size :]))
        return received

    def _receive_one_by_one(self, times: Times) -> list[bytes]:
        received = []
        try:
            while len(received) < _BATCH:
                if times is None:
                    received.append(self._socket.recv(DATAGRAM_BYTES, socket.MSG_DONTWAIT))
                else:
                    datagram, ancillary, _, _ = self._socket.recvmsg(
                        DATAGRAM_BYTES, _ANCILLARY_BYTES, socket.MSG_DONTWAIT
                    )
                    received.append(datagram)
                    times.append(_nanoseconds(ancillary[-1][2]))
        except BlockingIOError:
            pass
        return received

    def send(self, datagrams: Sequence[bytes]) -> None:
        """Send datagrams in this order.

        Raises:
            OSError: the socket does not take one of them: the one after the first `sent`.
        """
        self.sent = 0
        if not cython.compiled or len(datagrams) == 1:
            self._send_one_by_one(datagrams)
            return
        while self.sent < len(datagrams):
            self._send_some(list(datagrams[self.sent : self.sent + _MOST_SEGMENTS]))

    def _send_one_by_one(self, datagrams: Sequence[bytes]) -> None:
        for datagram in datagrams[self.sent :]:
            if self._destination is None:
                self._socket.send(datagram)
            else:
                self._socket.sendto(datagram, self._destination)
            self.sent += 1

    def _send_some(self, datagrams: Sequence[bytes]) -> None:
        """Send some of up to `MOST_SEGMENTS` datagrams, at least one."""
        length: cython.Py_ssize_t = len(datagrams[0])
        place: cython.int
        count: cython.int = 0
        for place in range(len(datagrams)):
            datagram: bytes = datagrams[place]
            self._vectors[place].iov_base = cython.cast(cython.p_void, cython.cast("char *", datagram))
            self._vectors[place].iov_len = len(datagram)
            memset(cython.address(self._headers[place]), 0, cython.sizeof(mmsghdr))
            self._headers[place].msg_hdr.msg_iov = cython.address(self._vectors[place])
            self._headers[place].msg_hdr.msg_iovlen = 1
            if self._destination is not None:
                self._headers[place].msg_hdr.msg_name = cython.address(self._name)
                self._headers[place].msg_hdr.msg_namelen = cython.sizeof(self._name)
            count += count == place and len(datagram) == length
        if self._segments and count > 1:
            if self._send_segments(count, length):
                return
            self._segments = False
        sent: cython.int = sendmmsg(self._socket.fileno(), self._headers, len(datagrams), 0)
        if sent < 0:
            if last_error == errno.ENOSYS:
                self._send_one_by_one([*datagrams])
                return
            raise OSError(last_error, os.strerror(last_error))
        self.sent += sent

    def _send_segments(self, count: cython.int, length: cython.Py_ssize_t) -> cython.bint:
        """Send the first `count` datagrams, all of this length, as one; return whether this socket can.

        Raises:
            OSError: it can, but the frames cannot be sent.
        """
        self._headers[0].msg_hdr.msg_iovlen = count
        self._headers[0].msg_hdr.msg_control = cython.address(self._ancillary[0])
        self._headers[0].msg_hdr.msg_controllen = CMSG_SPACE(2)
        control: cython.pointer(cmsghdr) = CMSG_FIRSTHDR(cython.address(self._headers[0].msg_hdr))
        control.cmsg_level = socket.IPPROTO_UDP
        control.cmsg_type = _UDP_SEGMENT
        control.cmsg_len = CMSG_LEN(2)
        segment: cython.ushort = length
        memcpy(CMSG_DATA(control), cython.address(segment), 2)
        if sendmsg(self._socket.fileno(), cython.address(self._headers[0].msg_hdr), 0) >= 0:
            self.sent += count
            return True
        error: cython.int = last_error
        if error not in _CANNOT:
            raise OSError(error, os.strerror(error))
        self._headers[0].msg_hdr.msg_iovlen = 1
        self._headers[0].msg_hdr.msg_control = cython.NULL
        self._headers[0].msg_hdr.msg_controllen = 0
        return False


def _nanoseconds(timespec: bytes) -> int:
    seconds, nanoseconds = _TIMESPEC.unpack(timespec)
    return int(seconds * 1_000_000_000 + nanoseconds)
