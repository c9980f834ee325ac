"""Error messages for scenarios: location, key, value, allowed range and remedy; all errors at once."""

import difflib
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import tomli_w
from pydantic import ValidationError
from pydantic_core import ErrorDetails

Path = tuple[str | int, ...]

MOST_PROBLEMS = 20
"""Number of errors that a message lists; it says how many more there are."""

_KEY = re.compile(r"^\s*([\w\"'-]+(?:\s*\.\s*[\w\"'-]+)*)\s*=\s*(.*)$")
_HEADER = re.compile(r"^\s*(\[\[?)\s*([\w\"'. -]+?)\s*\]\]?\s*(?:#.*)?$")


@dataclass(frozen=True)
class Source:
    """Origin of the values of a scenario, or of another document that is validated like one.

    Attributes:
        name: the file.
        text: content of the file.
        document: parsed values with the overrides applied.
        given: the command-line option behind each overridden key.
        noun: what the document is.
    """

    name: str
    text: str
    document: Mapping[str, Any]
    given: Mapping[Path, str]
    noun: str = "scenario"

    @cached_property
    def _lines(self) -> dict[Path, int]:
        return key_lines(self.text)

    def place(self, path: Path) -> str:
        """Return the option or line that the value at `path` comes from; empty if unknown."""
        for key, option in self.given.items():
            if path[: len(key)] == key or key[: len(path)] == path:
                return option
        lines = self._lines
        for length in range(len(path), 0, -1):
            if path[:length] in lines:
                return f"line {lines[path[:length]]}"
        return ""


def explain(error: ValidationError, source: Source, schema: Mapping[str, Any]) -> str:
    """Return one message with every problem of a scenario.

    Args:
        error: the validation error of pydantic.
        source: file and options of the scenario.
        schema: JSON schema of a scenario, for the allowed ranges and keys.
    """
    details = error.errors(include_url=False)
    real = [detail for detail in details if not _is_echo(detail, details)]
    # Those of values together come as one detail, and only if there are no others.
    problems = [problem for detail in real[:MOST_PROBLEMS] for problem in _problems(detail, schema, source.noun)]
    number = len(problems) if len(real) <= MOST_PROBLEMS else len(real)
    lines = []
    for path, text in problems[:MOST_PROBLEMS]:
        place = source.place(path)
        lines.append(f"  {place}{': ' if place else ''}{dotted(path)} {text}")
    if number > len(lines):
        lines.append(f"  and {number - len(lines)} more")
    count = "1 error" if number == 1 else f"{number} errors"
    return "\n".join([f"{source.noun.capitalize()} {source.name} has {count}:", *lines])


def explain_fault(error: ValidationError, schema: Mapping[str, Any]) -> str:
    """Return every problem of one fault, in the words of `explain`; `schema` is the JSON schema of faults."""
    found = [problem for detail in error.errors(include_url=False) for problem in _problems(detail, schema)]
    return "; ".join(f"{dotted(path) or 'the fault'} {text}" for path, text in found)


def closest(name: str, names: Iterable[str]) -> str | None:
    """Return the one of `names` closest to `name`; None if none is similar."""
    found = difflib.get_close_matches(name, list(names), n=1, cutoff=0.6)
    return found[0] if found else None


def dotted(path: Sequence[str | int]) -> str:
    """Return a path as a user writes it: `vehicles.0.x_m`."""
    return ".".join(map(str, path))


def key_lines(text: str) -> dict[Path, int]:
    """Return the line number of every key and table of a scenario's TOML text.

    The TOML reader of the standard library keeps no line numbers. Inline tables are found down to the entries of a
    list (one per line); anything deeper is reported with the line of its parent.
    """
    lines: dict[Path, int] = {}
    entries: dict[Path, int] = {}
    table: Path = ()
    in_list: Path | None = None
    for number, line in enumerate(text.splitlines(), 1):
        if header := _HEADER.match(line):
            table = _enter(_parts(header[2]), header[1] == "[[", entries)
            lines.setdefault(table, number)
        elif key := _KEY.match(line):
            path = table + _parts(key[1])
            lines.setdefault(path, number)
            in_list = path if key[2].split("#")[0].strip() == "[" else None
        elif in_list and line.lstrip().startswith("{"):
            entries[in_list] = entries.get(in_list, -1) + 1
            lines.setdefault((*in_list, entries[in_list]), number)
    return lines


def _parts(key: str) -> Path:
    return tuple(part.strip().strip("\"'") for part in key.split("."))


def _enter(key: Path, is_entry: bool, entries: dict[Path, int]) -> Path:
    """Return the path of a table header, with the indices of the list entries it belongs to."""
    if is_entry:
        entries[key] = entries.get(key, -1) + 1
    path: Path = ()
    for part in key:
        path = (*path, part)
        if path in entries:
            path = (*path, entries[path])
    return path


def _is_echo(detail: ErrorDetails, details: Sequence[ErrorDetails]) -> bool:
    """Whether pydantic reports a list as too short only because it does not count rejected entries."""
    path = detail["loc"]
    return detail["type"] == "too_short" and any(
        len(other["loc"]) > len(path) and other["loc"][: len(path)] == path for other in details
    )


def _problems(detail: ErrorDetails, schema: Mapping[str, Any], noun: str = "scenario") -> list[tuple[Path, str]]:
    """Return the problems behind one pydantic error, each with the path of its key."""
    context = detail.get("ctx", {})
    if detail["type"] == "together":
        return [(tuple(path), text) for path, text in context["problems"]]
    node = _schema_at(schema, detail["loc"])
    path = _as_written(schema, detail["loc"])
    if detail["type"] == "value_error":
        text = str(context["error"])
        path = _named_in(text, path, node)
        return [(path, text.removeprefix(str(path[-1]) if path else "").lstrip())]
    return [(path, _text(detail, path, node, schema, noun))]


