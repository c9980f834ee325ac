"""The keys of scenarios as text."""

import shutil
import textwrap
from collections.abc import Iterator

from bench.errors import BadInput
from bench.scenario.errors import closest
from bench.scenario.keys import Key, keys

_INDENT = "    "


def described(pattern: str | None) -> str:
    """Return the keys that match a pattern, all if not given, a paragraph each.

    Raises:
        BadInput: none does.
    """
    found = keys(pattern or "*")
    if not found:
        parts = {part for key in keys() for part in (key.name, key.name.partition(" ")[0].rpartition(".")[2])}
        near = closest(str(pattern), sorted(parts))
        meant = f"did you mean {near}? " if near else ""
        raise BadInput(f"no key of a scenario matches {pattern!r}; {meant}all keys: platoon scenarios --keys")
    width = max(40, min(shutil.get_terminal_size().columns, 120))
    return "\n".join(line for key in found for line in _lines(key, width))


def _lines(key: Key, width: int) -> Iterator[str]:
    unit = f" [{key.unit}]" if key.unit else ""
    default = f" = {key.default}" if key.default else ", must be given" if key.required else ", optional"
    yield f"{key.name}{default}{unit}"
    for text in (key.meaning, f"allowed: {key.allowed}"):
        yield from textwrap.wrap(text, width, initial_indent=_INDENT, subsequent_indent=_INDENT, break_long_words=False)
