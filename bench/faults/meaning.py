"""The meanings of a class's keys, from the section `Attributes` of its docstring and those of its base classes."""

import inspect
import re
from typing import Any

_ENTRY = re.compile(r"    (\w+): (.*)")


def meanings(owner: type) -> dict[str, str]:
    """Return what each documented attribute of a class means; its `same_keys_as` names another class that says it."""
    found: dict[str, str] = {}
    for each in (*reversed(owner.__mro__), *filter(None, [getattr(owner, "same_keys_as", None)])):
        found |= _attributes(each.__doc__ or "")
    return found


def describe(schema: dict[str, Any], owner: type) -> None:
    """Add the meanings to the JSON schema of a class, which pydantic calls this for; the class keeps its summary."""
    schema["description"] = inspect.cleandoc(owner.__doc__ or "").partition("\n\n")[0].replace("\n", " ")
    known = meanings(owner)
    for name, node in schema.get("properties", {}).items():
        if name in known:
            node["description"] = known[name]


def _attributes(docstring: str) -> dict[str, str]:
    section = inspect.cleandoc(docstring).partition("Attributes:\n")[2].partition("\n\n")[0]
    found: dict[str, str] = {}
    last = ""
    for line in section.splitlines():
        entry = _ENTRY.fullmatch(line)
        if entry:
            last = entry[1]
            found[last] = entry[2]
        elif last:
            found[last] += f" {line.strip()}"
    return found