def _named_in(text: str, path: Path, node: Mapping[str, Any]) -> Path:
    """Return the path of the setting that a check names first or most exactly, so that its line can be shown."""
    named = [key for key in node.get("properties", {}) if re.search(rf"\b{key}\b", text)]
    first = text.partition(" ")[0]
    return (*path, first if first in named else max(named, key=len)) if named else path


def _text(detail: ErrorDetails, path: Path, node: Mapping[str, Any], schema: Mapping[str, Any], noun: str) -> str:
    kind = detail["type"]
    if kind in ("extra_forbidden", "unexpected_keyword_argument"):
        keys = sorted(_schema_at(schema, detail["loc"][:-1]).get("properties", {}))
        near = closest(str(path[-1]), keys)
        meant = f"did you mean {dotted((*path[:-1], near))}? " if near else ""
        return f"is not a {noun} key; {meant}allowed: {', '.join(keys)}"
    if kind == "union_tag_not_found":
        return f"has no kind; allowed: {allowed(node)}"
    if kind == "missing":
        return f"is missing; allowed: {allowed(node)}"
    given = _shown(detail["input"])
    if kind in ("too_short", "too_long"):
        return f"has {detail['ctx']['actual_length']} entries; allowed: {allowed(node)}"
    if kind == "union_tag_invalid":
        return f"has the kind {_shown(detail['input'].get('kind'))}; allowed: {allowed(node)}"
    return f"= {given} is not allowed; allowed: {allowed(node)}"


def _shown(value: Any) -> str:
    """Return a value as TOML shows it, shortened."""
    try:
        text = tomli_w.dumps({"v": value}).removeprefix("v = ").strip()
    except TypeError:
        text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _schema_at(schema: Mapping[str, Any], path: Sequence[str | int]) -> Mapping[str, Any]:
    """Return the part of a JSON schema that describes the value at `path`; empty if there is none."""
    node = resolve(schema, schema)
    for part in path:
        node = _child(schema, node, part)
    return node


def _as_written(schema: Mapping[str, Any], path: Sequence[str | int]) -> Path:
    """Return a path of pydantic's without the kinds of tables, which are no part of a key."""
    node = resolve(schema, schema)
    written: Path = ()
    for part in path:
        if part in node.get("properties", {}) or part not in _kinds(node):
            written = (*written, part)
        node = _child(schema, node, part)
    return written


def _kinds(node: Mapping[str, Any]) -> Mapping[str, str]:
    """Return the reference to each kind of table that a value can be; empty if it is no such table."""
    found: Mapping[str, str] = node.get("discriminator", {}).get("mapping", {})
    return found


def _child(schema: Mapping[str, Any], node: Mapping[str, Any], part: str | int) -> Mapping[str, Any]:
    """Return the schema of a part of the value that `node` describes; empty if it has no such part."""
    if isinstance(part, int):
        prefix = node.get("prefixItems", [])
        return resolve(schema, prefix[part] if part < len(prefix) else node.get("items", {}))
    if part in node.get("properties", {}):
        return resolve(schema, node["properties"][part])
    return resolve(schema, {"$ref": _kinds(node)[part]} if part in _kinds(node) else {})


def resolve(schema: Mapping[str, Any], node: Mapping[str, Any]) -> Mapping[str, Any]:
    """Follow references, and return the value type of an optional value."""
    while True:
        if "$ref" in node:
            node = schema["$defs"][node["$ref"].rpartition("/")[2]]
        elif "anyOf" in node and "discriminator" not in node:
            node = next(choice for choice in node["anyOf"] if choice.get("type") != "null")
        else:
            return node


def allowed(node: Mapping[str, Any]) -> str:
    """Return the values that a JSON schema allows, as text."""
    if "discriminator" in node and "range" not in node:
        return f"one of {', '.join(node['discriminator']['mapping'])}"
    if "discriminator" in node:
        low, high = node.get("range", ("-inf", "inf"))
        return f'a number from {low} to {high}, or a table {{kind = "step", ...}} or {{kind = "sine", ...}}'
    if "enum" in node:
        return ", ".join(map(str, node["enum"]))
    kind = node.get("type")
    if kind == "array":
        if "prefixItems" in node:
            return f"a list of {len(node['prefixItems'])}, each {allowed(node['prefixItems'][0])}"
        return f"a list of {node.get('minItems', 0)} to {node.get('maxItems', 'any number of')} entries"
    if kind == "object":
        keys = ", ".join(node.get("properties", {}))
        return f"a table with {keys}" if keys else "a table of NAME = text"
    if kind == "string":
        if "maxLength" in node:
            return f"text of at most {node['maxLength']} characters"
        return f"text that matches {node['pattern']}" if "pattern" in node else "text"
    if kind == "boolean":
        return "true or false"
    noun = {"integer": "a whole number", "number": "a finite number"}.get(str(kind), "another value")
    return " ".join([noun, *_bounds(node)])


def _bounds(node: Mapping[str, Any]) -> list[str]:
    if "minimum" in node and "maximum" in node:
        return [f"from {node['minimum']:.10g} to {node['maximum']:.10g}"]
    words = {
        "minimum": "at least",
        "exclusiveMinimum": "above",
        "maximum": "at most",
        "exclusiveMaximum": "below",
    }
    bounds = [f"{word} {node[key]:.10g}" for key, word in words.items() if key in node]
    return [" and ".join(bounds)] if bounds else []
