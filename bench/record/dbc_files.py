"""The DBC file of each bus of a log: the attached files, and their codecs.

The channel of a bus's raw frames, `/can/<bus>`, names in its metadata the attachment that is the bus's DBC file. Older
logs do not name it: there `v2v.dbc` describes v2v and `vehicle.dbc` every other bus.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from pathlib import Path

from mcap.records import Channel

from bench.bus.codec import Codec
from bench.errors import BadInput
from bench.names import V2V
from bench.record.topic_reader import LogDamaged

METADATA = "dbc"
"""Key in the metadata of a bus's channel: the name of the attachment; empty if no DBC file describes the bus."""


def attached_files(codecs: Mapping[str, Codec], others: Mapping[str, bytes]) -> tuple[dict[str, str], dict[str, bytes]]:
    """Return the DBC attachments of a new log: bus -> name of the attachment, and all attachments by name.

    Different files of the same name get different names.

    Args:
        codecs: codec of each bus.
        others: other attachments.
    """
    names: dict[str, str] = {}
    files = dict(others)
    named: dict[tuple[str, bytes], str] = {}
    for bus, codec in codecs.items():
        if not codec.dbc:
            names[bus] = ""
            continue
        file = codec.file_name, codec.dbc
        if file not in named:
            named[file] = _free_name(codec, bus, files)
        names[bus] = named[file]
        files[names[bus]] = codec.dbc
    return names, files


def _free_name(codec: Codec, bus: str, files: Mapping[str, bytes]) -> str:
    path, tried = Path(codec.file_name), 1
    name = path.name
    while files.get(name, codec.dbc) != codec.dbc:
        name = f"{path.stem}-{bus}{tried if tried > 1 else ''}{path.suffix}"
        tried += 1
    return name


class DbcFiles:
    """The DBC files attached to a log."""

    def __init__(self, log: Path, channels: Mapping[str, Channel], attachments: Mapping[str, bytes]) -> None:
        """Take a log's channels (topic -> channel) and attachments (name -> content)."""
        self._log = log
        self._channels = channels
        self._attachments = attachments
        self._codecs: dict[str, Codec | None] = {}

    def content(self, bus: str) -> bytes | None:
        """Return the DBC file attached for `bus`, None if absent."""
        return self._attachments.get(self._name(bus))

    def codec(self, bus: str) -> Codec | None:
        """Return the codec of the DBC file attached for `bus`; None if absent or unusable.

        An unusable file gives one warning, `LogDamaged`; data that needs no DBC file stays readable.
        """
        name = self._name(bus)
        if name not in self._attachments:
            return None
        if name not in self._codecs:
            try:
                self._codecs[name] = Codec.from_bytes(self._attachments[name], name)
            except BadInput as error:
                self._codecs[name] = None
                warnings.warn(f"the DBC file attached to {self._log} is ignored: {error}", LogDamaged, stacklevel=3)
        return self._codecs[name]

    def _name(self, bus: str) -> str:
        channel = self._channels.get(f"/can/{bus}")
        old = "v2v.dbc" if bus == V2V else "vehicle.dbc"
        return str(channel.metadata.get(METADATA, old)) if channel else old
