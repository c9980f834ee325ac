"""A scenario: the complete input of a run, validated before the run starts.

Keys carry their unit (`_m`, `_mps`, `_rad`, `_s`, `_n`, `_nm`). Positions are those of the centre of mass in the
road frame (ISO 8855: X along the road, Y to the left). Vehicle numbers start at 1 (`veh1`), list indices in keys at 0
(`vehicles.0.x_m`).
"""

import dataclasses
import itertools
import math
from typing import Annotated, ClassVar, Literal, Self

import tomli_w
from pydantic import BaseModel, Field, ValidationInfo, model_validator, with_config
from pydantic_core import PydanticCustomError

from bench.control.settings import (
    ADHESION_MAX,
    ADHESION_MIN,
    PlannerSettings,
    TrackerSettings,
    check_length,
    planning_cycles,
)
from bench.cycle import CYCLE_S
from bench.errors import BadInput
from bench.faults.kinds import AnyFault
from bench.faults.profile import STRICT, Profile, Within, constant
from platoon_fmu.parameters import BODY, LAMBDA_MAX, LAMBDA_MIN, VehicleParameters

LEAST_START_CLEARANCE_M = 0.3
"""Minimum initial distance between the bodies of two vehicles (m)."""

_SURELY_CLEAR_M = math.hypot(BODY.length, BODY.width) + LEAST_START_CLEARANCE_M
"""Distance between centres of mass (m) from which bodies are clear of each other in whatever direction they point."""

MOST_VEHICLES = 16
MOST_FAULTS = 1000
"""Limit on faults of a scenario: every process looks through all of them in every cycle."""

LONGEST_DESCRIPTION = 4000
"""Limit on characters of a scenario's description: two pages of text."""

FROM_LOG = {"from": "log"}
"""Validation context of the scenario of a run that has been made."""

Problem = tuple[tuple[str | int, ...], str]
"""The path of a key, and the error in its value."""

Speed = Annotated[float, Field(ge=1, le=40)]
Lateral = Annotated[float, Field(ge=-100, le=100)]
CorneringUncertainty = Annotated[Profile, Within(LAMBDA_MIN, LAMBDA_MAX)]
Adhesion = Annotated[Profile, Within(ADHESION_MIN, ADHESION_MAX)]
Force = Annotated[Profile, Within(-20_000, 20_000)]
Moment = Annotated[Profile, Within(-20_000, 20_000)]
Slope = Annotated[Profile, Within(-0.3, 0.3)]


class Platoon(BaseModel):
    """The platoon to form.

    Attributes:
        lane_y_m: lateral position of its lane's centre (m).
        speed_mps: its speed (m/s).
        gap_m: distance between successive vehicles, centre to centre (m).
    """

    model_config = STRICT

    lane_y_m: Lateral
    speed_mps: Speed = 20.0
    gap_m: Annotated[float, Field(ge=5, le=100)] = 10.0


class Road(BaseModel):
    """External influences on a vehicle, each a constant or a function of time.

    Attributes:
        lambda_f: front cornering stiffness is C_f (1 + 0.4 lambda_f).
        lambda_r: rear cornering stiffness is C_r (1 + 0.4 lambda_r).
        mu: tyre-road adhesion, the friction coefficient.
        force_x_n: force at the centre of mass along the vehicle's x axis (N).
        force_y_n: force at the centre of mass along the vehicle's y axis (N).
        moment_z_nm: yaw moment (N m).
        slope_rad: slope of the road, positive uphill (rad).
    """

    model_config = STRICT

    lambda_f: CorneringUncertainty = constant(0.0)
    lambda_r: CorneringUncertainty = constant(0.0)
    mu: Adhesion = constant(VehicleParameters().mu_a)
    force_x_n: Force = constant(0.0)
    force_y_n: Force = constant(0.0)
    moment_z_nm: Moment = constant(0.0)
    slope_rad: Slope = constant(0.0)


class Noise(BaseModel):
    """Standard deviations of the white Gaussian noise in what every vehicle measures, each cycle anew; 0 is none.

    Attributes:
        position_m: of X and of Y (m).
        yaw_rad: of the yaw angle (rad).
        roll_rad: of the roll angle (rad).
        velocity_mps: of the velocities along and across the vehicle (m/s).
        yaw_rate_radps: of the yaw rate (rad/s).
        acceleration_mps2: of the accelerations along and across the vehicle (m/s^2).
        wheel_speed_radps: of each wheel's speed of rotation (rad/s).
    """

    model_config = STRICT

    position_m: Annotated[float, Field(ge=0, le=10)] = 0.0
    yaw_rad: Annotated[float, Field(ge=0, le=1)] = 0.0
    roll_rad: Annotated[float, Field(ge=0, le=1)] = 0.0
    velocity_mps: Annotated[float, Field(ge=0, le=10)] = 0.0
    yaw_rate_radps: Annotated[float, Field(ge=0, le=1)] = 0.0
    acceleration_mps2: Annotated[float, Field(ge=0, le=10)] = 0.0
    wheel_speed_radps: Annotated[float, Field(ge=0, le=100)] = 0.0


