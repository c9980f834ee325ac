"""The addresses of a bench's buses, written as on the command line.

PLACE        the place of all buses; with udp:PORT v2v is on PORT, veh1 on PORT + 1, ...; {} in a channel is the
             number of the bus: v2v 0, veh1 1, ...
BUS=PLACE    the place of one bus, here udp:PORT with its own port

A place is written as in `bench.bus.link.place`. Buses without a place are on `udp`.
"""

from collections.abc import Collection, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace

from bench.bus.codec import MAX_VEHICLES, bus_names
from bench.bus.link.direct import Hub
from bench.bus.link.kernel_links import require_links
from bench.bus.link.multicast import require_device
from bench.bus.link.place import FIRST_USER_PORT, LAST_PORT, Place
from bench.bus.link.udp import hold_udp_ports, reserve_udp_ports
from bench.errors import BadInput


@dataclass(frozen=True, slots=True)
class Address:
    """The places of one bench's buses.

    Attributes:
        everywhere: place of the buses that are not in `own`; a UDP port is v2v's, the others' follow.
        own: places of single buses, in the order of the buses.
        hub: the buses themselves, for `direct`; every `parse` creates new ones.
    """

    everywhere: Place
    own: tuple[tuple[str, Place], ...] = ()
    hub: Hub | None = None

    @classmethod
    def parse(cls, *texts: str) -> "Address":
        """Parse the values of `--can`.

        Raises:
            BadInput: unknown form, a bus that does not exist, or two places for one bus.
        """
        everywhere: Place | None = None
        own: dict[str, Place] = {}
        for text in texts:
            bus, mark, place = text.partition("=")
            try:
                if mark and bus.isalnum():
                    bus_number(bus)
                    _refuse_second(text, bus, own.get(bus))
                    own[bus] = Place.parse(place, text)
                else:
                    _refuse_second(text, "every bus", everywhere)
                    everywhere = _everywhere(text)
            except BadInput as error:
                raise BadInput(f"--can {error}") from None
        everywhere = everywhere or Place("udp_multicast")
        is_direct = everywhere.interface == "direct"
        if own and (is_direct or any(place.interface == "direct" for place in own.values())):
            raise BadInput(f"--can {' --can '.join(texts)}: direct puts all buses in one process; give it alone")
        ordered = tuple(sorted(own.items(), key=lambda item: bus_number(item[0])))
        return cls(everywhere, ordered, Hub() if is_direct else None)

    def __str__(self) -> str:
        """Return the texts that `parse` reads, separated by blanks."""
        return " ".join([str(self.everywhere), *(f"{bus}={place}" for bus, place in self.own)])

    def place_of(self, bus: str) -> Place:
        """Return the place of a bus with its number inserted: vcan1 for veh1.

        Raises:
            BadInput: there is no such bus.
        """
        number = bus_number(bus)
        place = dict(self.own).get(bus)
        if place is not None:
            return place.of_number(number)
        port = self.everywhere.port
        return replace(self.everywhere.of_number(number), port=None if port is None else port + number)

    def is_known(self, bus: str) -> bool:
        """Whether other processes can find the bus: not if its port is not chosen yet, nor inside one process."""
        place = self.place_of(bus)
        return self.hub is None and not (place.is_udp and place.port is None)


def _refuse_second(text: str, what: str, first: Place | None) -> None:
    if first is not None:
        raise BadInput(f"{text}: {what} already has {first}; give one PLACE for all buses, and BUS=PLACE once per bus")


def _everywhere(text: str) -> Place:
    place = Place.parse(text)
    if place.port is not None and place.port > LAST_PORT - MAX_VEHICLES:
        raise BadInput(f"{text}: PORT must be a whole number from {FIRST_USER_PORT} to {LAST_PORT - MAX_VEHICLES}")
    return place


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
    """Yield the address as the processes of one bench of `vehicles` vehicles use it.

    UDP ports are reserved until the context ends; the kernel's CAN links and network devices are checked.

    Raises:
        BadInput: a UDP port is in use, a link or device missing, a bus not in the bench, or two buses in one place.
    """
    buses = bus_names(vehicles)
    _check_buses(address, buses)
    if address.hub is not None:
        yield address
        return
    places = {bus: address.place_of(bus) for bus in buses}
    kernel_links = [place.channel for place in places.values() if place.interface == "socketcan"]
    if kernel_links:
        require_links(kernel_links)
    for device in {place.device for place in places.values() if place.device}:
        require_device(device)
    with ExitStack() as stack:
        stack.enter_context(hold_udp_ports([place.port for place in places.values() if place.port is not None]))
        if any(place.is_udp and place.port is None for place in places.values()):
            address = _with_ports(address, stack.enter_context(reserve_udp_ports(len(buses))).start)
        yield address


def _with_ports(address: Address, first: int) -> Address:
    """Return the address with ports, counted from `first`, for the UDP buses without one."""

    def settled(place: Place, port: int) -> Place:
        return replace(place, port=port) if place.is_udp and place.port is None else place

    own = tuple((bus, settled(place, first + bus_number(bus))) for bus, place in address.own)
    return replace(address, everywhere=settled(address.everywhere, first), own=own)


def _check_buses(address: Address, buses: Collection[str]) -> None:
    """Check the places of the buses.

    Raises:
        BadInput: a place is given for a bus that is not in the bench, or two buses are in one place.
    """
    strangers = [bus for bus, _ in address.own if bus not in buses]
    if strangers:
        raise BadInput(f"--can {strangers[0]}=...: the scenario has the buses {', '.join(buses)}")
    if address.hub is not None:
        return
    shared = [bus for bus in buses if bus not in dict(address.own)]
    if len(shared) > 1 and not (address.everywhere.is_udp or address.everywhere.numbered):
        raise BadInput(
            f"--can {address.everywhere}: one channel for {len(shared)} buses; write {{}} for the number of the bus "
            "(v2v 0, veh1 1, ...), as in socketcan:can{}, or give each bus its own: --can BUS=..."
        )
    seen: dict[Place, str] = {}
    for bus in buses:
        place = address.place_of(bus)
        key = replace(place, device="", options=())
        if key in seen and not (place.is_udp and place.port is None):
            raise BadInput(f"--can: {seen[key]} and {bus} are both on {place}; each bus needs a separate place")
        seen[key] = bus
