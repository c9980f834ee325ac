"""A real FMU, built once a session, and cars made of it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import fmpy
import numpy as np
import pytest
from fmpy import fmi2

from platoon_fmu.build import build

WHEELS = ("fl", "rl", "rr", "fr")


class Car:
    """One FMU instance, driven by names. `kind` is fmi2.FMU2Slave or fmi2.FMU2Model."""

    def __init__(self, folder: Path, description: Any, kind: Any, name: str) -> None:
        self.description = description
        self.references = {v.name: v.valueReference for v in description.modelVariables}
        self.states = [v.derivative.name for v in description.modelVariables if v.derivative is not None]
        self.fmu = kind(guid=description.guid, unzipDirectory=str(folder), modelIdentifier="Vehicle", instanceName=name)
        self.said: list[str] = []
        self.time = 0.0
        callbacks = fmi2.fmi2CallbackFunctions()
        callbacks.logger = fmi2.fmi2CallbackLoggerTYPE(self._log)
        callbacks.allocateMemory = fmi2.fmi2CallbackAllocateMemoryTYPE(fmi2.calloc)
        callbacks.freeMemory = fmi2.fmi2CallbackFreeMemoryTYPE(fmi2.free)
        self.fmu.instantiate(callbacks=callbacks, loggingOn=True)

    def _log(self, _environment: Any, _instance: Any, _status: int, _category: Any, message: bytes) -> None:
        self.said.append(message.decode())

    def start(self, **values: float) -> Car:
        self.fmu.setupExperiment(startTime=self.time)
        self.set(**values)
        self.fmu.enterInitializationMode()
        self.fmu.exitInitializationMode()
        return self

    def set(self, **values: float) -> None:
        self.fmu.setReal([self.references[name] for name in values], list(values.values()))

    def torque(self, *torques: float) -> None:
        """One torque for all wheels, or four in the order of WHEELS [N m]."""
        each = torques * 4 if len(torques) == 1 else torques
        self.set(**{f"wheel_torque_{n}": t for n, t in zip(WHEELS, each, strict=True)})

    def get(self, *names: str) -> np.ndarray:
        return np.array(self.fmu.getReal([self.references[name] for name in names]))

    def __getitem__(self, name: str) -> float:
        return float(self.get(name)[0])

    def wheels(self, quantity: str) -> np.ndarray:
        return self.get(*(f"{quantity}_{n}" for n in WHEELS))

    def step(self, h: float = 0.01) -> None:
        self.fmu.doStep(currentCommunicationPoint=self.time, communicationStepSize=h)
        self.time += h

    def run(self, seconds: float, h: float = 0.01, names: Sequence[str] = ()) -> np.ndarray:
        """Steps with constant inputs; the named values after each step, (steps, names)."""
        rows = []
        for _ in range(round(seconds / h)):
            self.step(h)
            rows.append(self.get(*names) if names else np.empty(0))
        return np.array(rows)

    def cruise(self, seconds: float, speed: float, **inputs: float) -> None:
        """Holds a speed by the external force, so that the tyres carry no drive force."""
        self.set(**inputs)
        drag = 0.0
        for _ in range(round(seconds / 0.01)):
            error = speed - self["v_x"]
            drag += 5000 * error * 0.01
            self.set(force_x=5000 * error + drag)
            self.step()


@pytest.fixture(scope="session")
def fmu_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build(tmp_path_factory.mktemp("fmu"))


@pytest.fixture(scope="session")
def fmu_folder(fmu_path: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("unzipped")
    fmpy.extract(str(fmu_path), unzipdir=str(folder))
    return folder


@pytest.fixture
def make_car(fmu_path: Path, fmu_folder: Path) -> Iterator[Callable[..., Car]]:
    description = fmpy.read_model_description(str(fmu_path))
    cars: list[Car] = []

    def make(kind: Any = fmi2.FMU2Slave) -> Car:
        cars.append(Car(fmu_folder, description, kind, f"car{len(cars)}"))
        return cars[-1]

    yield make
    for car in cars:
        car.fmu.fmi2FreeInstance(car.fmu.component)
