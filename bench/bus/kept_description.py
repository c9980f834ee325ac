"""What a DBC file says, kept in a file between runs: reading it anew loads cantools in each start of a run.

The text depends only on the DBC's content and on the code that reads it, whose hash names the file.
"""

import hashlib
from contextlib import suppress
from functools import cache
from importlib.util import find_spec
from pathlib import Path

from bench.bus.description import BusDescription, as_json, from_json
from bench.compiled.finder import library_folder
from bench.compiled.kept import keep

_READERS = tuple(Path(__file__).with_name(name) for name in ("dbc.py", "description.py"))


def description_of(dbc: bytes, to_be_kept: bool) -> BusDescription:
    """Return what a DBC file says, from its kept file if there is one.

    Args:
        dbc: its content.
        to_be_kept: whether a file is written if there is none: for the DBC files of the bench, not those of any log.

    Raises:
        BadInput: as `bench.bus.dbc.describe`.
    """
    key = _key(dbc)
    file = library_folder().with_name("dbc") / f"{key}.json"
    with suppress(OSError):
        mark, _, text = file.read_bytes().partition(b"\n")
        if mark == _mark(key, text):
            return from_json(text)
    # Imported here: a run whose DBC files are known needs no cantools.
    from bench.bus.dbc import describe

    bus = describe(dbc)
    if to_be_kept:
        text = as_json(bus)
        with suppress(OSError):
            keep(_mark(key, text) + b"\n" + text, file)
    return bus


def _key(dbc: bytes) -> str:
    return hashlib.sha256(_readers_hash() + dbc).hexdigest()[:24]


@cache
def _readers_hash() -> bytes:
    """Return a hash of our code that reads DBC files, and of when cantools was installed."""
    hashed = hashlib.sha256(b"\0".join(file.read_bytes() for file in _READERS))
    cantools = find_spec("cantools")
    if cantools is not None and cantools.origin is not None:
        hashed.update(f"{cantools.origin}\0{Path(cantools.origin).stat().st_mtime_ns}".encode())
    return hashed.digest()


def _mark(key: str, text: bytes) -> bytes:
    """Return what tells a whole file from a damaged one, or one of another name."""
    return hashlib.sha256(key.encode() + text).hexdigest().encode()
