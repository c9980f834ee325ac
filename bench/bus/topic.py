"""What goes over the buses between a node and the rest: topics, outgoing messages, bus health."""

from collections.abc import Mapping
from dataclasses import dataclass

from bench.names import V2V, vehicle_bus, vehicle_of

__all__ = ["V2V", "Outgoing", "Signals", "Topic", "vehicle_bus", "vehicle_of"]

Signals = Mapping[str, float]
"""The physical values of one message's signals by name, in the DBC's units."""


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
