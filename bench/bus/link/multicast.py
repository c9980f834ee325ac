"""A UDP multicast socket, set up as in python-can's udp_multicast, but with a choice of network device.

python-can joins its group on the device given by the routing table and accepts no other; hosts with several networks
need the choice. Without a device the socket is as python-can's.
"""

import errno
import struct
from socket import (
    AF_INET,
    INADDR_ANY,
    IP_ADD_MEMBERSHIP,
    IP_MULTICAST_IF,
    IP_MULTICAST_TTL,
    IPPROTO_IP,
    SO_REUSEADDR,
    SO_REUSEPORT,
    SOCK_DGRAM,
    SOL_SOCKET,
    if_nameindex,
    if_nametoindex,
    inet_aton,
    socket,
)

from bench.errors import BadInput

_MEMBERSHIP = struct.Struct("=4sIi")
"""struct ip_mreqn of Linux: group, local address, index of the network device."""

HERE, THIS_NETWORK = 0, 1
"""Hop limits: a datagram that stays on this host, one that stays on the networks this host is on."""


def require_device(device: str) -> int:
    """Return the index of a network device.

    Raises:
        BadInput: there is none of this name; the message lists the existing ones.
    """
    try:
        return if_nametoindex(device)
    except OSError:
        there = ", ".join(name for _, name in if_nameindex())
        raise BadInput(f"no network device {device}; this host has {there}") from None


class MulticastSocket:
    """One end of a group and port.

    Attributes:
        socket: the socket.
    """

    def __init__(self, bus: str, group: str, port: int, device: str = "") -> None:
        """Join `group` on `port` for the bus `bus`; with `device`, datagrams leave this host through it.

        Raises:
            BadInput: there is no such device, no route for multicast, or another program uses the port exclusively.
        """
        index = require_device(device) if device else 0
        self.socket = socket(AF_INET, SOCK_DGRAM)
        try:
            for option in (SO_REUSEADDR, SO_REUSEPORT):
                self.socket.setsockopt(SOL_SOCKET, option, 1)
            self.socket.setsockopt(IPPROTO_IP, IP_MULTICAST_TTL, THIS_NETWORK if device else HERE)
            self.socket.bind(("", port))
            membership = _MEMBERSHIP.pack(inet_aton(group), INADDR_ANY, index)
            if device:
                self.socket.setsockopt(IPPROTO_IP, IP_MULTICAST_IF, membership)
            self.socket.setsockopt(IPPROTO_IP, IP_ADD_MEMBERSHIP, membership)
            _check_route(group, port, device, index)
        except OSError as error:
            self.socket.close()
            raise BadInput(f"bus {bus}: {_explained(error, port, device)}") from error

    def fileno(self) -> int:
        """Return the socket's file descriptor."""
        return self.socket.fileno()

    def shutdown(self) -> None:
        """Leave the group."""
        self.socket.close()


def _check_route(group: str, port: int, device: str, index: int) -> None:
    """Check before the first frame that frames can be sent.

    Raises:
        OSError: they cannot.
    """
    with socket(AF_INET, SOCK_DGRAM) as probe:
        if device:
            probe.setsockopt(IPPROTO_IP, IP_MULTICAST_IF, _MEMBERSHIP.pack(inet_aton(group), INADDR_ANY, index))
        probe.connect((group, port))


def _explained(error: OSError, port: int, device: str) -> str:
    if error.errno in (errno.EADDRINUSE, errno.EACCES):
        return f"UDP port {port} is used by another program; take another port"
    if device:
        mend = f"sudo ip link set {device} up multicast on, and give it an IPv4 address"
        return f"no multicast on the network device {device} ({error.strerror}); type:\n  {mend}"
    mend = "sudo ip link set lo up && sudo ip route add 239.0.0.0/8 dev lo"
    return f"this machine has no route for multicast ({error.strerror}); type:\n  {mend}"
