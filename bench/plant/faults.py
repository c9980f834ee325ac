"""The effects of faults on a vehicle: its actuators, its tyres, its road."""

from collections import defaultdict
from collections.abc import Collection, Mapping

from bench.errors import RunFailed
from bench.faults.base import Memory
from bench.faults.plan import FaultPlan
from bench.plant.actuators import Applied


class VehicleFaults:
    """The faults of one vehicle."""

    def __init__(self, vehicle: int, plan: FaultPlan, inputs: Collection[str]) -> None:
        """Select the faults of vehicle number `vehicle`, whose FMU has these `inputs`, from `plan`."""
        self._vehicle = vehicle
        self._inputs = inputs
        self._plan = plan
        self._last = Applied()
        self._memories: defaultdict[int, Memory] = defaultdict(dict)

    def on_actuators(self, cycle: int, meant: Applied) -> Applied:
        """Return what the actuators actually apply."""
        changes: dict[str, float] = {}
        for index, fault in self._plan.at(cycle):
            changes |= fault.on_actuators(self._vehicle, self._last._asdict(), self._memories[index])
        self._last = meant._replace(**changes) if changes else meant
        return self._last

    def on_inputs(self, cycle: int, acting: Mapping[str, float]) -> Mapping[str, float]:
        """Return the FMU's inputs by name, modified by faults of tyres and road.

        Raises:
            RunFailed: the FMU lacks an input that a fault sets, so the fault would have no effect.
        """
        changes: dict[str, float] = {}
        for _, fault in self._plan.at(cycle):
            changes |= fault.on_vehicle(self._vehicle)
        for name in changes:
            if name not in self._inputs:
                raise RunFailed(
                    f"the vehicle's FMU has no input {name}, which a fault sets; build it: platoon fmu build"
                )
        return {**acting, **changes} if changes else acting
