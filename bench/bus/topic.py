"""What goes over the buses between a node and the rest: topics, outgoing messages, bus health."""

from collections.abc import Mapping
from dataclasses import dataclass

Signals = Mapping[str, float]
"""The physical values of one message's signals by name, in the DBC's units."""

V2V = "v2v"
"""Name of the radio between the vehicles; vehicle i's own bus is `veh<i>`."""

PLANT = "plant"
"""Name of the process that all vehicles' FMUs run in."""


def vehicle_bus(vehicle: int) -> str:
    """Name of vehicle `vehicle`'s own bus (vehicles count from 1)."""
    return f"veh{vehicle}"


def vehicle_of(name: str) -> int | None:
    """Number of the vehicle whose bus or process `name` is (veh3, veh3.planner), None where it is no vehicle's."""
    number = name.partition(".")[0].removeprefix("veh")
    return int(number) if name.startswith("veh") and number.isdecimal() else None


@dataclass(frozen=True, slots=True)
class Topic:
    """One message on one bus, as something to listen to."""

    bus: str
    message: str

    @property
    def delay(self) -> int:
        """Age in cycles at which this topic takes part in a step.

        What comes by radio was sent in the cycle before: each planner's V2V message is the outcome of its own step,
        so planners that waited for each other's message of the same cycle would wait for ever.
        """
        return 1 if self.bus == V2V else 0


@dataclass(frozen=True, slots=True)
class Outgoing:
    """One message to be sent: which bus, which message, its signals' physical values in the DBC's units.

    A signal that `values` leaves out is sent with its start value.
    """

    bus: str
    message: str
    values: Signals
