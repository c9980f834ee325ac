"""`--set KEY=VALUE`: one value of a scenario replaced from the command line."""

import re
import tomllib
from collections.abc import Sequence
from typing import Any

from bench.errors import BadInput


def put(document: dict[str, Any], override: str) -> tuple[str | int, ...]:
    """Put one `KEY=VALUE` into a TOML document and return the key's path.

    Raises:
        BadInput: for what is no `KEY=VALUE`, no TOML value, or a key inside something that cannot hold it.
            Whether a scenario has the key and allows the value is for validation to tell.
    """
    key, equals, value = override.partition("=")
    dotted = re.sub(r"\[(\d+)\]", r".\1", key.strip())
    parts = [int(part) if part.isdigit() else part for part in dotted.split(".")]
    if not equals or not all(isinstance(part, int) or re.fullmatch(r"[A-Za-z_]\w*", part) for part in parts):
        raise BadInput(f"--set {override}: want KEY=VALUE, for example --set platoon.gap_m=12.0")
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
    """Return what `part` names inside `node`; a table that is not there yet is made."""
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
    return f"--set {override}: {holder} is {kind} and cannot hold {part!r}"


def _value(text: str, override: str) -> Any:
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except (ValueError, RecursionError) as error:
        # A shell takes the quotes off, so a bare word is text.
        if re.fullmatch(r"[A-Za-z][\w.-]*", text):
            return text
        raise BadInput(f"--set {override}: {text!r} is no TOML value ({error})") from error
