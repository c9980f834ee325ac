"""The virtual inputs: what they mean on the wheels, and that their limits keep every wheel inside its own."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from bench.control.allocation import Allocation, allocate, virtual_input
from platoon_fmu.parameters import VehicleParameters

share = st.floats(-1, 1)


def test_virtual_inputs_are_what_they_are_called(allocation: Allocation, vehicle: VehicleParameters) -> None:
    U = allocation.matrix @ np.array([0.1, 800.0, 300.0])
    front_left, rear_left, rear_right, front_right = U[1:]
    assert U[0] == 0.1
    assert U[1:].sum() == pytest.approx(800.0)
    moment = 0.5 * vehicle.l_t * (front_right - front_left + rear_right - rear_left)
    assert moment == pytest.approx(300.0)


@given(st.floats(0.05, 0.95), st.tuples(share, share, share))
def test_no_combination_overloads_a_wheel(moment_share: float, part: tuple[float, float, float]) -> None:
    allocation = allocate(VehicleParameters(), 0.4, 2500.0, moment_share)
    U = allocation.matrix @ (np.array(part) * allocation.limit)
    assert abs(U[0]) <= 0.4
    assert np.abs(U[1:]).max() <= 2500.0 * (1 + 1e-12)


def test_limits_together_use_a_wheel_fully(allocation: Allocation) -> None:
    U = allocation.matrix @ allocation.limit
    assert U[1:].max() == pytest.approx(3000.0)


@given(st.floats(-0.5, 0.5), st.floats(-9000, 9000), st.floats(-2000, 2000))
def test_virtual_input_is_what_the_allocated_forces_come_to(steering: float, force: float, moment: float) -> None:
    vehicle = VehicleParameters()
    allocation = allocate(vehicle, 0.5, 3000.0, 0.25)
    delta, *forces = allocation.matrix @ np.array([steering, force, moment])
    found = virtual_input(vehicle, delta, np.array(forces))
    assert found == pytest.approx([steering, force, moment], rel=1e-9, abs=1e-9)
