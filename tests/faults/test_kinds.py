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


@pytest.mark.parametrize(
    "kind", [kind for kind in kinds() if any(key in example(kind) for key in ("bus", "node", "ecu", "vehicle"))]
)
def test_a_target_that_does_not_exist_is_named(kind: str) -> None:
    key = next(key for key in ("bus", "node", "ecu", "vehicle") if key in example(kind))
    value: object = 9 if key == "vehicle" else str(ANY[key]).replace("veh1", "veh9")
    table = example(kind) | {key: value}
    inline = ", ".join(f"{name} = {text!r}" for name, text in table.items())
    with pytest.raises(BadInput, match=rf"faults\.0\.{key} = (veh)?9\S* does not exist; allowed: "):
        load("formation", [f"faults=[{{{inline}}}]"])
