"""Checks that the targets of faults exist: vehicles, messages, signals."""

from collections.abc import Mapping, Sequence
from functools import cache, cached_property

from bench.bus.codec import Codec, bus_names, load_codecs
from bench.bus.network import transmissions
from bench.faults.base import Fault, Problem
from bench.names import CONDUCTOR


class _Bench:
    """See `bench.faults.base.Bench`: the buses of a scenario according to their DBC files."""

    def __init__(self, vehicles: int) -> None:
        self.vehicles = vehicles
        self.buses = bus_names(vehicles)

    @cached_property
    def _codecs(self) -> dict[str, Codec]:
        return load_codecs(self.vehicles)

    def senders(self, bus: str) -> Mapping[str, str]:
        sent = transmissions(bus, self._codecs[bus])
        return {each.message: each.sender for each in sent if each.sender != CONDUCTOR}

    def signals(self, bus: str, message: str) -> Sequence[str]:
        return list(self._codecs[bus].start_values(message))

    def has_counter(self, bus: str, message: str) -> bool:
        return bool(self._codecs[bus].data_id(message))


@cache
def _bench(vehicles: int) -> _Bench:
    # The DBC files are read once, not for each of a scenario's faults.
    return _Bench(vehicles)


def target_problems(fault: Fault, vehicles: int) -> list[Problem]:
    """Return the problems with a fault's target in a scenario with this number of vehicles; empty if there are none."""
    return fault.problems(_bench(vehicles))
