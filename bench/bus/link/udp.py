"""The bus `udp`: python-can's udp_multicast, on this host or on a device's network. One UDP port is one bus.

Any python-can tool on this host can take part: `can_logger -i udp_multicast -c 239.74.163.2 --port PORT`.
"""

import errno
import os
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from socket import AF_INET, SO_REUSEADDR, SO_REUSEPORT, SOCK_DGRAM, SOCK_STREAM, SOL_SOCKET, socket
from typing import Any

from bench.bus.frame import CanFrame
from bench.bus.link.base import EXTENDED
from bench.bus.link.multicast import MulticastSocket
from bench.bus.link.sockets import SocketLink
from bench.errors import BadInput
from bench.events import Refusal

GROUP = "239.74.163.2"
"""python-can's default, which is not imported here: that takes longer than all else of a link."""

FIRST_PORT = 43113
"""Port of the v2v bus if it is free: python-can's default, so that its tools attach without a port."""

_LAST_PORT = 60999


# All frames of python-can begin with the same bytes up to the identifier, so comparing bytes rejects unselected ones.
_HEAD = slice(20, 38)
_ID_KEY = b"\xaearbitration_id"
_NEXT_KEY = b"\xaeis_extended_id"


def _head(can_id: int) -> bytes:
    """The bytes `_HEAD` of a frame: msgpack's key and value of the identifier, and the bytes after a short value."""
    if can_id < 0x80:
        value = can_id.to_bytes(1, "big")
    elif can_id < 0x100:
        value = b"\xcc" + can_id.to_bytes(1, "big")
    else:
        value = b"\xcd" + (can_id & 0xFFFF).to_bytes(2, "big")
    return (_ID_KEY + value + _NEXT_KEY)[: _HEAD.stop - _HEAD.start]


_AFTER_DATA = len(b"\xa5is_fd\xc2\xaebitrate_switch\xc2\xb5error_state_indicator\xc2")
_DATA_AT, _DATA_END = -_AFTER_DATA - 8, -_AFTER_DATA
"""Position of the data of a frame of 8 bytes: the last three keys of python-can's map come after it."""

_EIGHT_BYTES = b"\xc4\x08"
"""The bytes before 8 bytes of data: msgpack's bin 8."""

_OTHERS = {"is_error_frame": Refusal.ERROR, "is_remote_frame": Refusal.REMOTE, "is_fd": Refusal.FD}
"""What is not a classical data frame, by the key of python-can's map."""

_LEAST_BYTES = 100
_REMEMBERED = 1024
"""Maximum number of cached kinds of datagrams; a bus has a few dozen, but anybody can send anything."""


class UdpLink(SocketLink):
    """A msgpack map per frame, to all sockets of group and port on this host, or on a network device's network."""

    def __init__(self, name: str, port: int, device: str = "") -> None:
        """Join the bus `name` on UDP `port`, on the network device `device` if other hosts take part.

        Raises:
            BadInput: it cannot be opened; the message gives the reason and the remedy.
        """
        self._pack, self._unpack = _msgpack()
        super().__init__(name, MulticastSocket(name, GROUP, port, device), (GROUP, port))
        # Frames to a group come back to their sender; this mark in python-can's `channel` identifies them.
        self._mark = f"{name}/{os.urandom(8).hex()}"
        self._mark_bytes = self._mark.encode()
        self._selected: frozenset[bytes] | None = None
        self._around: dict[tuple[int, int], tuple[bytes, bytes]] = {}
        self._known: dict[bytes, int | None] = {}

    def _packed(self, can_id: int, data: bytes) -> bytes:
        """Return a message as packed by python-can's `pack_message`, which takes three times as long.

        Frames of one identifier and length differ only in their data, so everything else is packed once.
        """
        around = self._around.get((can_id, len(data)))
        if around is None:
            frame = {
                "timestamp": 0.0,
                "arbitration_id": can_id & ~EXTENDED,
                "is_extended_id": can_id >= EXTENDED,
                "is_remote_frame": False,
                "is_error_frame": False,
                "channel": self._mark,
                "dlc": len(data),
                "data": data,
                "is_fd": False,
                "bitrate_switch": False,
                "error_state_indicator": False,
            }
            packed = self._pack(frame)
            end = len(packed) - _AFTER_DATA
            around = packed[: end - len(data)], packed[end:]
            if len(self._around) < _REMEMBERED:
                self._around[can_id, len(data)] = around
        return around[0] + data + around[1]

    def select(self, can_ids: Collection[int]) -> None:
        """See `Link`.

        Not in the kernel, which counts a datagram rejected by a socket filter as lost.
        """
        self._selected = frozenset(_head(can_id) for can_id in can_ids)

    def _parse(self, datagram: bytes) -> CanFrame | None:
        if self._selected is not None:
            head = datagram[_HEAD]
            if head not in self._selected and head.startswith(_ID_KEY):
                return None
        # Frames of one kind differ only in their data: the other fields are unpacked once and cached.
        shape = datagram[:_DATA_AT] + datagram[_DATA_END:]
        if shape in self._known:
            can_id = self._known[shape]
            return None if can_id is None else CanFrame(can_id, datagram[_DATA_AT:_DATA_END])
        frame = self._unpacked(datagram)
        own = self._mark_bytes in datagram
        if len(self._known) < _REMEMBERED and len(datagram) > _LEAST_BYTES:
            if own and datagram[_DATA_AT - 2 : _DATA_AT] == _EIGHT_BYTES:
                self._known[shape] = None
            elif frame is not None and frame.data == datagram[_DATA_AT:_DATA_END]:
                self._known[shape] = frame.can_id
        return None if own else frame

    def _unpacked(self, datagram: bytes) -> CanFrame | None:
        try:
            frame = self._unpack(datagram)
            can_id, data = frame["arbitration_id"], frame["data"]
            extended = EXTENDED if frame["is_extended_id"] else 0
            why = next((why for key, why in _OTHERS.items() if frame[key]), None)
            if not 0 <= can_id < (1 << 29 if extended else 1 << 11):
                raise ValueError("no identifier")
            can_id |= extended
            if why is None and len(data) <= 8:
                return CanFrame(can_id, bytes(data))
        except (ValueError, TypeError, KeyError):
            # Anybody can send anything to a UDP port.
            self._ignore(Refusal.MALFORMED)
            return None
        self._ignore(why or Refusal.MALFORMED, None if why is Refusal.ERROR else can_id)
        return None


