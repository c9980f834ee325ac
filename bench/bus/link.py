"""Links: a process's ends of the buses, over python-can interfaces.

python-can opens the bus and defines what its frames look like on the wire, so that every python-can tool
takes part. On its two interfaces of Linux sockets, udp_multicast and socketcan, frames are then read from the
bus's own socket: that is several times faster than `recv`, and it is where the receive buffer can be raised
and the kernel's count of dropped frames be read.
"""

import errno
import os
import socket
import struct
from abc import ABC, abstractmethod
from types import TracebackType

import can
import msgpack
from can.interfaces.socketcan import SocketcanBus
from can.interfaces.udp_multicast import UdpMulticastBus

from bench.bus.address import Address
from bench.errors import BadInput, RunFailed

BIT_RATE = 500_000
"""Bits per second, as in the DBC files."""

EXTENDED = 0x8000_0000
"""Set in identifiers of 29 bits (Linux's CAN_EFF_FLAG), so none is taken for the 11-bit one of its number."""

RECEIVE_BUFFER_BYTES = 8 * 1024 * 1024
"""The default buffer holds about 256 frames, and what does not fit vanishes."""

_MOST_FRAMES = 4096
"""Frames that one `receive` returns at most, so that a babbling sender cannot keep it for ever."""


class LinkError(RunFailed):
    """A bus that was open does not take or give frames any more."""


class Link(ABC):
    """One end of one bus. Frames sent here are not received back here.

    Attributes:
        name: the bus, `v2v` or `veh<i>`.
        ignored: frames received that are none of classical CAN with data (remote, error, CAN FD, malformed),
            so far.
    """

    def __init__(self, name: str) -> None:
        """Name the link."""
        self.name = name
        self.ignored = 0

    @abstractmethod
    def send(self, can_id: int, data: bytes) -> None:
        """Send a classical frame with an 11-bit identifier and up to 8 bytes.

        Raises:
            LinkError: the bus does not take it.
        """

    @abstractmethod
    def receive(self) -> list[tuple[int, bytes]]:
        """Return identifier and data of the frames that have arrived, in their order.

        Never blocks. Identifiers of 29 bits have the bit `EXTENDED` set. A very full queue is returned in
        parts.

        Raises:
            LinkError: the bus has gone down.
        """

    @abstractmethod
    def fileno(self) -> int:
        """Return the file descriptor that is readable while frames wait; -1 for `direct`, which has none."""

    @abstractmethod
    def frames_lost(self) -> int:
        """Return the frames that the kernel dropped, so far, as this link's receive buffer was full."""

    @abstractmethod
    def close(self) -> None:
        """Leave the bus; harmless when done before."""

    def __enter__(self) -> "Link":
        """Return the link itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Leave the bus."""
        self.close()


def open_link(bus: str, address: Address) -> Link:
    """Open this process's end of a bus (`v2v` or `veh<i>`) at the address.

    Raises:
        BadInput: the bus is not there or cannot be used; the message says what to type.
    """
    if address.interface == "udp_multicast":
        return _UdpLink(bus, address.port_of(bus))
    if address.interface == "socketcan":
        return _SocketcanLink(bus, address.channel_of(bus))
    return _AnyLink(bus, address.interface, address.channel_of(bus))


class _AnyLink(Link):
    """Any python-can interface by python-can's own calls; losses are not known, so none are counted."""

    def __init__(self, name: str, interface: str, channel: str) -> None:
        super().__init__(name)
        try:
            self._bus = can.Bus(interface=interface, channel=channel, bitrate=BIT_RATE)
        except (can.CanError, OSError, ImportError, ValueError) as error:
            raise BadInput(f"bus {name}: python-can cannot open {interface}:{channel}: {error}") from error
        try:
            self._fileno = self._bus.fileno()
        except NotImplementedError:
            self._fileno = -1
        if self._fileno < 0 and interface != "virtual":
            self.close()
            raise BadInput(
                f"bus {name}: interface {interface} has no file descriptor to wait on, which the bench needs"
            )

    def send(self, can_id: int, data: bytes) -> None:
        try:
            self._bus.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))
        except can.CanError as error:
            raise LinkError(f"bus {self.name}: frame 0x{can_id:03X} cannot be sent: {error}") from error

    def receive(self) -> list[tuple[int, bytes]]:
        frames: list[tuple[int, bytes]] = []
        while len(frames) < _MOST_FRAMES:
            try:
                message = self._bus.recv(timeout=0)
            except can.CanError as error:
                raise LinkError(f"bus {self.name}: {error}") from error
            if message is None:
                break
            if message.is_remote_frame or message.is_error_frame or message.is_fd:
                self.ignored += 1
                continue
            can_id = message.arbitration_id | (EXTENDED if message.is_extended_id else 0)
            frames.append((can_id, bytes(message.data)))
        return frames

    def fileno(self) -> int:
        return self._fileno

    def frames_lost(self) -> int:
        return 0

    def close(self) -> None:
        self._bus.shutdown()


