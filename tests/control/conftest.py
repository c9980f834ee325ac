"""What the tests of the control share: the nominal vehicle and its model at the bench's cycle of 10 ms."""

import pytest
from hypothesis import HealthCheck, settings

from bench.control.allocation import Allocation, allocate
from bench.control.vehicle_model import VehicleModel
from platoon_fmu.parameters import VehicleParameters

# No test asserts on wall-clock time, so none by Hypothesis' deadline or patience either.
settings.register_profile("no_deadline", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("no_deadline")


@pytest.fixture(scope="session")
def vehicle() -> VehicleParameters:
    return VehicleParameters()


@pytest.fixture(scope="session")
def model(vehicle: VehicleParameters) -> VehicleModel:
    return VehicleModel(vehicle, 0.01)


@pytest.fixture(scope="session")
def allocation(vehicle: VehicleParameters) -> Allocation:
    return allocate(vehicle, steering_max=0.5, force_max=3000.0, moment_share=0.25)
