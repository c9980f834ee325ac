"""Words of messages about a user's ECU: names that do not exist, values that do not fit."""

from collections.abc import Callable, Iterable
from dataclasses import fields
from numbers import Real
from typing import Any

import numpy as np

from bench.ecu.user_code import place_of
from bench.errors import EcuError
from bench.scenario.errors import closest

NUMBERS = (Real, np.bool_)
"""What a signal's value may be."""


def unknown(what: str, name: object, names: Iterable[str], of: str = "", near: Iterable[str] | None = None) -> str:
    """Return the words for a name that does not exist among `names`, with the closest one of `near`."""
    names = list(names)
    found = closest(str(name), names if near is None else near)
    meant = f"did you mean {found}? " if found else ""
    kind = f"a{'n' if what[0] in 'aeiou' else ''} {what}{f' {of}' if of else ''}"
    return f"{name}, which is not {kind}; {meant}allowed: {', '.join(names)}"


def shown(value: object) -> str:
    """Return a value as text for a message: what it is, shortened."""
    if value is None or isinstance(value, (bool, int, float, complex, str)):
        text = repr(value)
        return text if len(text) <= 60 else f"{text[:57]}..."
    kind = type(value).__name__
    return f"{'an' if kind[:1].lower() in 'aeiou' else 'a'} {kind}"


def fits(value: object, kind: type) -> bool:
    """Return whether what a method has returned is a `kind`, a dataclass, whose fields are numbers."""
    return isinstance(value, kind) and all(isinstance(getattr(value, name), NUMBERS) for name in kind.__match_args__)  # type: ignore[attr-defined]


def misfit(method: Callable[..., Any], value: object, kind: type) -> EcuError:
    """Return the error of a method that returned a value that does not fit."""
    name, where = method.__qualname__, place_of(method)
    if not isinstance(value, kind):
        allowed = ", ".join(field.name for field in fields(kind))
        return EcuError(f"{name} returned {shown(value)}; allowed: {kind.__name__}({allowed}){where}")
    wrong = {field.name: getattr(value, field.name) for field in fields(kind)}
    each = next(f"{key} = {shown(each)}" for key, each in wrong.items() if not isinstance(each, NUMBERS))
    return EcuError(f"{name} returned a {kind.__name__} with {each}; allowed: a number{where}")