class VehicleRoad(BaseModel):
    """The values of `Road` that differ for one vehicle."""

    same_keys_as: ClassVar[type[BaseModel]] = Road

    model_config = STRICT

    lambda_f: CorneringUncertainty | None = None
    lambda_r: CorneringUncertainty | None = None
    mu: Adhesion | None = None
    force_x_n: Force | None = None
    force_y_n: Force | None = None
    moment_z_nm: Moment | None = None
    slope_rad: Slope | None = None


class Vehicle(BaseModel):
    """Initial state of a vehicle, which rolls straight ahead at `speed_mps`.

    Attributes:
        x_m: initial position along the road (m).
        y_m: initial position across the road, positive to the left (m).
        yaw_rad: initial heading, 0 along the road, positive to the left (rad).
        speed_mps: initial speed (m/s).
        road: the values of the scenario's `road` that differ for this vehicle.
    """

    model_config = STRICT

    # The bounds keep a run of 300 s at 40 m/s within the range of the position signals (13 421 m).
    x_m: Annotated[float, Field(ge=-1000, le=1000)]
    y_m: Lateral
    yaw_rad: Annotated[float, Field(ge=-1.5, le=1.5)] = 0.0
    speed_mps: Speed
    road: VehicleRoad | None = None


def _refuse_unknown_keys(settings: type) -> None:
    """Validate a plain dataclass of the controllers, and nested ones, as strictly as the models here."""
    with_config(STRICT)(settings)
    for field in dataclasses.fields(settings):
        if isinstance(field.type, type) and dataclasses.is_dataclass(field.type):
            _refuse_unknown_keys(field.type)


# The controllers do not depend on pydantic, so their settings are configured for it here.
_refuse_unknown_keys(PlannerSettings)
_refuse_unknown_keys(TrackerSettings)


