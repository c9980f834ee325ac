"""The real FMUs, built once a session, and cars made of them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest

from platoon_fmu.build import build
from platoon_fmu.importer import Instance, Kind, OpenFmu, opened
from platoon_fmu.versions import FMI2, FMI3
from tests.conftest import Once

WHEELS = ("fl", "rl", "rr", "fr")


class Car(Instance):
    """An instance of the vehicle FMU with what a driver does."""

    def start(self, **values: float) -> Car:
        super().start(values, time=self.time)
        return self

    def torque(self, *torques: float) -> None:
        """One torque for all wheels, or four in the order of WHEELS [N m]."""
        each = torques * 4 if len(torques) == 1 else torques
        self.set({f"wheel_torque_{n}": t for n, t in zip(WHEELS, each, strict=True)})

    def wheels(self, quantity: str) -> np.ndarray:
        return self.get(*(f"{quantity}_{n}" for n in WHEELS))

    def step(self, h: float = 0.01) -> None:
        super().step(h)

    def run(self, seconds: float, h: float = 0.01, names: Sequence[str] = ()) -> np.ndarray:
        """Steps with constant inputs; the named values after each step, (steps, names)."""
        rows = []
        for _ in range(round(seconds / h)):
            self.step(h)
            rows.append(self.get(*names) if names else np.empty(0))
        return np.array(rows)

    def cruise(self, seconds: float, speed: float, **inputs: float) -> None:
        """Holds a speed by the external force, so that the tyres carry no drive force."""
        self.set(inputs)
        drag = 0.0
        for _ in range(round(seconds / 0.01)):
            error = speed - self["v_x"]
            drag += 5000 * error * 0.01
            self.set(force_x=5000 * error + drag)
            self.step()


@pytest.fixture(scope="session")
def car_class() -> type[Car]:
    """What the cars below are, to make others of."""
    return Car


@pytest.fixture(scope="session")
def fmu_path(once: Once) -> Path:
    """The FMU for FMI 2.0."""
    return next(once("fmu2", lambda folder: build(folder, version=FMI2)).glob("*.fmu"))


@pytest.fixture(scope="session")
def fmu3_path(once: Once) -> Path:
    """The FMU for FMI 3.0."""
    return next(once("fmu3", lambda folder: build(folder, version=FMI3)).glob("*.fmu"))


@pytest.fixture(scope="session")
def open_fmu2(fmu_path: Path) -> Iterator[OpenFmu]:
    with opened(fmu_path) as fmu:
        yield fmu


@pytest.fixture(scope="session")
def open_fmu3(fmu3_path: Path) -> Iterator[OpenFmu]:
    with opened(fmu3_path) as fmu:
        yield fmu


@pytest.fixture(params=[2, 3], ids=["FMI2", "FMI3"])
def open_fmu(request: pytest.FixtureRequest) -> OpenFmu:
    """The FMU for each version in turn."""
    found: OpenFmu = request.getfixturevalue(f"open_fmu{request.param}")
    return found


def _maker(fmu: OpenFmu) -> Iterator[Callable[..., Car]]:
    cars: list[Car] = []

    def make(kind: Kind = Kind.CO_SIMULATION) -> Car:
        cars.append(Car(fmu, kind, f"car{len(cars)}"))
        return cars[-1]

    yield make
    for car in cars:
        car.free()


@pytest.fixture
def make_car(open_fmu2: OpenFmu) -> Iterator[Callable[..., Car]]:
    """Makes cars of the FMU for FMI 2.0."""
    yield from _maker(open_fmu2)


@pytest.fixture
def make_any(open_fmu: OpenFmu) -> Iterator[Callable[..., Car]]:
    """Makes cars of the FMU for each version in turn."""
    yield from _maker(open_fmu)
