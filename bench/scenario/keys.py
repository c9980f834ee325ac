"""Every key of a scenario, for people and for editors: both are derived from the model and its docstrings."""

import copy
import fnmatch
import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

from bench.scenario.errors import allowed, resolve
from bench.scenario.model import Scenario

DIALECT = "https://json-schema.org/draft/2020-12/schema"

_UNITS = {
    "_m": "m",
    "_s": "s",
    "_mps": "m/s",
    "_mps2": "m/s^2",
    "_rad": "rad",
    "_radps": "rad/s",
    "_radps2": "rad/s^2",
    "_hz": "Hz",
    "_n": "N",
    "_nps": "N/s",
    "_nm": "N m",
}
"""The unit of a key by the end of its name."""

_IN_BRACKETS = re.compile(r" ?\(((?:1|m|s|N|Hz|rad)(?:[ /^0-9]|m|s|N|Hz|rad)*)\)")

_PROFILE = "<profile>"


@dataclass(frozen=True)
class Key:
    """A key of a scenario.

    Attributes:
        name: as `--set` takes it, with N for an index; `faults.N.ecu (ecu_crash)` where only that kind has it.
        unit: its unit; empty if it has none.
        allowed: allowed values, in words.
        default: its default; empty if there is none.
        required: whether it must be given.
        meaning: what it means.
    """

    name: str
    unit: str
    allowed: str
    default: str
    required: bool
    meaning: str


def keys(pattern: str = "*") -> list[Key]:
    """Return the keys whose name or kind matches a pattern; one without `*` or `?` may be any part of the name.

    A word that is in no name is looked for in what the keys mean.
    """
    part = pattern if re.search(r"[*?\[]", pattern) else f"*{pattern}*"
    schema = _plain_schema()
    found = [*_keys_of(schema, schema, ""), *_profile_keys(schema)]
    named = [key for key in found if any(fnmatch.fnmatchcase(key.name, each) for each in (part, f"{part} (*)"))]
    return named or [key for key in found if pattern.lower() in key.meaning.lower()]


@cache
def _plain_schema() -> dict[str, Any]:
    schema = Scenario.model_json_schema()
    # The loader takes it from the file's name.
    schema["required"].remove("name")
    return schema


def _keys_of(schema: Mapping[str, Any], owner: Mapping[str, Any], prefix: str, kind: str = "") -> Iterator[Key]:
    """Yield the keys of a table, and of the tables in it; in a table of a certain `kind`, all are marked with it."""
    for name, node in owner.get("properties", {}).items():
        path, target = f"{prefix}{name}", resolve(schema, node)
        if kind and name == "kind":
            continue
        if target.get("type") == "object" and "properties" in target:
            yield from _keys_of(schema, target, f"{path}.", kind)
        elif target.get("type") == "array" and "items" in target:
            yield _key(path, node, target, owner, kind)
            entry = resolve(schema, target["items"])
            if "discriminator" in entry:
                yield Key(f"{path}.N.kind", "", allowed(entry), "", True, "kind of the fault, which decides its keys.")
                yield from _keys_of_kinds(schema, entry, f"{path}.N.")
            else:
                yield from _keys_of(schema, entry, f"{path}.N.", kind)
        else:
            yield _key(path, node, target, owner, kind)


def _keys_of_kinds(schema: Mapping[str, Any], entry: Mapping[str, Any], prefix: str) -> Iterator[Key]:
    """Yield the keys that all kinds have, then those of each kind."""
    kinds = {kind: resolve(schema, {"$ref": ref}) for kind, ref in entry["discriminator"]["mapping"].items()}
    common = set.intersection(*(set(each["properties"]) for each in kinds.values()))
    first = next(iter(kinds.values()))
    yield from _keys_of(schema, _only(first, common - {"kind"}), prefix)
    for kind, each in kinds.items():
        yield from _keys_of(schema, _only(each, set(each["properties"]) - common), prefix, kind)


def _profile_keys(schema: Mapping[str, Any]) -> Iterator[Key]:
    """Yield the keys of a value that may change with time."""
    for kind in ("step", "sine"):
        yield from _keys_of(schema, schema["$defs"][kind.capitalize()], f"{_PROFILE}.", kind)


def _only(owner: Mapping[str, Any], names: set[str]) -> dict[str, Any]:
    return {**owner, "properties": {name: node for name, node in owner["properties"].items() if name in names}}


def _key(path: str, node: Mapping[str, Any], target: Mapping[str, Any], owner: Mapping[str, Any], kind: str) -> Key:
    name = path.rpartition(".")[2]
    meaning = str(node.get("description", ""))
    units = _IN_BRACKETS.findall(meaning)
    unit = next((text for end, text in _UNITS.items() if name.endswith(end)), units[-1] if units else "")
    default = node.get("default")
    return Key(
        name=f"{path} ({kind})" if kind else path,
        unit=unit,
        allowed=allowed(target),
        # TOML writes numbers, text, and lists of them as JSON does.
        default="" if default is None else json.dumps(default),
        required=name in owner.get("required", ()),
        meaning=_IN_BRACKETS.sub("", meaning) if unit in units else meaning,
    )


def editor_schema() -> dict[str, Any]:
    """Return the JSON schema (draft 2020-12) of a scenario's TOML file, for editors.

    It allows all that `bench.scenario.load` allows. What it cannot state is checked by `load` only: conditions between
    keys, the range of a profile over time, and whole numbers written with a decimal point.
    """
    schema = copy.deepcopy(_plain_schema())
    for definition in (schema, *schema["$defs"].values()):
        for name, node in definition.get("properties", {}).items():
            definition["properties"][name] = _for_editors(node)
            if "const" in node:
                # The kind of a table is never left out.
                definition["required"] = sorted({*definition.get("required", ()), name})
    return {"$schema": DIALECT, **schema, "title": "A scenario of platoon"}


def editor_schema_text() -> str:
    """Return `editor_schema` as JSON."""
    return json.dumps(editor_schema(), indent=2, allow_nan=False) + "\n"


def _for_editors(node: Mapping[str, Any]) -> dict[str, Any]:
    """Return a value's schema without what is not JSON Schema, a profile's with the plain number."""
    plain = {key: value for key, value in node.items() if key not in ("discriminator", "range", "title")}
    if "items" in plain:
        plain["items"] = _for_editors(plain["items"])
    if "anyOf" in plain:
        # TOML has no null.
        (choice,) = [_for_editors(each) for each in plain.pop("anyOf") if each.get("type") != "null"]
        plain = {**choice, **{key: value for key, value in plain.items() if value is not None}}
    if "range" in node:
        low, high = node["range"]
        plain["anyOf"] = [{"type": "number", "minimum": low, "maximum": high}, *plain.pop("oneOf")]
    return plain
