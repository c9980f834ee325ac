"""The keys of scenarios, listed for people and as a schema for editors, against the loader."""

import copy
import json
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import tomli_w
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from jsonschema import Draft202012Validator

from bench.cli.scenario_keys import described
from bench.errors import BadInput
from bench.faults.kinds import kinds
from bench.scenario import SCENARIO_DIR, load, shipped
from bench.scenario.keys import editor_schema, editor_schema_text, keys

SCHEMA = Draft202012Validator(editor_schema())
ALL = {key.name: key for key in keys()}
SHIPPED = [tomllib.loads((SCENARIO_DIR / f"{name}.toml").read_text()) for name in shipped()]
FULL: dict[str, Any] = tomllib.loads(load("crosswind").toml())
FULL["faults"] = [
    {"kind": "frame_loss", "at_s": 1.0, "bus": "veh1", "bursts": {"to_bad": 0.1, "to_good": 0.5}},
    {"kind": "sensor_bias", "at_s": 1.0, "for_s": 1.0, "bus": "veh1", "message": "VehicleMotion", "signal": "YawRate"}
    | {"bias": 0.1},
    {"kind": "ice_patch", "at_s": 1.0, "mu": 0.2},
]
FULL["road"] |= {"mu": {"kind": "sine", "mean": 0.8, "amplitude": 0.1, "frequency_hz": 1.0}}
FULL["vehicles"][0]["road"] = {"mu": 0.7, "slope_rad": {"kind": "step", "at_s": 1.0, "before": 0.0, "after": 0.1}}


def refusal(document: dict[str, Any], folder: Path) -> str | None:
    """What the loader says of a scenario; None if it takes it."""
    (folder / "mine.toml").write_text(tomli_w.dumps(document))
    try:
        load(folder / "mine.toml")
    except BadInput as error:
        return str(error)
    return None


def accepted_by_schema(document: dict[str, Any]) -> bool:
    return bool(SCHEMA.is_valid(document))


