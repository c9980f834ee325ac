"""The form of all help pages: plain text at the terminal's width, nothing swallowed, nothing cut.

Typer's own pages take `[[faults]]` for markup, and break a command that is given as an example wherever a line ends.
"""

import inspect
import re
import sys
from collections.abc import Callable
from typing import Any, TypeVar

import typer
from typer.core import TyperCommand, TyperGroup

_Function = TypeVar("_Function", bound=Callable[..., Any])

WIDTH = 120
"""Columns of a help page at most; less on a narrower terminal."""

# The formatter breaks lines at spaces and hyphens of ASCII only.
_KEEP = str.maketrans({" ": "\N{NO-BREAK SPACE}", "-": "\N{NON-BREAKING HYPHEN}"})
_PLAIN = {ord(kept): chr(plain) for plain, kept in _KEEP.items()}
_HEADING = re.compile(r"\w+:")
_UNBROKEN = re.compile(r"`[^`\n]+`|(?<!\S)--?[a-z][\w-]* (?=\S)")


def _laid_out(text: str | None) -> str | None:
    """Return a text whose examples stay as they are: paragraphs with indented lines, `commands`, and --option VALUE."""
    if text is None:
        return None
    paragraphs = inspect.cleandoc(text).split("\n\n")
    return "\n\n".join(
        # This mark tells the formatter not to fill the paragraph.
        f"\b\n{each}"
        if re.search(r"^ ", each, re.MULTILINE)
        else _UNBROKEN.sub(lambda found: found[0].translate(_KEEP), each)
        for each in paragraphs
    )


class _Help:
    """The part that commands and groups have in common."""

    def _lay_out(self: Any) -> None:
        self.help, self.epilog = _laid_out(self.help), _laid_out(self.epilog)
        for parameter in self.params:
            parameter.help = _laid_out(parameter.help)

    def get_help(self: Any, ctx: Any) -> str:
        """Return the help page; on a terminal, print it with its headings in bold, and return nothing."""
        page = str(super().get_help(ctx)).translate(_PLAIN)  # type: ignore[misc]
        if not sys.stdout.isatty():
            return page
        from rich.text import Text

        from bench.cli.terminal import Terminal

        terminal = Terminal()
        for line in page.splitlines():
            heading = _HEADING.match(line)
            bold = heading.end() if heading else 0
            terminal.print(Text(line[:bold], "bold").append(line[bold:], "not bold"), soft_wrap=True)
        return ""

    def get_short_help_str(self: Any, limit: int = 45) -> str:  # noqa: ARG002 - nothing is cut
        """Return what stands in the list of commands: the first paragraph."""
        return " ".join((self.help or "").partition("\n\n")[0].split("\n"))


class HelpCommand(_Help, TyperCommand):
    """A command of `platoon`."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        """Lay out its help."""
        super().__init__(*args, **kwargs)
        self._lay_out()


class HelpGroup(_Help, TyperGroup):
    """A group of commands."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        """Lay out its help."""
        super().__init__(*args, **kwargs)
        self._lay_out()


class App(typer.Typer):
    """A group of commands, with help pages of this form."""

    def __init__(self, **settings: Any) -> None:
        """Create a group with typer's settings."""
        super().__init__(**{"cls": HelpGroup, "no_args_is_help": True, "rich_markup_mode": None, **settings})

    def command(self, name: str | None = None, **settings: Any) -> Callable[[_Function], _Function]:
        """Add a command."""
        return super().command(name, **{"cls": HelpCommand, **settings})
