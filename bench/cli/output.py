r"""Everything that reaches the terminal passes through here, so that text from elsewhere cannot control it.

Names, units, reasons, file names and messages come from logs, FMUs, DBC files, scenarios and processes of others. On a
terminal an escape sequence in them would set its title, fill its clipboard or hide what is said; a bidirectional
control would reorder it. `escaped` shows such characters as Python writes them (`\x1b`), `guarded` applies it to both
standard streams, and only rich, which draws our own colours and bars, writes past it: through `Terminal`
(`bench.cli.terminal`), which escapes the text that it is given. JSON keeps every value exactly, by the escapes of its
own (`say_json`).
"""

from __future__ import annotations

import io
import json
import re
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Any, TextIO, cast

import typer
from typer.core import TyperGroup

from bench.cli.usage import usage_problem

LONGEST_LINE = 4000
"""Characters of a line that are shown; a terminal of usual width fills its screen with them."""

# Printable by Unicode's categories, but shown as nothing: fillers, joiners, variation selectors.
_INVISIBLE = "\u034f\u115f\u1160\u17b4\u17b5\u2800\u3164\uffa0\ufe00-\ufe0f\U000e0100-\U000e01ef"
_UNSEEN = re.compile(f"[{_INVISIBLE}]")


def escaped(text: str) -> str:
    r"""Return `text` with every character that a terminal would not show as itself as an escape: \x1b, \u202e.

    Newlines stay, and a tab becomes a space. What is not printable by `str.isprintable` is escaped: C0, DEL, C1, format
    characters (bidirectional controls, zero width), other separators than the space, lone surrogates, unassigned.
    """
    if text.isprintable() and not _UNSEEN.search(text):
        return text
    return "".join(map(_escaped_character, text))


def _escaped_character(character: str) -> str:
    if character == "\n" or (character.isprintable() and not _UNSEEN.match(character)):
        return character
    return " " if character == "\t" else character.encode("unicode_escape").decode()


def shown(text: str) -> str:
    """Return `text` escaped, and each of its lines cut after `LONGEST_LINE` characters, saying how many follow."""
    if len(text) <= LONGEST_LINE:
        return escaped(text)
    return "\n".join(_cut(line) for line in text.split("\n"))


def _cut(line: str) -> str:
    rest = len(line) - LONGEST_LINE
    return escaped(line) if rest <= 0 else f"{escaped(line[:LONGEST_LINE])} ... ({rest} characters more)"


def one_line(text: str) -> str:
    """Return `text` as `shown` does, its newlines escaped too: a name cannot pretend to be lines of ours."""
    return shown(text.replace("\n", "\\n"))


def message(text: str) -> str:
    """Return what is to be said to a person: `platoon: `, and further lines indented.

    So no name or text of others that it cites, whatever lines it has, looks like a message of ours.
    """
    return "platoon: " + text.replace("\n", "\n  ")


class _Guard(io.TextIOBase):
    """A standard stream that shows control characters instead of obeying them.

    It has no `buffer`, so that nobody writes past it.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        visible = shown(text)
        try:
            self._stream.write(visible)
        except UnicodeEncodeError as error:
            self._stream.write(visible.encode(error.encoding, "backslashreplace").decode(error.encoding))
        return len(text)

    def flush(self) -> None:
        self._stream.flush()

    def isatty(self) -> bool:
        return self._stream.isatty()

    def fileno(self) -> int:
        return self._stream.fileno()

    def writable(self) -> bool:
        return True

    @property
    def encoding(self) -> str:  # type: ignore[override] # an attribute in typeshed
        return self._stream.encoding

    @property
    def rich_proxied_file(self) -> TextIO:
        """Where rich writes what it has drawn; rich looks for this name."""
        stream = self._stream
        while (inner := getattr(stream, "rich_proxied_file", None)) is not None:
            stream = inner
        return stream


def guard() -> None:
    """Escape all that is written to the standard streams from here on, by whoever writes it."""
    sys.stdout, sys.stderr = (
        stream if isinstance(stream, _Guard) else cast(TextIO, _Guard(stream)) for stream in (sys.stdout, sys.stderr)
    )


@contextmanager
def guarded() -> Iterator[None]:
    """Do as `guard` while the context lasts."""
    streams = sys.stdout, sys.stderr
    guard()
    guards = sys.stdout, sys.stderr
    try:
        yield
    finally:
        # typer puts a stream of its own in place where the reader of a pipe has left.
        if sys.stdout is guards[0]:
            sys.stdout = streams[0]
        if sys.stderr is guards[1]:
            sys.stderr = streams[1]


class GuardedGroup(TyperGroup):
    """The commands, run with guarded streams; in usage errors, which rich draws, arguments are escaped."""

    def main(self, *args: Any, **kwargs: Any) -> Any:
        """Run the command of the arguments."""
        with guarded():
            return super().main(*args, **kwargs)

    def make_context(self, *args: Any, **kwargs: Any) -> Any:
        """Read the options before a command."""
        with _readable_usage_errors():
            return super().make_context(*args, **kwargs)

    def invoke(self, *args: Any, **kwargs: Any) -> Any:
        """Read a command's arguments and run it."""
        with _readable_usage_errors():
            return super().invoke(*args, **kwargs)


@contextmanager
def _readable_usage_errors() -> Iterator[None]:
    try:
        yield
    except typer.TyperException as error:
        error.message = shown(usage_problem(error) or error.message)
        raise


def say_json(value: Any, *, indent: int) -> None:
    """Print a value as JSON on standard output: exact, of any length, and in printable ASCII characters only."""
    stream = sys.stdout
    stream = stream.rich_proxied_file if isinstance(stream, _Guard) else stream
    stream.write(json.dumps(value, indent=indent) + "\n")


def say_table(rows: Iterable[tuple[str, ...]], aligned: str) -> None:
    """Print rows in columns on standard output.

    Args:
        rows: the cells of each.
        aligned: `<` (left) or `>` (right) for each column.
    """
    cells = [tuple(map(one_line, row)) for row in rows]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    for row in cells:
        columns = (f"{text:{sign}{width}}" for text, sign, width in zip(row, aligned, widths, strict=True))
        typer.echo("  ".join(columns).rstrip())
