"""Faults of a vehicle itself: its actuators, its tyres, the road under it."""

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field, model_validator

from bench.control.settings import ADHESION_MAX, ADHESION_MIN
from bench.faults.base import Bench, Fault, Memory, Problem, VehicleNumber, no_vehicle
from platoon_fmu.parameters import LAMBDA_MAX, LAMBDA_MIN


class ActuatorStuck(Fault):
    """An actuator is stuck at its present value or at `value` (rad, N m), regardless of commands.

    Attributes:
        vehicle: number of the vehicle, from 1.
        actuator: the front wheels' steering, or the torque on one wheel.
        value: steering angle in rad or torque in N m; the present one if not given.
    """

    kind: Literal["actuator_stuck"] = "actuator_stuck"
    vehicle: VehicleNumber
    actuator: Literal["steering", "torque_fl", "torque_rl", "torque_rr", "torque_fr"]
    value: float | None = None

    def problems(self, bench: Bench) -> list[Problem]:
        """See `Fault`."""
        return no_vehicle(self.vehicle, bench)

    def on_actuators(self, vehicle: int, before: Mapping[str, float], memory: Memory) -> dict[str, float]:
        """See `Fault`."""
        if vehicle != self.vehicle:
            return {}
        applied = "steering_angle" if self.actuator == "steering" else self.actuator
        return {applied: memory.setdefault("value", before[applied] if self.value is None else self.value)}


class TyreBlowout(Fault):
    """A tyre suddenly loses its pressure: the wheel loses most grip and load, and drags (`inflation` 0 is flat).

    Attributes:
        vehicle: number of the vehicle, from 1.
        wheel: front or rear, left or right.
        inflation: remaining fraction of its pressure.
    """

    kind: Literal["tyre_blowout"] = "tyre_blowout"
    vehicle: VehicleNumber
    wheel: Literal["fl", "rl", "rr", "fr"]
    inflation: Annotated[float, Field(ge=0, lt=1)] = 0.0

    @model_validator(mode="before")
    @classmethod
    def _refuse_former_keys(cls, table: Any) -> Any:
        if isinstance(table, dict) and "axle" in table:
            raise ValueError('kind = "tyre_blowout" with an axle is now called "axle_softening", with the same keys')
        return table

    def problems(self, bench: Bench) -> list[Problem]:
        """See `Fault`."""
        return no_vehicle(self.vehicle, bench)

    def on_vehicle(self, vehicle: int) -> dict[str, float]:
        """See `Fault`."""
        return {f"inflation_{self.wheel}": self.inflation} if vehicle == self.vehicle else {}


class AxleSoftening(Fault):
    """The cornering stiffness of an axle changes to C (1 + 0.4 `lambda_level`).

    Attributes:
        vehicle: number of the vehicle, from 1.
        axle: the axle.
        lambda_level: new value of lambda.
    """

    kind: Literal["axle_softening"] = "axle_softening"
    vehicle: VehicleNumber
    axle: Literal["front", "rear"]
    lambda_level: Annotated[float, Field(ge=LAMBDA_MIN, le=LAMBDA_MAX)] = LAMBDA_MIN

    def problems(self, bench: Bench) -> list[Problem]:
        """See `Fault`."""
        return no_vehicle(self.vehicle, bench)

    def on_vehicle(self, vehicle: int) -> dict[str, float]:
        """See `Fault`."""
        lambda_axle = {"front": "lambda_f", "rear": "lambda_r"}[self.axle]
        return {lambda_axle: self.lambda_level} if vehicle == self.vehicle else {}


class IcePatch(Fault):
    """The road's friction coefficient is `mu` under one vehicle, or under all.

    Attributes:
        vehicle: number of the vehicle, from 1; all if not given.
        mu: tyre-road adhesion, the friction coefficient.
    """

    kind: Literal["ice_patch"] = "ice_patch"
    vehicle: VehicleNumber | None = None
    mu: Annotated[float, Field(ge=ADHESION_MIN, le=ADHESION_MAX)] = 0.2

    def problems(self, bench: Bench) -> list[Problem]:
        """See `Fault`."""
        return no_vehicle(self.vehicle, bench)

    def on_vehicle(self, vehicle: int) -> dict[str, float]:
        """See `Fault`."""
        return {"mu": self.mu} if self.vehicle in (None, vehicle) else {}
