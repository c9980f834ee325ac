"""Where the buses of a bench are: any python-can interface, written as on the command line.

udp               python-can's udp_multicast on this host, on ports that no other bench uses
udp:PORT          the same on fixed ports: v2v on PORT, veh1 on PORT + 1, ...
vcan              SocketCAN: v2v on vcan0, veh1 on vcan1, ...
direct            inside one process
IFACE:CHANNEL     any other python-can interface; {} in CHANNEL is the number of the bus, v2v 0, veh1 1,
...:
                  socketcan:can{}, pcan:PCAN_USBBUS{}
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

from can.interfaces import VALID_INTERFACES

from bench.bus.codec import MAX_VEHICLES, bus_names
from bench.bus.direct import Hub
from bench.bus.socketcan import require_links
from bench.bus.udp import reserve_udp_ports
from bench.errors import BadInput

_ALLOWED = "allowed: udp, udp:PORT, vcan, direct, IFACE:CHANNEL (any python-can interface, e.g. socketcan:can{})"
_LAST_PORT = 65535 - MAX_VEHICLES


@dataclass(frozen=True, slots=True)
class Address:
    """Where the buses of one bench are.

    Attributes:
        interface: python-can's name of the interface (udp_multicast, socketcan, pcan, ...), or `direct`.
        channel: the channel of a bus, where {} stands for the number of the bus; not for udp_multicast.
        port: UDP port of the v2v bus, for udp_multicast; None as long as none is reserved.
        hub: the buses themselves, for `direct`; every `parse` makes new ones.
    """

    interface: str
    channel: str = ""
    port: int | None = None
    hub: Hub | None = None

    @classmethod
    def parse(cls, text: str) -> "Address":
        """Read an address as it is typed after `--can`.

        Raises:
            BadInput: not one of the forms above.
        """
        if text == "udp":
            return cls("udp_multicast")
        if text == "vcan":
            return cls("socketcan", "vcan{}")
        if text == "direct":
            return cls("direct", hub=Hub())
        interface, _, channel = text.partition(":")
        if not (interface and channel):
            raise BadInput(f"--can {text}: not a bus; {_ALLOWED}")
        if interface != "udp":
            # python-can's own name for `udp` has a group as its channel, and the bench needs ports.
            if interface == "udp_multicast" or interface not in VALID_INTERFACES:
                raise BadInput(f"--can {text}: no such interface; {_ALLOWED}")
            return cls(interface, channel)
        if not (channel.isdecimal() and 1024 <= int(channel) <= _LAST_PORT):
            raise BadInput(f"--can {text}: PORT must be a whole number from 1024 to {_LAST_PORT}")
        return cls("udp_multicast", port=int(channel))

    def __str__(self) -> str:
        """Return the text that `parse` reads."""
        if self.interface == "udp_multicast":
            return "udp" if self.port is None else f"udp:{self.port}"
        if self.hub is not None:
            return "direct"
        return "vcan" if self == Address("socketcan", "vcan{}") else f"{self.interface}:{self.channel}"

    def channel_of(self, bus: str) -> str:
        """Return the channel of a bus, e.g. vcan1 for veh1.

        Raises:
            BadInput: there is no such bus.
        """
        return self.channel.replace("{}", str(bus_number(bus)))

    def port_of(self, bus: str) -> int:
        """Return the UDP port of a bus.

        Raises:
            BadInput: there is no such bus, or no port is given: the bench reserves one with `settle`.
        """
        if self.port is None:
            raise BadInput("--can udp: give the port of the running bench's v2v bus too, udp:PORT")
        return self.port + bus_number(bus)


def bus_number(bus: str) -> int:
    """Return the number of a bus: 0 for v2v, i for veh<i>.

    Raises:
        BadInput: there is no such bus.
    """
    try:
        return bus_names(MAX_VEHICLES).index(bus)
    except ValueError:
        raise BadInput(f"bus {bus!r} does not exist; buses are v2v and veh1 to veh{MAX_VEHICLES}") from None


@contextmanager
def settle(address: Address, vehicles: int) -> Iterator[Address]:
    """Give the address as the processes of one bench of `vehicles` vehicles use it, while the context lasts.

    UDP ports are reserved, the kernel's CAN links checked.

    Raises:
        BadInput: a UDP port is in use, a CAN link missing, or one channel given for all buses.
    """
    buses = bus_names(vehicles)
    if address.interface == "udp_multicast":
        with reserve_udp_ports(len(buses), first=address.port) as ports:
            yield replace(address, port=ports[0])
        return
    if address.hub is None and "{}" not in address.channel:
        raise BadInput(
            f"--can {address}: one channel for {len(buses)} buses; write {{}} for the number of the bus "
            "(v2v 0, veh1 1, ...), as in socketcan:can{}"
        )
    if address.interface == "socketcan":
        require_links(address.channel_of(bus) for bus in buses)
    yield address