class Scenario(BaseModel):
    """The complete input of a run: the same scenario gives the same frames.

    Attributes:
        name: name of the scenario, which is also that of its logs; the file's name if not given.
        description: what it shows, in words.
        duration_s: simulated time of the run (s), a multiple of the cycle.
        seed: seed of all random numbers.
        platoon: the platoon to form.
        vehicles: initial states of the vehicles; the first is `veh1`.
        road: external influences on all vehicles.
        noise: noise of all vehicles' sensors.
        planner: settings of the planner.
        tracker: settings of the tracker.
        faults: planned faults, each a table with its kind.
        buses: place of each bus, by name (`v2v`, `veh1` ...) or `all`, as for `--can`, which takes precedence.
        on_ecu_failure: whether the run ends or continues if an ECU exits or falls silent without a fault.
        on_not_a_number: whether a run counts as failed if an ECU's command is not a number (NaN or infinite).
    """

    model_config = STRICT

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$")]
    description: Annotated[str, Field(max_length=LONGEST_DESCRIPTION)] = ""
    duration_s: Annotated[float, Field(ge=CYCLE_S, le=300)] = 10.0
    seed: Annotated[int, Field(ge=0, le=2**32 - 1)] = 1
    platoon: Platoon
    vehicles: Annotated[tuple[Vehicle, ...], Field(min_length=1, max_length=MOST_VEHICLES)]
    road: Road = Road()
    noise: Noise = Noise()
    planner: PlannerSettings = PlannerSettings()
    tracker: TrackerSettings = TrackerSettings()
    faults: Annotated[tuple[AnyFault, ...], Field(max_length=MOST_FAULTS)] = ()
    on_ecu_failure: Literal["end", "continue"] = "end"
    on_not_a_number: Literal["fail", "allow"] = "fail"
    buses: Annotated[dict[str, str], Field(max_length=MOST_VEHICLES + 2)] = {}

    @property
    def cycles(self) -> int:
        """Number of 10 ms cycles of the run."""
        return round(self.duration_s / CYCLE_S)

    def road_of(self, vehicle: int) -> Road:
        """Return the road for vehicle number `vehicle` (from 1), with the values specific to that vehicle."""
        own = self.vehicles[vehicle - 1].road or VehicleRoad()
        changes = {key: value for key, value in own if value is not None}
        return self.road.model_copy(update=changes)

    def toml(self) -> str:
        """Return the complete scenario, including defaults, as TOML that `load` reads back to an equal scenario."""
        return tomli_w.dumps(self.model_dump(exclude_none=True))

    @model_validator(mode="after")
    def _check_together(self, info: ValidationInfo) -> Self:
        problems = [
            *self._duration_problems(),
            # Earlier versions let vehicles start nearer to each other, and their logs are still read.
            *([] if info.context is FROM_LOG else self._place_problems()),
            *self._planner_problems(),
            *self._fault_problems(),
            *self._bus_problems(),
        ]
        if problems:
            raise PydanticCustomError("together", "values that do not fit together", {"problems": problems})
        return self

    def _duration_problems(self) -> list[Problem]:
        if math.isclose(self.cycles * CYCLE_S, self.duration_s, abs_tol=1e-9):
            return []
        text = f"= {self.duration_s} is not a whole number of cycles; allowed: multiples of {CYCLE_S} s"
        return [(("duration_s",), text)]

    def _place_problems(self) -> list[Problem]:
        near = [
            ((i, one), (j, other))
            for (i, one), (j, other) in itertools.combinations(enumerate(self.vehicles), 2)
            if math.hypot(one.x_m - other.x_m, one.y_m - other.y_m) < _SURELY_CLEAR_M
        ]
        if not near:
            return []
        # Only vehicles this near need numpy, which is slow to import.
        from bench.bodies import clearance_of

        problems: list[Problem] = []
        for (i, one), (j, other) in near:
            found = clearance_of((one.x_m, one.y_m, one.yaw_rad), (other.x_m, other.y_m, other.yaw_rad))
            # A clearance of 0.3 m that the positions miss by rounding is one.
            if found < LEAST_START_CLEARANCE_M - 1e-6:
                problems.append((("vehicles", j), _too_near(j + 1, i + 1, found)))
        return problems

    def _fault_problems(self) -> list[Problem]:
        """Return the problems with the targets of faults."""
        if not self.faults:
            return []
        # Only faults need the DBC files, which are slow to read.
        from bench.scenario.fault_targets import target_problems

        return [
            (("faults", index, *key), text)
            for index, fault in enumerate(self.faults)
            for key, text in target_problems(fault, len(self.vehicles))
        ]

    @property
    def bus_texts(self) -> list[str]:
        """The places of the buses in the syntax of `--can`."""
        return [place if bus == "all" else f"{bus}={place}" for bus, place in self.buses.items()]

    def _bus_problems(self) -> list[Problem]:
        """Return the problems with the places of the buses."""
        if not self.buses:
            return []
        # Only places need python-can, which is slow to import.
        from bench.bus.link.address import Address

        try:
            Address.parse(*self.bus_texts)
        except BadInput as error:
            return [(("buses",), f"cannot be used: {str(error).removeprefix('--can ')}")]
        return []

    def _planner_problems(self) -> list[Problem]:
        """Return what the planner would reject, by its own rules."""
        problems: list[Problem] = []
        low, high = self.planner.speed_min_mps, self.planner.speed_max_mps
        if low > high:
            text = f"= {high:g} is below planner.speed_min_mps = {low:g}; allowed: at least that"
            problems.append((("planner", "speed_max_mps"), text))
        elif not low <= self.platoon.speed_mps <= high:
            text = (
                f"= {self.platoon.speed_mps} is outside planner.speed_min_mps to planner.speed_max_mps;"
                f" allowed: {low:g} to {high:g}"
            )
            problems.append((("platoon", "speed_mps"), text))
        try:
            check_length(self.planner.near_identity_length_m, high, CYCLE_S)
        except ValueError as error:
            problems.append((("planner", "near_identity_length_m"), f"is not allowed: {error}"))
        try:
            planning_cycles(self.planner.planning_interval_s, CYCLE_S)
        except ValueError as error:
            problems.append((("planner", "planning_interval_s"), f"is not allowed: {error}"))
        return problems


def _too_near(vehicle: int, other: int, clearance: float) -> str:
    """Return what is wrong with the start of two vehicles whose bodies have too small a clearance (m)."""
    where = f"{clearance:.2f} m from" if clearance > 0.0 else f"{-clearance:.2f} m inside"
    further = math.ceil(100.0 * (LEAST_START_CLEARANCE_M - clearance) - 1e-6) / 100.0
    return (
        f"(vehicle {vehicle}) starts {where} the body of vehicle {other} (bodies are {BODY.length:g} m by"
        f" {BODY.width:g} m); allowed: at least {LEAST_START_CLEARANCE_M:g} m between bodies; move it by"
        f" {further:.2f} m or more, with x_m or y_m"
    )
