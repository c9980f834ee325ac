"""The network of a bench: its processes, which DBC nodes they are, and which messages each sends and receives.

All of it is read from the DBC files' nodes, senders, receivers and cycle times. On a vehicle's bus the nodes are
Conductor, Plant and one for each ECU; on v2v, Vehicle<i> is the planner of vehicle i, the only ECU with a radio.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

from bench.bus.codec import Codec
from bench.bus.topic import Topic
from bench.names import CONDUCTOR, PLANT, V2V, vehicle_bus, vehicle_of

ROLES = ("planner", "tracker")
"""The ECUs of a vehicle."""

_RADIO_ROLE = "planner"
_RADIO_NODE = "Vehicle"
_OTHER_NODES = {"Conductor": CONDUCTOR, "Plant": PLANT}


@dataclass(frozen=True, slots=True)
class EcuSlot:
    """An ECU slot of the network.

    Attributes:
        role: one of `ROLES`.
        vehicle: number of its vehicle, from 1.
    """

    role: str
    vehicle: int

    @property
    def name(self) -> str:
        """Name of the process, e.g. `veh2.tracker`."""
        return f"{vehicle_bus(self.vehicle)}.{self.role}"

    @property
    def buses(self) -> tuple[str, ...]:
        """Its buses: its vehicle's, and for the planner also v2v."""
        own = vehicle_bus(self.vehicle)
        return (own, V2V) if self.role == _RADIO_ROLE else (own,)

    def message(self, kind: str) -> str:
        """Return the name of a diagnostic message that every role has on its vehicle's bus: `TrackerStatus`."""
        return f"{self.role.capitalize()}{kind}"

    def sends(self, codecs: Mapping[str, Codec]) -> list[Topic]:
        """Return the topics that it sends by the DBC files; `codecs` has the codecs of its buses."""
        return [
            each.topic for bus in self.buses for each in transmissions(bus, codecs[bus]) if each.sender == self.name
        ]

    def receives(self, codecs: Mapping[str, Codec], vehicles: int) -> list[Topic]:
        """Return the topics that it receives by the DBC files in a bench of `vehicles`; `codecs` as in `sends`."""
        return [
            each.topic
            for bus in self.buses
            for each in transmissions(bus, codecs[bus], vehicles)
            if self.name in each.receivers
        ]


@dataclass(frozen=True, slots=True)
class Transmission:
    """A message on a bus, with its sender and receivers.

    Attributes:
        bus: name of the bus.
        can_id: its identifier.
        message: its name.
        sender: name of the process that sends it; empty if the DBC names none.
        receivers: names of the processes that receive at least one of its signals.
        length: number of its bytes.
        protected: whether it carries an alive counter.
        period: its cycle time in cycles of the bench; 0 if it has none.
    """

    bus: str
    can_id: int
    message: str
    sender: str
    receivers: frozenset[str]
    length: int
    protected: bool
    period: int

    @property
    def topic(self) -> Topic:
        """The topic of the message."""
        return Topic(self.bus, self.message)

    @property
    def station(self) -> str:
        """The sender as a node of the bus: the plant is a separate node on each bus, e.g. veh1.plant."""
        return f"{self.bus}.{PLANT}" if self.sender == PLANT else self.sender

    @property
    def has_deadline(self) -> bool:
        """Whether it is sent in every cycle in response to BenchSync, on a vehicle's bus."""
        return self.protected and self.period == 1 and self.bus != V2V and self.sender not in ("", CONDUCTOR)


def process_of(bus: str, node: str) -> str:
    """Return the name of the process that implements the DBC's `node` on `bus`: plant, veh1.planner, conductor."""
    if bus == V2V and node.startswith(_RADIO_NODE):
        return f"veh{node.removeprefix(_RADIO_NODE)}.{_RADIO_ROLE}"
    return _OTHER_NODES.get(node) or f"{bus}.{node.lower()}"


# Each node of a run asks for them, several times.
@lru_cache(maxsize=64)
def transmissions(bus: str, codec: Codec, vehicles: int | None = None) -> tuple[Transmission, ...]:
    """Return the messages of `bus`, sorted by identifier.

    With `vehicles`, v2v has only the messages and receivers of that many vehicles; otherwise all that the DBC names.
    """
    found = []
    for name in codec.names:
        message, can_id = codec.described(name), codec.can_id(name)
        sender = process_of(bus, message.senders[0]) if message.senders else ""
        if not _is_there(sender, vehicles):
            continue
        receivers = (process_of(bus, node) for node in message.receivers)
        found.append(
            Transmission(
                bus=bus,
                can_id=can_id,
                message=name,
                sender=sender,
                receivers=frozenset(process for process in receivers if _is_there(process, vehicles)),
                length=message.length,
                protected=codec.is_protected(can_id),
                period=codec.period(name) if message.cycle_time_ms else 0,
            )
        )
    return tuple(found)


def _is_there(process: str, vehicles: int | None) -> bool:
    return vehicles is None or (vehicle_of(process) or 0) <= vehicles
