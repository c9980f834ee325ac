"""Whether what a fault is done to exists: vehicles, messages, signals."""

from collections.abc import Mapping, Sequence
from functools import cached_property

from bench.bus.codec import Codec, bus_names, load_codecs
from bench.faults.base import Fault, Problem


class _Bench:
    """See `bench.faults.base.Bench`: what the DBC files say of a scenario's buses."""

    def __init__(self, vehicles: int) -> None:
        self.vehicles = vehicles
        self.buses = bus_names(vehicles)

    @cached_property
    def _codecs(self) -> dict[str, Codec]:
        return load_codecs(self.vehicles)

    def senders(self, bus: str) -> Mapping[str, str]:
        codec = self._codecs[bus]
        senders = {name: codec.message(name).senders[0] for name in codec.names}
        return {name: sender for name, sender in senders.items() if sender != "Conductor"}

    def signals(self, bus: str, message: str) -> Sequence[str]:
        return list(self._codecs[bus].start_values(message))

    def has_counter(self, bus: str, message: str) -> bool:
        return bool(self._codecs[bus].data_id(message))


def target_problems(fault: Fault, vehicles: int) -> list[Problem]:
    """Return what is wrong with the target of a fault in a scenario of this many vehicles; empty where all is well."""
    return fault.problems(_Bench(vehicles))
