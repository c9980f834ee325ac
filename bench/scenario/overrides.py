"""`--set KEY=VALUE`: replace one value of a scenario from the command line."""

import re
import tomllib
from collections.abc import Sequence
from typing import Any

from bench.errors import BadInput

_INDEX = re.compile(r"[0-9]{1,9}")


def put(document: dict[str, Any], override: str) -> tuple[str | int, ...]:
    """Apply one `KEY=VALUE` to a TOML document and return the path of the key.

    Raises:
        BadInput: not `KEY=VALUE`, not a TOML value, or a key inside a value that cannot contain it. Validation checks
            later whether a scenario has the key and allows the value.
    """
    key, equals, value = override.partition("=")
    dotted = re.sub(r"\[(\d+)\]", r".\1", key.strip())
    parts = [int(part) if _INDEX.fullmatch(part) else part for part in dotted.split(".")]
    if not equals or not all(isinstance(part, int) or re.fullmatch(r"[A-Za-z_]\w*", part) for part in parts):
        raise BadInput(f"--set {override}: expected KEY=VALUE, e.g. --set platoon.gap_m=12.0")
    node: Any = document
    for depth, part in enumerate(parts[:-1]):
        node = _child(node, part, override, parts[:depth])
    last = parts[-1]
    if isinstance(node, list) and isinstance(last, int):
        _child(node, last, override, parts[:-1])
        node[last] = _value(value.strip(), override)
    elif isinstance(node, dict) and isinstance(last, str):
        node[last] = _value(value.strip(), override)
    else:
        raise BadInput(_cannot_hold(node, last, override, parts[:-1]))
    return tuple(parts)


def _child(node: Any, part: str | int, override: str, path: Sequence[str | int]) -> Any:
    """Return the value at `part` of `node`; create a missing table."""
    if isinstance(node, dict) and isinstance(part, str):
        return node.setdefault(part, {})
    if isinstance(node, list) and isinstance(part, int):
        if part < len(node):
            return node[part]
        where = ".".join(map(str, path))
        raise BadInput(f"--set {override}: {where} has {len(node)} entries; allowed index: 0 to {len(node) - 1}")
    raise BadInput(_cannot_hold(node, part, override, path))


def _cannot_hold(node: Any, part: str | int, override: str, path: Sequence[str | int]) -> str:
    kinds: dict[type, str] = {dict: "a table", list: "a list (give an index)"}
    kind = kinds.get(type(node), f"the value {node!r}")
    holder = ".".join(map(str, path)) or "a scenario"
    return f"--set {override}: {holder} is {kind} and cannot contain {part!r}"


def _value(text: str, override: str) -> Any:
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except (ValueError, RecursionError) as error:
        # A shell removes quotes, so a bare word is a string.
        if re.fullmatch(r"[A-Za-z][\w.-]*", text):
            return text
        raise BadInput(f"--set {override}: {text!r} is not a TOML value ({error})") from error