class _SocketLink(Link):
    """A bus that is a Linux socket, opened by python-can."""

    def __init__(self, name: str, bus: can.BusABC) -> None:
        super().__init__(name)
        self._bus = bus
        self._socket = socket.socket(fileno=os.dup(bus.fileno()))
        _raise_receive_buffer(self._socket)

    @abstractmethod
    def _parse(self, datagram: bytes) -> tuple[int, bytes] | None:
        """Return the frame in a datagram, None for one of our own or one to be ignored (and counted)."""

    def receive(self) -> list[tuple[int, bytes]]:
        frames: list[tuple[int, bytes]] = []
        receive, parse = self._socket.recv, self._parse
        try:
            for _ in range(_MOST_FRAMES):
                frame = parse(receive(1024, socket.MSG_DONTWAIT))
                if frame is not None:
                    frames.append(frame)
        except BlockingIOError:
            pass
        except OSError as error:
            raise LinkError(f"bus {self.name}: {error.strerror}") from error
        return frames

    def fileno(self) -> int:
        return self._socket.fileno()

    def frames_lost(self) -> int:
        return _drops(self._socket)

    def close(self) -> None:
        self._socket.close()
        self._bus.shutdown()


class _UdpLink(_SocketLink):
    """python-can's udp_multicast: a msgpack map per frame, to all sockets of group and port on this host."""

    def __init__(self, name: str, port: int) -> None:
        # Frames to a group come back to their sender; this mark in python-can's field `channel` tells them
        # apart.
        self._mark = f"{name}/{os.urandom(8).hex()}"
        super().__init__(name, _open_udp(name, port))

    def send(self, can_id: int, data: bytes) -> None:
        message = can.Message(
            arbitration_id=can_id, data=data, is_extended_id=False, channel=self._mark, check=False
        )
        try:
            self._bus.send(message)
        except can.CanError as error:
            raise LinkError(f"bus {self.name}: frame 0x{can_id:03X}: {error}: {error.__cause__}") from error

    def _parse(self, datagram: bytes) -> tuple[int, bytes] | None:
        try:
            frame = msgpack.unpackb(datagram)
            if frame["channel"] == self._mark:
                return None
            can_id, data = frame["arbitration_id"], frame["data"]
            classical = not (frame["is_remote_frame"] or frame["is_error_frame"] or frame["is_fd"])
            limit = EXTENDED >> 2 if frame["is_extended_id"] else 0x800
            if classical and 0 <= can_id < limit and len(data) <= 8:
                return can_id | (EXTENDED if frame["is_extended_id"] else 0), bytes(data)
        except (ValueError, TypeError, KeyError):
            # Anybody can send anything to a UDP port.
            pass
        self.ignored += 1
        return None


