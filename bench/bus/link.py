"""Opening a bus: from an address to a link."""

from bench.bus.address import Address, settle
from bench.bus.base import Link, LinkError
from bench.bus.direct import DirectLink
from bench.bus.interface import open_interface
from bench.bus.socketcan import SocketcanLink
from bench.bus.udp import UdpLink, reserve_udp_ports

__all__ = ["Address", "Link", "LinkError", "open_link", "reserve_udp_ports", "settle"]


def open_link(bus: str, address: Address) -> Link:
    """Open this process's end of a bus (`v2v` or `veh<i>`) at the address.

    Raises:
        BadInput: the bus is not there or cannot be used; the message says what to type.
    """
    if address.hub is not None:
        return DirectLink(bus, address.hub)
    if address.interface == "udp_multicast":
        return UdpLink(bus, address.port_of(bus))
    if address.interface == "socketcan":
        return SocketcanLink(bus, address.channel_of(bus))
    return open_interface(bus, address.interface, address.channel_of(bus))
