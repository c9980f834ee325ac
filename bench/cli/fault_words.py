"""Faults as they are typed at the command line."""

import tomllib
from collections.abc import Sequence
from typing import Any

from pydantic.fields import FieldInfo

from bench.errors import BadInput
from bench.faults.kinds import kinds
from bench.scenario.errors import closest

_OF_ALL = ("kind", "at_s", "for_s")


def parse(kind: str, keys: Sequence[str]) -> dict[str, Any]:
    """Return the table of `[[faults]]` that a kind and `KEY=VALUE` each stand for; a bare word is text.

    Raises:
        BadInput: no such kind or key, or not KEY=VALUE.
    """
    known = kinds()
    if kind not in known:
        near = closest(kind, known)
        meant = f"did you mean {near}? " if near else ""
        raise BadInput(f"no kind of fault {kind!r}; {meant}allowed: {', '.join(known)}")
    fault: dict[str, Any] = {"kind": kind}
    allowed = [key for key in known[kind].model_fields if key != "kind"]
    for text in keys:
        key, equals, value = text.partition("=")
        if not equals or key not in allowed:
            raise BadInput(f"{text}: {kind} takes KEY=VALUE with a KEY of {', '.join(allowed)}")
        if key in fault:
            raise BadInput(f"{text}: {key} is given twice")
        fault[key] = _value(value)
    return fault


def _value(text: str) -> Any:
    try:
        return tomllib.loads(f"v = {text}")["v"]
    except (ValueError, RecursionError):
        # The bench says what is wrong with it.
        return text


def _shown(key: str, field: FieldInfo) -> str:
    if field.is_required():
        return key
    return f"[{key}]" if field.default is None else f"{key}={field.default}"


def describe_kinds() -> str:
    """Return every kind of fault with its keys and what it does, a paragraph each."""
    lines = []
    for kind, model in kinds().items():
        keys = [_shown(name, field) for name, field in model.model_fields.items() if name not in _OF_ALL]
        summary = (model.__doc__ or "").partition("\n")[0]
        lines.append(f"{kind:16}  {summary}\n{'':16}  {' '.join(keys)}\n")
    return "".join(lines) + f"{'all':16}  [at_s] now if not given, [for_s] to the end of the run\n"
