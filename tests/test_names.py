"""Names of buses and processes."""

import pytest

from bench.names import vehicle_bus, vehicle_of


@pytest.mark.parametrize(
    ("name", "vehicle"),
    [("veh3", 3), ("veh12.planner", 12), ("v2v", None), ("plant", None), ("weh1", None), ("veh", None), ("vehX", None)],
)
def test_the_vehicle_of_a_bus_or_process(name, vehicle):
    assert vehicle_of(name) == vehicle


def test_a_vehicles_bus_is_its_own():
    assert [vehicle_of(vehicle_bus(number)) for number in range(1, 17)] == list(range(1, 17))
