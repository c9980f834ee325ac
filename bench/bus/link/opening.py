"""Opening a bus: from an address to a link."""

from bench.bus.codec import load_codecs
from bench.bus.link.address import Address, bus_number, settle
from bench.bus.link.base import Link, LinkError
from bench.bus.link.direct import DirectLink
from bench.bus.link.socketcan import SocketcanLink
from bench.bus.link.udp import UdpLink, reserve_udp_ports
from bench.errors import BadInput

__all__ = ["Address", "Link", "LinkError", "open_link", "reserve_udp_ports", "settle"]


def open_link(bus: str, address: Address) -> Link:
    """Open this process's end of a bus (`v2v` or `veh<i>`) at the address.

    Raises:
        BadInput: the bus does not exist or cannot be used; the message lists the commands that help.
    """
    if address.hub is not None:
        return DirectLink(bus, address.hub)
    place = address.place_of(bus)
    if place.is_udp:
        if place.port is None:
            raise BadInput(f"--can udp: give the port of the running bench's {bus} too, udp:PORT")
        return UdpLink(bus, place.port, place.device)
    if place.interface == "socketcan":
        return SocketcanLink(bus, place.channel)
    # Imported here: only other interfaces need python-can.
    from bench.bus.link.interface import open_interface

    return open_interface(bus, place, _bit_rate(bus))


def _bit_rate(bus: str) -> int:
    return load_codecs(max(1, bus_number(bus)))[bus].bit_rate
