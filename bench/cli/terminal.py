"""What rich draws on the terminal: tables and progress bars in our own colours, with all text escaped.

Apart from `bench.cli.output`, because no command should wait for rich that does not draw with it.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from rich.console import (
    Console,  # noqa: TID251 - the one place
    ConsoleOptions,
    ConsoleRenderable,
    RenderHook,
    RenderResult,
)
from rich.segment import Segment
from rich.text import Text

from bench.cli.output import escaped, guarded, shown

if TYPE_CHECKING:  # tables are drawn without it
    from rich.progress import Progress, ProgressColumn  # noqa: TID251 - the one place


class Terminal(Console):
    """A rich console that escapes what it is given and takes no text for markup; styles come from our code only."""

    def __init__(self, *, stderr: bool = False, width: int | None = None) -> None:
        """Write to standard output or to standard error, as wide as the terminal unless `width` is given."""
        super().__init__(stderr=stderr, width=width, markup=False, emoji=False, highlight=False)
        self.push_render_hook(_EscapeSegments())

    def render_str(self, text: str, **how: Any) -> Text:
        """Return a string as rich lays it out."""
        return super().render_str(shown(text), **{**how, "markup": False, "emoji": False})


class _EscapeSegments(RenderHook):
    """Escapes what was laid out without `Terminal.render_str`, whose column is then too wide."""

    def process_renderables(self, renderables: list[ConsoleRenderable]) -> list[ConsoleRenderable]:
        return [_Escaped(renderable) for renderable in renderables]


class _Escaped:
    def __init__(self, content: ConsoleRenderable) -> None:
        self._content = content

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        for segment in console.render(self._content, options):
            yield segment if segment.control else Segment(escaped(segment.text), segment.style)


@contextmanager
def progress(*columns: ProgressColumn, transient: bool = False) -> Iterator[Progress]:
    """Show progress bars on standard error while the context lasts; what is printed meanwhile stays above them."""
    from rich.progress import Progress  # noqa: TID251 - the one place

    # rich replaces the standard streams by its own, which obey escape sequences: these are guarded again.
    with Progress(*columns, console=Terminal(stderr=True), transient=transient) as bars, guarded():
        yield bars
