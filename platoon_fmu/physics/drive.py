"""Drives the vehicle as a Co-Simulation FMU: steps, recordings, and a driver that holds the speed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from platoon_fmu.errors import FmuError
from platoon_fmu.importer import Instance, Kind, OpenFmu
from platoon_fmu.parameters import VehicleParameters
from platoon_fmu.wheels import WHEEL_NAMES

Array = NDArray[np.float64]

STATES = (
    *("X", "Y", "psi", "phi", "v_x", "v_y", "gamma", "p"),
    *(f"omega_{wheel}" for wheel in WHEEL_NAMES),
    *("load_transfer_x", "load_transfer_y"),
)


def of_wheels(quantity: str) -> tuple[str, ...]:
    """The names of a quantity at the four wheels, in the order of `WHEEL_NAMES`."""
    return tuple(f"{quantity}_{wheel}" for wheel in WHEEL_NAMES)


def declared_parameters(fmu: OpenFmu) -> VehicleParameters:
    """The parameters declared in an FMU's modelDescription.xml: their start values, and that of mu for `mu_a`.

    Raises:
        FmuError: one is missing, so it is not this vehicle.
    """
    starts = {variable.name: variable.start for variable in fmu.description.modelVariables}
    values = {}
    for field in fields(VehicleParameters):
        name = "mu" if field.name == "mu_a" else field.name
        if starts.get(name) is None:
            raise FmuError(
                f"the FMU {fmu.description.modelName} declares no {name}, so it is not the platoon's vehicle"
            )
        values[field.name] = float(starts[name])
    return VehicleParameters(**values)


@dataclass(frozen=True)
class Trace:
    """A recording.

    Attributes:
        t: time of each row [s], from 0 at the start of the recording.
        series: values (rows,) by variable name.
    """

    t: Array
    series: Mapping[str, Array]

    def __getitem__(self, name: str) -> Array:
        """The values of one variable, (rows,)."""
        return self.series[name]

    def wheels(self, quantity: str) -> Array:
        """A quantity at the four wheels, (4, rows)."""
        return np.array([self.series[name] for name in of_wheels(quantity)])


class Car:
    """One started instance of the vehicle; a context manager that frees it.

    It only gets and sets scalar real variables, and looks up each reference once, because manoeuvres do this very
    often.
    """

    def __init__(self, fmu: OpenFmu, values: Mapping[str, float] | None = None) -> None:
        """Starts it.

        Args:
            fmu: the opened FMU.
            values: start values of parameters and inputs by name.

        Raises:
            FmuError: the FMU has no Co-Simulation, does not load, or lacks a variable.
        """
        self._instance = Instance(fmu, Kind.CO_SIMULATION)
        try:
            self._instance.start(values)
        except BaseException:
            self._instance.free()
            raise
        self._references: dict[tuple[str, ...], list[int]] = {}
        raw, of_fmi_2 = self._instance.raw, fmu.version == 2
        self._read, self._write = (raw.getReal, raw.setReal) if of_fmi_2 else (raw.getFloat64, raw.setFloat64)
        self.step = self._instance.step

    def __enter__(self) -> Car:
        """The car itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Frees the instance."""
        self._instance.free()

    def get(self, *names: str) -> Array:
        """The values of variables by name."""
        return np.array(self._read(self._referenced(names)))

    def set(self, values: Mapping[str, float] | None = None, **more: float) -> None:
        """Sets inputs by name."""
        values = {**(values or {}), **more}
        self._write(self._referenced(tuple(values)), [float(value) for value in values.values()])

    def _referenced(self, names: tuple[str, ...]) -> list[int]:
        if names not in self._references:
            # The instance raises the error for a missing variable.
            self._instance.get(*names)
            self._references[names] = self._instance.references(names)
        return self._references[names]

    def torque(self, *torques: float) -> None:
        """One torque for all wheels, or four in the order of `WHEEL_NAMES` [N m]."""
        each = torques * 4 if len(torques) == 1 else torques
        self.set(dict(zip(of_wheels("wheel_torque"), each, strict=True)))

    def record(
        self, seconds: float, h: float, names: Sequence[str], before_step: Callable[[Car, float], None] | None = None
    ) -> Trace:
        """Drives for some time.

        Args:
            seconds: duration [s].
            h: communication step [s].
            names: variables to record, at the start and after each step.
            before_step: called with the car and h before each step, to set inputs.
        """
        rows = [self.get(*names)]
        for _ in range(round(seconds / h)):
            if before_step is not None:
                before_step(self, h)
            self.step(h)
            rows.append(self.get(*names))
        return Trace(np.linspace(0.0, h * (len(rows) - 1), len(rows)), dict(zip(names, np.array(rows).T, strict=True)))


class SpeedHold:
    """Holds v_x with the external force at the centre of mass, so that the tyres transmit no drive force."""

    _GAIN = 5000.0

    def __init__(self, speed: float) -> None:
        """Holds a speed.

        Args:
            speed: v_x [m/s].
        """
        self._speed, self._sum = speed, 0.0

    def __call__(self, car: Car, h: float) -> None:
        """Sets force_x for the next h seconds: proportional, and integral with a time constant of 1 s."""
        error = self._speed - float(car.get("v_x")[0])
        self._sum += error * h
        car.set(force_x=self._GAIN * (error + self._sum))