def _msgpack() -> tuple[Callable[[Any], bytes], Callable[[bytes], Any]]:
    """Return msgpack's functions that pack and unpack."""
    try:
        from msgpack import Packer, unpackb
    except ImportError as error:
        raise BadInput("udp needs the package msgpack; type: pip install msgpack") from error
    return Packer().pack, unpackb


@contextmanager
def reserve_udp_ports(count: int, first: int | None = None) -> Iterator[range]:
    """Reserve `count` consecutive UDP ports for one bench; without `first`, the lowest free ones.

    Ports of udp_multicast are shared by design, so they do not show that a bench uses them. The lock of UDP port p is
    therefore TCP port p of the loopback address, bound until the context ends; the kernel frees it when the process
    ends, however it does.

    Raises:
        BadInput: a port is reserved by another bench, used by another program (with `first`: used exclusively), or
            there are no free ones.
    """
    if first is not None:
        with hold_udp_ports(range(first, first + count)):
            yield range(first, first + count)
        return
    for start in range(FIRST_PORT, _LAST_PORT - count, count):
        ports = range(start, start + count)
        locks = _lock(ports, shared=False)
        if locks is not None:
            with locks:
                yield ports
            return
    raise BadInput(f"no {count} consecutive free UDP ports from {FIRST_PORT} to {_LAST_PORT}")


@contextmanager
def hold_udp_ports(ports: Sequence[int]) -> Iterator[None]:
    """Reserve these UDP ports for one bench; see `reserve_udp_ports`.

    Raises:
        BadInput: a port is reserved by another bench, or used exclusively by a program.
    """
    # A user who gives the ports may already have ECUs or tools listening there.
    locks = _lock(ports, shared=True)
    if locks is None:
        named = f"{ports[0]} to {ports[-1]}" if isinstance(ports, range) else ", ".join(map(str, ports))
        raise BadInput(
            f"udp:{ports[0]}: not all of the UDP ports {named} are free, another bench or program uses one; take "
            "others, or udp without a port"
        )
    with locks:
        yield


def _lock(ports: Iterable[int], shared: bool) -> ExitStack | None:
    """Return the locks of all `ports`, or None if one of them is not free."""
    with ExitStack() as stack:
        for port in ports:
            lock = stack.enter_context(socket(AF_INET, SOCK_STREAM))
            if not (_binds(lock, "127.0.0.1", port) and _is_free(port, shared)):
                return None
        return stack.pop_all()


def _is_free(port: int, shared: bool) -> bool:
    """Return whether no program has a UDP socket on this port or, for `shared`, none with exclusive use."""
    with socket(AF_INET, SOCK_DGRAM) as probe:
        if shared:
            probe.setsockopt(SOL_SOCKET, SO_REUSEADDR, 1)
            probe.setsockopt(SOL_SOCKET, SO_REUSEPORT, 1)
        return _binds(probe, "", port)


def _binds(sock: socket, host: str, port: int) -> bool:
    try:
        sock.bind((host, port))
    except OSError as error:
        if error.errno in (errno.EADDRINUSE, errno.EACCES):
            return False
        raise
    return True
