"""Protocol between the caller's side and the first process in the kernel: small messages over one byte stream."""

import json
import os
import struct
from dataclasses import asdict, dataclass
from enum import IntEnum
from typing import Any

MOST_BYTES = 2048
"""Longest payload of a message once the command runs: a pipe takes it whole, so that threads may write at once."""

WINDOW_BYTES = 16_384
"""Bytes of standard input under way that the command has not taken yet; as much always fits in the line's buffers."""

_HEAD = struct.Struct("!BI")


class Kind(IntEnum):
    """What a message is about; after each, its payload and who sends it (C the caller's side, K in the kernel)."""

    READY = 1
    """K: nothing. The machine is up."""
    LAUNCH = 2
    """C: a `Launch`."""
    SIGNAL = 3
    """C: the number of a signal to the command."""
    INPUT = 4
    """C: bytes of standard input; empty at its end."""
    TAKEN = 5
    """K: how many bytes of standard input the command has taken."""
    CLOSED = 6
    """C: 1 or 2, that output nobody reads any more."""
    ENDED = 7
    """K: exit status, bytes of standard output, bytes of standard error."""
    FAILED = 8
    """K: why the command could not be started, UTF-8."""


@dataclass(frozen=True)
class Launch:
    """A command and its surroundings.

    Attributes:
        command: program and arguments.
        environment: its environment variables.
        directory: its working directory.
        umask: its file mode creation mask.
    """

    command: list[str]
    environment: dict[str, str]
    directory: str
    umask: int

    def encode(self) -> bytes:
        """Return it as bytes; escapes carry names that are not UTF-8."""
        return json.dumps(asdict(self)).encode("ascii")

    @classmethod
    def decode(cls, data: bytes) -> "Launch":
        """Return the command that `encode` was given."""
        given: dict[str, Any] = json.loads(data)
        return cls(**given)


def write(descriptor: int, kind: Kind, payload: bytes = b"") -> None:
    """Send a message, all of it."""
    write_all(descriptor, _HEAD.pack(kind, len(payload)) + payload)


def write_numbers(descriptor: int, kind: Kind, *numbers: int) -> None:
    """Send a message of whole numbers from 0."""
    write(descriptor, kind, struct.pack(f"!{len(numbers)}Q", *numbers))


def numbers_of(payload: bytes) -> tuple[int, ...]:
    """Return the numbers of such a message."""
    return struct.unpack(f"!{len(payload) // 8}Q", payload)


def read(descriptor: int) -> tuple[Kind, bytes] | None:
    """Wait for the next message; None where the other side is gone."""
    head = _read_exactly(descriptor, _HEAD.size)
    if head is None:
        return None
    kind, length = _HEAD.unpack(head)
    payload = _read_exactly(descriptor, length)
    return None if payload is None else (Kind(kind), payload)


def write_all(descriptor: int, data: bytes) -> None:
    """Write all of it, however little the other side accepts at once."""
    view = memoryview(data)
    while view:
        view = view[os.write(descriptor, view) :]


def _read_exactly(descriptor: int, count: int) -> bytes | None:
    data = b""
    while len(data) < count:
        more = os.read(descriptor, count - len(data))
        if not more:
            return None
        data += more
    return data
