"""The label of a run: a few words that tell it from others."""

import re
import unicodedata

from bench.errors import BadInput

MAX_LABEL = 60
"""Maximum number of characters of a label."""

LABEL = "label"
"""Key of the label in the metadata of a log."""


_ESCAPE = re.compile(r"(?:\x1b\[|\x9b)[0-?]*[ -/]*[@-~]|(?:\x1b\]|\x9d)[^\x07\x1b\x9c]*(?:\x07|\x1b\\|\x9c)?")
"""A terminal's control sequence (ECMA-48): colours, cursor, title."""


def cleaned(text: str) -> str:
    """Return a text as one line: control characters as spaces, without control sequences and invisible characters."""
    visible = (" " if c.isspace() or unicodedata.category(c) == "Cc" else c for c in _ESCAPE.sub("", text))
    return " ".join("".join(c for c in visible if c == " " or c.isprintable()).split())


def shortened(text: str, most: int) -> str:
    """Return a text of at most `most` characters, with an ellipsis if it is longer."""
    return text if len(text) <= most else f"{text[: most - 1].rstrip()}…"


def checked_label(text: str) -> str:
    """Return a label as a user has given it, cleaned.

    Raises:
        BadInput: nothing of it is left, or it is too long.
    """
    label = cleaned(text)
    if not label:
        raise BadInput(f"--label {text!r}: nothing to read in it; give a few words, e.g. --label 'soft gains'")
    if len(label) > MAX_LABEL:
        raise BadInput(f"--label: {len(label)} characters; allowed: at most {MAX_LABEL}")
    return label
