"""How much of everything a log may hold; `check` refuses more with one message, before any work on it.

A run with 16 vehicles has 1,500 channels, some 50 schemas, 4 attachments of 200 kB, and 40 pairs of metadata.
"""

from __future__ import annotations

from pathlib import Path

from bench.errors import BadInput
from bench.mcap.contents import Contents

MOST_CHANNELS = 10_000
MOST_SCHEMAS = 10_000
MOST_ATTACHMENTS = 1_000
MOST_ATTACHED_BYTES = 64 * 1024 * 1024
"""Bytes of all attachments together; they are held in memory."""
MOST_METADATA = 10_000
"""Pairs of key and value, of all records together."""
MOST_METADATA_CHARACTERS = 4 * 1024 * 1024
LONGEST_NAME = 1_000
"""Characters of the name of a topic, schema or attachment, and of a key of metadata."""


def check(path: Path, contents: Contents) -> None:
    """Check that a log is not beyond what is read.

    Raises:
        BadInput: it is; the message says what, how much and the limit.
    """
    pairs = [pair for record in contents.metadata.values() for pair in record.items()]
    of_channels = [pair for channel in contents.channels.values() for pair in channel.metadata.items()]
    names = [
        *(channel.topic for channel in contents.channels.values()),
        *(schema.name for schema in contents.schemas.values()),
        *contents.attachments,
        *(key for key, _ in pairs),
    ]
    for what, found, most in (
        ("channels", len(contents.channels), MOST_CHANNELS),
        ("schemas", len(contents.schemas), MOST_SCHEMAS),
        ("attachments", len(contents.attachments), MOST_ATTACHMENTS),
        ("bytes of attachments", sum(map(len, contents.attachments.values())), MOST_ATTACHED_BYTES),
        ("pairs of metadata", len(pairs), MOST_METADATA),
        ("characters of metadata", _characters(pairs), MOST_METADATA_CHARACTERS),
        ("characters of channels' metadata", _characters(of_channels), 4 * MOST_METADATA_CHARACTERS),
        ("characters in a name", max(map(len, names), default=0), LONGEST_NAME),
    ):
        if found > most:
            raise BadInput(f"{path} cannot be read: it has {found} {what}; allowed: at most {most}")


def _characters(pairs: list[tuple[str, str]]) -> int:
    return sum(len(key) + len(value) for key, value in pairs)