class _SocketcanLink(_SocketLink):
    """SocketCAN: `struct can_frame` of linux/can.h in and out, virtual or real."""

    _FRAME = struct.Struct("=IB3x8s")
    _REMOTE_OR_ERROR = 0x6000_0000

    def __init__(self, name: str, channel: str) -> None:
        self._channel = channel
        super().__init__(name, _open_socketcan(name, channel))

    def send(self, can_id: int, data: bytes) -> None:
        try:
            self._socket.send(self._FRAME.pack(can_id, len(data), data))
        except OSError as error:
            raise LinkError(
                f"bus {self.name}: frame 0x{can_id:03X} cannot be sent on {self._channel}: {error.strerror}"
                + (
                    f"; try: sudo ip link set {self._channel} txqueuelen 1000"
                    if error.errno == errno.ENOBUFS
                    else ""
                )
            ) from error

    def _parse(self, datagram: bytes) -> tuple[int, bytes] | None:
        can_id, length, data = self._FRAME.unpack(datagram)
        if can_id & self._REMOTE_OR_ERROR:
            self.ignored += 1
            return None
        return can_id, data[:length]


def _open_udp(name: str, port: int) -> UdpMulticastBus:
    group = UdpMulticastBus.DEFAULT_GROUP_IPv4
    try:
        # A hop limit of 0 keeps the frames on this host.
        return UdpMulticastBus(group, port=port, hop_limit=0, fd=False)
    except can.CanInterfaceNotImplementedError as error:
        raise BadInput(f"bus {name}: {error}; type: pip install msgpack") from error
    except (can.CanError, OSError) as error:
        cause = error.__cause__ if isinstance(error.__cause__, OSError) else error
        if isinstance(cause, OSError) and cause.errno in (errno.ENODEV, errno.ENETUNREACH):
            raise BadInput(
                f"bus {name}: this machine has no route for multicast; "
                "type: sudo ip link set lo up && sudo ip route add 239.0.0.0/8 dev lo"
            ) from error
        if isinstance(cause, OSError) and cause.errno == errno.EADDRINUSE:
            raise BadInput(
                f"bus {name}: UDP port {port} is used by another program; take another udp:PORT"
            ) from error
        raise BadInput(f"bus {name}: UDP port {port} cannot be opened: {cause}") from error


def _open_socketcan(name: str, channel: str) -> SocketcanBus:
    try:
        bus = SocketcanBus(channel)
    except OSError as error:
        if error.errno in (errno.EAFNOSUPPORT, errno.EPROTONOSUPPORT):
            raise BadInput(
                f"bus {name}: this kernel has no SocketCAN loaded; type: sudo modprobe can-raw vcan "
                f"(where that is missing: sudo apt-get install linux-modules-extra-$(uname -r)), "
                "or use --can udp"
            ) from error
        if error.errno == errno.ENODEV:
            raise BadInput(
                f"bus {name}: there is no CAN link {channel}; type: {_raise_link(channel)}"
            ) from error
        raise BadInput(f"bus {name}: {channel} cannot be opened: {error.strerror}") from error
    # A socket bound to a link that is down says so only once, here.
    with socket.socket(fileno=os.dup(bus.fileno())) as sock:
        down = sock.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR)
    if down:
        bus.shutdown()
        raise BadInput(f"bus {name}: CAN link {channel} is down; type: sudo ip link set {channel} up")
    return bus


def _raise_link(channel: str) -> str:
    if channel.startswith("vcan"):
        return f"sudo ip link add {channel} type vcan && sudo ip link set {channel} up"
    return f"sudo ip link set {channel} up type can bitrate {BIT_RATE}"


_SO_RCVBUFFORCE = 33
_SO_MEMINFO = 55
_MEMINFO = struct.Struct("=9I")
_MEMINFO_DROPS = 8


def _raise_receive_buffer(sock: socket.socket) -> None:
    """Ask for a large receive buffer; without the right to force it, rmem_max is the limit."""
    try:
        sock.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, RECEIVE_BUFFER_BYTES)
    except PermissionError:
        sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER_BYTES)


def _drops(sock: socket.socket) -> int:
    """Return the kernel's drop counter of a socket (sk_drops, the one that SO_RXQ_OVFL reports).

    SO_MEMINFO (Linux 4.12) gives it at any time. SO_RXQ_OVFL gives it only along with the next frame that was
    not dropped, so the last losses would stay unseen, and python-can's `recv` fails on the second ancillary
    message.
    """
    memory = sock.getsockopt(socket.SOL_SOCKET, _SO_MEMINFO, _MEMINFO.size)
    return int(_MEMINFO.unpack(memory)[_MEMINFO_DROPS])
