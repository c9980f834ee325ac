"""What faults do to a vehicle itself: its actuators, its tyres, the road under it."""

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import asdict, replace

from bench.faults.base import Memory
from bench.faults.plan import FaultPlan
from bench.plant.actuators import Applied


class VehicleFaults:
    """The faults of one vehicle."""

    def __init__(self, vehicle: int, plan: FaultPlan) -> None:
        """Take from `plan` what is done to vehicle number `vehicle`."""
        self._vehicle = vehicle
        self._plan = plan
        self._last = Applied()
        self._memories: defaultdict[int, Memory] = defaultdict(dict)

    def on_actuators(self, cycle: int, meant: Applied) -> Applied:
        """Return what the actuators really apply of what they are to apply."""
        changes: dict[str, float] = {}
        for index, fault in self._plan.at(cycle):
            changes |= fault.on_actuators(self._vehicle, asdict(self._last), self._memories[index])
        self._last = replace(meant, **changes)
        return self._last

    def on_inputs(self, cycle: int, acting: Mapping[str, float]) -> dict[str, float]:
        """Return the FMU's inputs by name, changed by what has happened to tyres and road."""
        changes: dict[str, float] = {}
        for _, fault in self._plan.at(cycle):
            changes |= fault.on_vehicle(self._vehicle)
        return {**acting, **changes}
