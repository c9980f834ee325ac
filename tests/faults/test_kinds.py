"""All kinds of faults together: that each is found, read back as it was, and names what its target lacks."""

import pytest
from pydantic import TypeAdapter

from bench.errors import BadInput
from bench.faults.base import Fault
from bench.faults.kinds import FAMILIES, AnyFault, kinds
from bench.scenario import load

READ: TypeAdapter[Fault] = TypeAdapter(AnyFault)
ANY = {
    "bus": "veh1",
    "message": "VehicleMotion",
    "signal": "YawRate",
    "bias": 0.1,
    "sigma": 0.1,
    "node": "veh1.planner",
    "ecu": "veh1.planner",
    "vehicle": 1,
    "actuator": "steering",
    "axle": "front",
    "wheel": "fl",
}
"""A value for each key that some kind cannot do without."""


def example(kind: str) -> dict[str, object]:
    keys = [name for name, field in kinds()[kind].model_fields.items() if field.is_required() and name != "at_s"]
    return {"kind": kind, "at_s": 1.0} | {key: ANY[key] for key in keys}


def test_every_class_with_a_kind_is_found_under_its_name_in_the_order_of_the_families() -> None:
    assert {each.__module__ for each in kinds().values()} == {family.__name__ for family in FAMILIES}
    assert all(each.name() == name for name, each in kinds().items())
    assert next(iter(kinds())) == "frame_loss"


@pytest.mark.parametrize("kind", kinds())
def test_a_kind_is_read_from_its_table_and_written_as_one(kind: str) -> None:
    fault = READ.validate_python(example(kind))
    assert type(fault) is kinds()[kind]
    assert READ.validate_json(READ.dump_json(fault)) == fault


def inline(table: dict[str, object]) -> str:
    return "{" + ", ".join(f"{name} = {value!r}" for name, value in table.items()) + "}"


@pytest.mark.parametrize("kind", kinds())
def test_a_target_that_exists_is_taken(kind: str) -> None:
    assert load("formation", [f"faults=[{inline(example(kind))}]"]).faults == (READ.validate_python(example(kind)),)


@pytest.mark.parametrize(
    "kind", [kind for kind in kinds() if any(key in example(kind) for key in ("bus", "node", "ecu", "vehicle"))]
)
def test_a_target_that_does_not_exist_is_named(kind: str) -> None:
    key = next(key for key in ("bus", "node", "ecu", "vehicle") if key in example(kind))
    value: object = 9 if key == "vehicle" else str(ANY[key]).replace("veh1", "veh9")
    table = example(kind) | {key: value}
    with pytest.raises(BadInput, match=rf"faults\.0\.{key} = (veh)?9\S* does not exist; allowed: "):
        load("formation", [f"faults=[{inline(table)}]"])


@pytest.mark.parametrize(
    ("fault", "complaint"),
    [
        ('{kind = "ice_patch", at_s = 1.0, vehicle = 4}', "faults.0.vehicle = 4 does not exist; allowed: 1 to 3"),
        ('{kind = "v2v_outage", at_s = 1.0, vehicle = 4}', "faults.0.vehicle = 4 does not exist; allowed: 1 to 3"),
        ('{kind = "ecu_crash", at_s = 1.0, ecu = "veh4.planner"}', "faults.0.ecu = veh4.planner does not exist"),
        ('{kind = "frame_loss", at_s = 1.0, bus = "veh4"}', "faults.0.bus = veh4 does not exist; allowed: v2v, veh1"),
        ('{kind = "frame_loss", at_s = 1.0, bus = "veh1", message = "BenchSync"}', "faults.0.message = BenchSync"),
        (
            '{kind = "sensor_bias", at_s = 1.0, bus = "veh1", message = "Reference", signal = "YawRate", bias = 1.0}',
            "message = Reference is not a message on veh1 that can have this fault; allowed: VehiclePosition, ",
        ),
        (
            '{kind = "signal_stuck", at_s = 1.0, bus = "veh1", message = "Reference", signal = "Yaw"}',
            "faults.0.signal = Yaw is not a signal of Reference; allowed: VelocityX, YawRate, ReferenceState",
        ),
        (
            '{kind = "counter_stuck", at_s = 1.0, bus = "veh1", message = "PlannerStatus"}',
            "faults.0.message = PlannerStatus has no alive counter",
        ),
        ('{kind = "earthquake", at_s = 1.0}', 'faults.0 has the kind "earthquake"; allowed: one of actuator_stuck, '),
        ("{at_s = 1.0}", "faults.0 has no kind; allowed: one of actuator_stuck"),
        ('{kind = "frame_loss", at_s = 1.0, bus = "veh1", probability = 2.0}', "faults.0.probability = 2.0"),
        ('{kind = "ice_patch", at_s = 1.0, frction = 0.1}', "faults.0.frction is not a scenario key"),
        ('{kind = "ice_patch"}', "faults.0.at_s is missing"),
    ],
)
def test_a_fault_that_cannot_be_is_refused_by_key(fault: str, complaint: str) -> None:
    with pytest.raises(BadInput) as refusal:
        load("formation", [f"faults=[{fault}]"])
    assert complaint in str(refusal.value)
