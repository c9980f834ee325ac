"""Where the buses of a bench are: any python-can interface, written as on the command line.

udp               python-can's udp_multicast on this host, on ports that no other bench uses
udp:PORT          the same on fixed ports: v2v on PORT, veh1 on PORT + 1, ...
vcan              SocketCAN: v2v on vcan0, veh1 on vcan1, ...
direct            python-can's virtual, inside one process
IFACE:CHANNEL     any other python-can interface; {} in CHANNEL is the number of the bus, v2v 0, veh1 1, ...:
                  socketcan:can{}, pcan:PCAN_USBBUS{}
"""

import errno
import socket
import uuid
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace

from bench.errors import BadInput

FIRST_UDP_PORT = 43113
"""Port of the v2v bus where it is free: python-can's default, so that its tools attach with no port given."""

_LAST_UDP_PORT = 60999
_ALLOWED = (
    "allowed: udp, udp:PORT, vcan, direct, IFACE:CHANNEL (any python-can interface, e.g. socketcan:can{})"
)


@dataclass(frozen=True, slots=True)
class Address:
    """Where the buses of one bench are.

    Attributes:
        interface: python-can's name of the interface: udp_multicast, socketcan, virtual, pcan, ...
        channel: the channel of a bus, where {} stands for the number of the bus; not used by udp_multicast.
        port: UDP port of the v2v bus; None as long as none is reserved or for other interfaces.
    """

    interface: str
    channel: str = ""
    port: int | None = None

    @classmethod
    def parse(cls, text: str) -> "Address":
        """Read an address as it is typed after `--can`.

        Raises:
            BadInput: not one of the forms above.
        """
        if text == "vcan":
            return cls("socketcan", "vcan{}")
        if text == "direct":
            return cls("virtual", f"{uuid.uuid4().hex}/{{}}")
        interface, _, channel = text.partition(":")
        if interface == "udp":
            return cls("udp_multicast", port=_port(text, channel) if text != "udp" else None)
        if not (interface and channel):
            raise BadInput(f"--can {text}: not a bus; {_ALLOWED}")
        return cls(interface, channel)

    @property
    def in_one_process(self) -> bool:
        """Whether only one process can take part."""
        return self.interface == "virtual"

    def channel_of(self, bus: str) -> str:
        """Return the channel of a bus: `vcan1` for veh1."""
        return self.channel.replace("{}", str(bus_number(bus)))

    def port_of(self, bus: str) -> int:
        """Return the UDP port of a bus.

        Raises:
            BadInput: no port is given; see `settle`.
        """
        if self.port is None:
            raise BadInput("--can udp: give the port of the v2v bus that the bench printed, udp:PORT")
        return self.port + bus_number(bus)

    def __str__(self) -> str:
        """Return the text that `parse` reads."""
        if self.interface == "udp_multicast":
            return "udp" if self.port is None else f"udp:{self.port}"
        if self.interface == "virtual":
            return "direct"
        return "vcan" if self == Address.parse("vcan") else f"{self.interface}:{self.channel}"


def bus_number(bus: str) -> int:
    """Return the number of a bus: 0 for v2v, i for veh<i>.

    Raises:
        BadInput: no such bus.
    """
    if bus == "v2v":
        return 0
    if bus.startswith("veh") and bus[3:].isdecimal() and int(bus[3:]) > 0:
        return int(bus[3:])
    raise BadInput(f"bus {bus!r} does not exist; buses are v2v, veh1, veh2, ...")


@contextmanager
def settle(address: Address, vehicles: int) -> Iterator[Address]:
    """Give the address of a bench's own, which holds for its processes while the context lasts.

    UDP ports are reserved; all other addresses stay as they are.

    Raises:
        BadInput: a UDP port is in use, or one channel is given for all buses.
    """
    buses = vehicles + 1
    if address.interface == "udp_multicast":
        with reserve_udp_ports(buses, first=address.port) as ports:
            yield replace(address, port=ports[0])
        return
    if "{}" not in address.channel:
        raise BadInput(
            f"--can {address}: one channel for {buses} buses; write {{}} for the number of the bus "
            f"(v2v 0, veh1 1, ...), as in socketcan:can{{}}"
        )
    yield address


@contextmanager
def reserve_udp_ports(count: int, first: int | None = None) -> Iterator[range]:
    """Hold `count` UDP ports in a row for one bench; without `first`, the lowest that are free.

    Ports of udp_multicast are shared by design, so they cannot show that a bench uses them. The lock of UDP
    port p is therefore TCP port p of the loopback address, bound while the context lasts; the kernel frees it
    with the process, however that ends.

    Raises:
        BadInput: a port is held by another bench or used by another program, or no free ones are left.
    """
    if first is not None:
        locks = _lock(range(first, first + count))
        if locks is None:
            raise BadInput(
                f"--can udp:{first}: UDP ports {first} to {first + count - 1} are not all free; "
                "another bench or program uses one; take other ports, or just --can udp"
            )
        with locks:
            yield range(first, first + count)
        return
    for start in range(FIRST_UDP_PORT, _LAST_UDP_PORT - count, count):
        ports = range(start, start + count)
        locks = _lock(ports)
        if locks is not None:
            with locks:
                yield ports
            return
    raise BadInput(f"no {count} free UDP ports in a row from {FIRST_UDP_PORT} to {_LAST_UDP_PORT}")


def _lock(ports: range) -> ExitStack | None:
    """Return the locks of all `ports`, or None where one of them is not free."""
    with ExitStack() as stack:
        for port in ports:
            lock = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_STREAM))
            if not (_binds(lock, "127.0.0.1", port) and _is_free(port)):
                return None
        return stack.pop_all()


def _is_free(port: int) -> bool:
    """Return whether no program, of this bench's kind or any other, has a UDP socket on this port."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        return _binds(probe, "", port)


def _binds(sock: socket.socket, host: str, port: int) -> bool:
    try:
        sock.bind((host, port))
    except OSError as error:
        if error.errno in (errno.EADDRINUSE, errno.EACCES):
            return False
        raise
    return True


def _port(text: str, digits: str) -> int:
    if not digits.isdecimal() or not 1024 <= int(digits) <= 65535 - 16:
        raise BadInput(f"--can {text}: PORT must be a whole number from 1024 to {65535 - 16}")
    return int(digits)