def tables(node: Any, path: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    """The paths of all tables in a document."""
    if isinstance(node, dict):
        yield path
    for key, value in node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ():
        yield from tables(value, (*path, key))


def leaves(node: Any, path: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    """The paths of all values in a document."""
    if path:
        yield path
    for key, value in node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else ():
        yield from leaves(value, (*path, key))


def at(document: Any, path: tuple[str | int, ...]) -> Any:
    for part in path:
        document = document[part]
    return document


def test_the_schema_is_valid_and_takes_what_is_shipped(tmp_path: Path) -> None:
    Draft202012Validator.check_schema(editor_schema())
    assert json.loads(editor_schema_text())["$schema"] == "https://json-schema.org/draft/2020-12/schema"
    for document in (*SHIPPED, FULL):
        assert refusal(document, tmp_path) is None
        assert list(SCHEMA.iter_errors(document)) == []
        # A scenario printed in full, with all defaults.
        assert accepted_by_schema(tomllib.loads(load(tmp_path / "mine.toml").toml()))


@pytest.mark.parametrize("path", list(tables(FULL)), ids=str)
def test_an_unknown_key_is_refused_in_every_table(path: tuple[str | int, ...], tmp_path: Path) -> None:
    document = copy.deepcopy(FULL)
    at(document, path)["gap"] = 1.0
    if path == ("buses",):
        return
    assert refusal(document, tmp_path) is not None
    assert not accepted_by_schema(document)


VALUES = st.one_of(
    st.floats(allow_nan=False, allow_infinity=False),
    st.sampled_from([0.0, 1.0, -1.0, 0.5, 4.99, 5.0, 300.0, 300.1, 1e9]),
    st.integers(-(2**40), 2**40),
    st.booleans(),
    st.text("abc .12", max_size=4),
    st.sampled_from(["end", "continue", "allow", "front", "veh1.tracker", "step", "constant", "frame_loss"]),
    st.lists(st.floats(0, 5), max_size=3),
    st.dictionaries(
        st.sampled_from(["kind", "at_s", "before", "after", "level"]), st.sampled_from(["step", 1.0]), max_size=4
    ),
)


@settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(path=st.sampled_from(list(leaves(FULL))), value=VALUES)
def test_what_the_loader_takes_the_schema_takes(path: tuple[str | int, ...], value: Any, tmp_path: Path) -> None:
    document = copy.deepcopy(FULL)
    at(document, path[:-1])[path[-1]] = value
    if refusal(document, tmp_path) is None:
        assert accepted_by_schema(document)


@settings(max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(path=st.sampled_from(list(leaves(FULL))))
def test_a_key_may_be_left_out_for_the_schema_if_for_the_loader(path: tuple[str | int, ...], tmp_path: Path) -> None:
    document = copy.deepcopy(FULL)
    if isinstance(path[-1], int):
        return
    del at(document, path[:-1])[path[-1]]
    assert accepted_by_schema(document) == (refusal(document, tmp_path) is None)


@pytest.mark.parametrize("path", [p for p in leaves(FULL) if isinstance(at(FULL, p), float | int | str)], ids=str)
@pytest.mark.parametrize("value", [-1e9, 1e9, "no", True, [], {}], ids=str)
def test_what_is_out_of_range_or_of_another_type_is_refused_by_both(
    path: tuple[str | int, ...], value: Any, tmp_path: Path
) -> None:
    document = copy.deepcopy(FULL)
    at(document, path[:-1])[path[-1]] = value
    said = refusal(document, tmp_path)
    if said is None:
        assert accepted_by_schema(document)
    elif not any(together in said for together in ("does not fit", "is not a message", "is not a signal")):
        # What depends on other keys, or on the DBC, and whether 1e9 is a whole number, only the loader knows.
        alone = path[-1] not in ("near_identity_length_m", "message", "signal", "amplitude", "mean", "before", "after")
        whole = type(value) is float and type(at(FULL, path)) is int
        assert whole or not alone or not accepted_by_schema(document)


def test_every_key_has_a_meaning_and_every_unit_is_of_its_name() -> None:
    for key in ALL.values():
        assert key.meaning, key.name
        assert key.allowed != "another value", key.name
        assert "None" not in key.meaning
        if key.name.partition(" ")[0].endswith(("_m", "_mps", "_s", "_rad", "_n", "_nm", "_mps2", "_radps", "_hz")):
            assert key.unit, key.name


def test_every_key_of_a_full_scenario_is_listed_with_its_default() -> None:
    def named(path: tuple[str | int, ...]) -> str:
        return ".".join("N" if isinstance(part, int) else part for part in path)

    bare = {name.partition(" ")[0] for name in ALL}
    for path in leaves(FULL):
        value, parent = at(FULL, path), at(FULL, path[:-1])
        is_profile = isinstance(parent, dict) and parent.get("kind") in ("step", "sine")
        if isinstance(path[-1], int) or is_profile or (isinstance(value, dict) and "kind" not in value):
            continue
        assert named(path) in bare
    for kind, model in kinds().items():
        listed = {name for name in ALL if name.endswith(f"({kind})")}
        own = {key for key in model.model_fields if key not in ("kind", "at_s", "for_s", "bursts")}
        assert {name.partition(" ")[0].removeprefix("faults.N.") for name in listed} >= own
    assert (ALL["platoon.gap_m"].default, ALL["platoon.gap_m"].unit) == ("10.0", "m")
    assert ALL["platoon.gap_m"].allowed == "a finite number from 5 to 100"
    assert ALL["platoon.lane_y_m"].required
    assert not ALL["name"].required
    assert ALL["planner.genetic.p11"].unit == "1/s^2"
    assert ALL["road.lambda_f"].unit == ""


def test_a_default_is_what_the_loader_takes_for_it(tmp_path: Path) -> None:
    bare = {"platoon": {"lane_y_m": 0.0}, "vehicles": [{"x_m": 0.0, "y_m": 0.0, "speed_mps": 20.0}]}
    (tmp_path / "bare.toml").write_text(tomli_w.dumps(bare))
    loaded = json.loads(load(tmp_path / "bare.toml").model_dump_json())
    for name, key in ALL.items():
        if key.default and ".N." not in name and "<" not in name:
            assert at(loaded, tuple(name.split("."))) == pytest.approx(json.loads(key.default)), name


def test_a_pattern_selects_by_part_of_the_name_or_as_a_whole() -> None:
    assert [key.name for key in keys("gap")] == ["platoon.gap_m"]
    assert {key.name for key in keys("planner.genetic.p[12]?")} == {f"planner.genetic.p{n}" for n in (11, 12, 21, 22)}
    assert all("(ice_patch)" in key.name for key in keys("ice_patch"))
    assert len(keys("*")) == len(keys()) == len(ALL)
    with pytest.raises(BadInput, match=r"did you mean gap_m\?"):
        described("gpa_m")


def test_keys_are_listed_with_all_that_is_known(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    assert described("gap").splitlines() == [
        "platoon.gap_m = 10.0 [m]",
        "    distance between successive vehicles, centre to centre.",
        "    allowed: a finite number from 5 to 100",
    ]
    assert max(map(len, described(None).splitlines())) <= 240


def test_a_word_that_is_in_no_name_is_looked_for_in_the_meanings() -> None:
    assert {key.name for key in keys("Friction")} == {"road.mu", "vehicles.N.road.mu", "faults.N.mu (ice_patch)"}
    assert keys("platoon.frict*") == []


def test_no_key_that_must_be_given_says_what_holds_without_it() -> None:
    assert [key.name for key in keys() if key.required and "if not given" in key.meaning] == []


@pytest.mark.parametrize("kind", ["sensor_bias", "sensor_noise"])
def test_a_sensor_fault_needs_its_message(kind: str, tmp_path: Path) -> None:
    document = copy.deepcopy(FULL)
    strength = {"sensor_bias": "bias", "sensor_noise": "sigma"}[kind]
    document["faults"] = [{"kind": kind, "at_s": 1.0, "bus": "veh1", "signal": "YawRate", strength: 0.1}]
    assert "faults.0.message is missing" in str(refusal(document, tmp_path))
    assert not accepted_by_schema(document)
