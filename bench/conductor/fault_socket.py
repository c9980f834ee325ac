"""What a bench and `platoon fault` share: the name of the socket, who may be at the other end, what may be on a line.

The socket is an abstract one (unix(7)): no file that another user could put in its place, or that a killed bench leaves
behind. An abstract name has no permissions, so each side checks the other's user. Both send lines of JSON.
"""

import json
import math
import os
import re
import socket
import struct
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NoReturn

MOST_BYTES = 8192
"""Longest line."""

WHO = {"ask": "bench"}
"""The request for what a bench says of itself: its log, the directory it was started in and the scenario."""

MOST_DEPTH = 8
MOST_DIGITS = 18
_STRING = re.compile(r'"(?:[^"\\]|\\.)*"?', re.DOTALL)
_NUMBER_CHARACTERS = 40
_LEAST_S = 0.001
"""Least timeout of a socket in s: 0 would mean not to wait at all."""

_CREDENTIALS = struct.Struct("=3i")
"""struct ucred: process, user and group."""

_LISTENING = 0x10000
"""Flag of a socket in /proc/net/unix that accepts connections (__SO_ACCEPTCON)."""


def bench_name(log: Path) -> str:
    """Return the name of this process's bench, which writes `log`: process number and log."""
    return f"{os.getpid()}-{re.sub('[^A-Za-z0-9._-]', '_', log.stem)[:48]}"


def address_of(name: str) -> bytes:
    """Return the socket address of a bench of this user."""
    return f"\0platoon-{os.getuid()}-{name}".encode()


def listening_names() -> list[str]:
    """Return the names of benches of this user on this host. Anybody could have taken them: see `is_trusted`."""
    try:
        lines = Path("/proc/net/unix").read_bytes().splitlines()
    except OSError:
        return []
    pattern = re.compile(rb"@platoon-%d-(\d+-[A-Za-z0-9._-]*)" % os.getuid())
    rows = [line.split(None, 7) for line in lines[1:]]
    paths = [row[7] for row in rows if len(row) == 8 and int(row[3], 16) & _LISTENING]
    return sorted(found[1].decode() for path in paths if (found := pattern.fullmatch(path)))


def user_of(connection: socket.socket) -> int:
    """Return the user ID of the other end."""
    credentials = connection.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
    return int(_CREDENTIALS.unpack(credentials)[1])


def is_trusted(connection: socket.socket) -> bool:
    """Whether the other end is of this user, or root."""
    return user_of(connection) in (0, os.getuid())


def line_of(content: Mapping[str, Any]) -> bytes:
    """Return an object as a line."""
    return json.dumps(content).encode() + b"\n"


def send_line(connection: socket.socket, line: bytes, deadline: float) -> None:
    """Send a line until a time (time.monotonic).

    Raises:
        OSError: the other end does not read, or is gone.
    """
    connection.settimeout(max(_LEAST_S, deadline - time.monotonic()))
    connection.sendall(line)


def receive_line(connection: socket.socket, deadline: float) -> bytes:
    """Return a line, without its end, that has come until a time (time.monotonic); `parsed` looks at its length.

    The line also ends where the other end closes.

    Raises:
        OSError: it has not come in time, or the other end is gone.
    """
    received = b""
    while b"\n" not in received and len(received) <= MOST_BYTES:
        connection.settimeout(max(_LEAST_S, deadline - time.monotonic()))
        part = connection.recv(MOST_BYTES)
        if not part:
            break
        received += part
        if time.monotonic() > deadline:
            raise TimeoutError("no complete line in time")
    return received.partition(b"\n")[0]


def drain(connection: socket.socket, deadline: float) -> None:
    """Read the rest of what the other end sends, until a time: closed earlier, it might not get what it was told.

    Raises:
        OSError: the other end is gone.
    """
    connection.shutdown(socket.SHUT_WR)
    while (left := deadline - time.monotonic()) > 0:
        connection.settimeout(left)
        if not connection.recv(MOST_BYTES):
            return


def parsed(line: bytes) -> dict[str, Any]:
    """Return the object on a line that anybody may have written.

    Raises:
        ValueError: it is too long or too deep, is not UTF-8 or JSON, is no object, or has a key twice, a number that is
            not finite or too long, or half a surrogate pair.
    """
    if len(line) > MOST_BYTES:
        raise ValueError(f"more than {MOST_BYTES} bytes")
    try:
        text = line.decode()
    except UnicodeDecodeError:
        raise ValueError("not UTF-8") from None
    if _depth(text) > MOST_DEPTH:
        raise ValueError(f"nested more than {MOST_DEPTH} deep")
    try:
        value = json.loads(
            text, object_pairs_hook=_object, parse_constant=_refuse, parse_int=_integer, parse_float=_number
        )
    except json.JSONDecodeError as error:
        raise ValueError(f"not JSON: {error.msg} at character {error.pos}") from None
    if not isinstance(value, dict):
        raise ValueError("not an object of keys and values")
    try:
        json.dumps(value, ensure_ascii=False).encode()
    except UnicodeEncodeError:
        raise ValueError("text with half a surrogate pair") from None
    return value


def _depth(text: str) -> int:
    """Return how deep objects and arrays are nested; json.loads itself fails at some depth by RecursionError."""
    depth = deepest = 0
    for character in _STRING.sub("", text):
        if character in "[{":
            depth += 1
            deepest = max(deepest, depth)
        elif character in "]}":
            depth -= 1
    return deepest


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        raise ValueError("a key occurs twice")
    return found


def _refuse(constant: str) -> NoReturn:
    raise ValueError(f"{constant} is not a finite number")


def _integer(text: str) -> int:
    if len(text) > MOST_DIGITS:
        raise ValueError(f"a number of more than {MOST_DIGITS} digits")
    return int(text)


def _number(text: str) -> float:
    value = float(text) if len(text) <= _NUMBER_CHARACTERS else math.inf
    if not math.isfinite(value):
        raise ValueError(f"{text[:_NUMBER_CHARACTERS]} is too large or too long a number")
    return value
