"""Faults of nodes on their buses: babbling idiot, bus off, radio outage."""

from collections.abc import Sequence
from random import Random
from typing import Annotated, Literal

from pydantic import Field

from bench.faults.base import Bench, EcuName, Fault, NodeName, Problem, VehicleNumber, no_node, no_vehicle
from bench.names import V2V, vehicle_of


class BabblingIdiot(Fault):
    """A node continuously sends additional frames, which win arbitration against all of lower priority.

    Other frames share the remaining bus time in the order of their priority; frames that do not fit are lost.

    Attributes:
        node: the babbling node; the frames are sent on the bus of its vehicle.
        identifier: identifier of its frames; the lower, the higher their priority.
        frames_per_cycle: number of its frames per cycle.
    """

    kind: Literal["babbling_idiot"] = "babbling_idiot"
    node: EcuName
    identifier: Annotated[int, Field(ge=0x12, le=0x7FF)] = 0x80
    frames_per_cycle: Annotated[int, Field(ge=1, le=60)] = 40

    @property
    def bus(self) -> str:
        """The bus it babbles on."""
        return self.node.partition(".")[0]

    def problems(self, bench: Bench) -> list[Problem]:
        """See `Fault`."""
        return no_node("node", self.node, bench)

    def identifiers(self, node: str) -> tuple[tuple[str, int], ...]:
        """See `Fault`."""
        return ((self.bus, self.identifier),) if node == self.node else ()

    def payloads(self, dice: Random) -> list[bytes]:
        """See `Fault`."""
        return [dice.randbytes(8) for _ in range(self.frames_per_cycle)]

    def starved(self, bus: str, can_ids: Sequence[int], room: int) -> frozenset[int]:
        """See `Fault`; assumes that all messages of the bus are due in the cycle."""
        if bus != self.bus:
            return frozenset()
        before = [can_id for can_id in can_ids if can_id <= self.identifier]
        after = [can_id for can_id in can_ids if can_id > self.identifier]
        left = max(0, room - len(before) - self.frames_per_cycle)
        return frozenset([*before[room:], *after[left:]])


class BusOff(Fault):
    """A node's CAN controller is bus off on its vehicle's bus: it neither sends nor receives there.

    Attributes:
        node: the node: veh1.planner, veh1.tracker or veh1.plant.
    """

    kind: Literal["bus_off"] = "bus_off"
    node: NodeName

    def problems(self, bench: Bench) -> list[Problem]:
        """See `Fault`."""
        return no_node("node", self.node, bench)

    def cuts(self, node: str, bus: str) -> bool:
        """See `Fault`."""
        return node == self.node and bus != V2V


class V2VOutage(Fault):
    """The radio of one vehicle, or of all, is out.

    Attributes:
        vehicle: number of the vehicle, from 1; all if not given.
    """

    kind: Literal["v2v_outage"] = "v2v_outage"
    vehicle: VehicleNumber | None = None

    def problems(self, bench: Bench) -> list[Problem]:
        """See `Fault`."""
        return no_vehicle(self.vehicle, bench)

    def cuts(self, node: str, bus: str) -> bool:
        """See `Fault`."""
        return bus == V2V and self.vehicle in (None, vehicle_of(node))
