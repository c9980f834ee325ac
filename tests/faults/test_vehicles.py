"""What a vehicle's own faults make of its actuators' commands and of its FMU's inputs."""

from collections.abc import Sequence

import pytest

from bench.errors import BadInput, RunFailed
from bench.faults.base import Fault
from bench.faults.plan import FaultPlan
from bench.faults.vehicles import ActuatorStuck, AxleSoftening, IcePatch, TyreBlowout
from bench.plant.actuators import Applied
from bench.plant.faults import VehicleFaults
from bench.scenario import load
from platoon_fmu.interface import INPUTS

INPUT_NAMES = {variable.name for variable in INPUTS}


def of_vehicle(number: int, faults: Sequence[Fault]) -> VehicleFaults:
    return VehicleFaults(number, FaultPlan(faults), INPUT_NAMES)


def test_a_stuck_actuator_stays_where_it_was() -> None:
    faults = of_vehicle(1, [ActuatorStuck(at_s=0.02, for_s=0.02, vehicle=1, actuator="steering")])
    applied = [faults.on_actuators(cycle, Applied(cycle / 10, cycle, cycle, cycle, cycle)) for cycle in range(5)]
    assert [each.steering_angle for each in applied] == [0.0, 0.1, 0.1, 0.1, 0.4]
    assert [each.torque_fl for each in applied] == [0, 1, 2, 3, 4]


def test_a_stuck_actuator_goes_to_its_value() -> None:
    faults = of_vehicle(1, [ActuatorStuck(at_s=0.0, vehicle=1, actuator="torque_rl", value=600.0)])
    assert faults.on_actuators(0, Applied(0.1, 1.0, 2.0, 3.0, 4.0)) == Applied(0.1, 1.0, 600.0, 3.0, 4.0)


def test_another_vehicles_actuators_are_as_they_are() -> None:
    faults = of_vehicle(2, [ActuatorStuck(at_s=0.0, vehicle=1, actuator="steering", value=0.3)])
    assert faults.on_actuators(0, Applied(0.1)) == Applied(0.1)


@pytest.mark.parametrize(("axle", "changed"), [("front", "lambda_f"), ("rear", "lambda_r")])
def test_an_axle_loses_cornering_stiffness(axle: str, changed: str) -> None:
    faults = of_vehicle(1, [AxleSoftening(at_s=0.01, vehicle=1, axle=axle, lambda_level=-0.5)])
    acting = {"lambda_f": 0.1, "lambda_r": 0.2, "mu": 0.8}
    assert faults.on_inputs(0, acting) == acting
    assert faults.on_inputs(1, acting) == acting | {changed: -0.5}


@pytest.mark.parametrize("wheel", ["fl", "rl", "rr", "fr"])
def test_one_wheels_tyre_loses_its_pressure(wheel: str) -> None:
    faults = of_vehicle(1, [TyreBlowout(at_s=0.0, vehicle=1, wheel=wheel)])
    sound = {"inflation_fl": 1.0, "inflation_rl": 1.0, "inflation_rr": 1.0, "inflation_fr": 1.0}
    assert faults.on_inputs(0, sound) == sound | {f"inflation_{wheel}": 0.0}
    others = of_vehicle(2, [TyreBlowout(at_s=0.0, vehicle=1, wheel=wheel)])
    assert others.on_inputs(0, sound) == sound


BLOWOUT = TyreBlowout(at_s=0.0, vehicle=1, wheel="rl")
SOFTENING = AxleSoftening(at_s=0.0, vehicle=1, axle="rear")


@pytest.mark.parametrize("fault", [BLOWOUT, SOFTENING, IcePatch(at_s=0.0)], ids=lambda fault: fault.kind)
def test_an_fmu_without_the_input_that_a_fault_sets_is_refused(fault: Fault) -> None:
    """It would drive on as if nothing had happened."""
    (name,) = fault.on_vehicle(1)
    lacking = VehicleFaults(1, FaultPlan([fault]), INPUT_NAMES - {name})
    with pytest.raises(RunFailed, match=f"no input {name}"):
        lacking.on_inputs(0, {})
    assert set(of_vehicle(1, [fault]).on_inputs(0, {})) == {name}


def test_a_blowout_of_an_axle_is_refused_with_what_to_write_now() -> None:
    with pytest.raises(BadInput) as refusal:
        load("formation", ['faults=[{kind = "tyre_blowout", at_s = 1.0, vehicle = 1, axle = "front"}]'])
    assert "has 1 error" in str(refusal.value)
    assert "faults.0" in str(refusal.value)
    assert 'now called "axle_softening"' in str(refusal.value)


@pytest.mark.parametrize(("vehicle", "is_on_ice"), [(1, True), (2, False), (None, True)])
def test_ice_is_under_one_vehicle_or_under_all(vehicle: int | None, is_on_ice: bool) -> None:
    faults = of_vehicle(1, [IcePatch(at_s=0.0, vehicle=vehicle, mu=0.1)])
    assert faults.on_inputs(0, {"mu": 0.8}) == {"mu": 0.1 if is_on_ice else 0.8}


def test_of_two_faults_of_the_same_kind_the_later_holds() -> None:
    faults = of_vehicle(1, [IcePatch(at_s=0.0, mu=0.1), IcePatch(at_s=0.0, mu=0.3)])
    assert faults.on_inputs(0, {"mu": 0.8}) == {"mu": 0.3}
