"""What faults do to a vehicle itself: its actuators, its tyres, the road under it."""

from dataclasses import replace

from bench.faults.kinds import ActuatorStuck, IcePatch, TyreBlowout
from bench.faults.plan import FaultPlan
from bench.plant.actuators import Applied

_FIELDS = {"steering": "steering_angle"}
_AXLES = {"front": "lambda_f", "rear": "lambda_r"}


class VehicleFaults:
    """The faults of one vehicle."""

    def __init__(self, vehicle: int, plan: FaultPlan) -> None:
        """Take from `plan` what is done to vehicle number `vehicle`."""
        self._vehicle = vehicle
        self._plan = plan
        self._last = Applied()
        self._stuck: dict[int, float] = {}

    def on_actuators(self, cycle: int, meant: Applied) -> Applied:
        """Return what the actuators really apply of what they are to apply."""
        applied = meant
        for index, fault in self._plan.at(cycle):
            if isinstance(fault, ActuatorStuck) and fault.vehicle == self._vehicle:
                field = _FIELDS.get(fault.actuator, fault.actuator)
                before = getattr(self._last, field)
                stuck = self._stuck.setdefault(index, before if fault.value is None else fault.value)
                applied = replace(applied, **{field: stuck})
        self._last = applied
        return applied

    def on_road(self, cycle: int, acting: dict[str, float]) -> dict[str, float]:
        """Return the FMU's inputs by name, changed by what has happened to tyres and road."""
        changes: dict[str, float] = {}
        for _, fault in self._plan.at(cycle):
            if isinstance(fault, TyreBlowout) and fault.vehicle == self._vehicle:
                changes[_AXLES[fault.axle]] = fault.lambda_level
            elif isinstance(fault, IcePatch) and fault.vehicle in (None, self._vehicle):
                changes["mu"] = fault.mu
        return {**acting, **changes} if changes else acting
