"""Who may connect to the live servers, how many at once, and when a connection that says nothing is closed.

The page, its feed and Foxglove's WebSocket have the same rules. `Host` must be a name of this machine (against DNS
rebinding, see `LiveAddress.is_own`). `Origin`, which a browser sends and no web page can forge, must be the server's
own or one of those that it allows; programs other than browsers send none.
"""

from __future__ import annotations

import asyncio
from collections.abc import Collection
from dataclasses import dataclass
from functools import partial
from typing import Any

from websockets.asyncio.server import ServerConnection
from websockets.datastructures import Headers

from bench.live.address import LiveAddress

VIEWERS = ("https://app.foxglove.dev", "file://")
"""Origins that may always open Foxglove's WebSocket: its web application, and the desktop applications of Foxglove and
Lichtblick, which are local files to their browser. Not `null`: any page can give that origin to a frame of its own."""


@dataclass(frozen=True)
class Limits:
    """What a server grants its connections; times are of the wall clock, in s.

    Attributes:
        connections: open at the same time, complete or not; further ones are closed at once.
        opening_s: for the whole opening of a connection, from its first byte to the last of the answer.
        ping_s: a connection is asked for a sign of life this often.
        pong_s: it is closed if it does not answer for so long.
        close_s: for the closing of a connection.
    """

    connections: int = 64
    opening_s: float = 10.0
    ping_s: float = 10.0
    pong_s: float = 10.0
    close_s: float = 2.0


class Door:
    """The rules of one server."""

    def __init__(self, address: LiveAddress, origins: Collection[str] = (), limits: Limits | None = None) -> None:
        """Let in the pages of `origins`, besides the server's own."""
        self._address = address
        self._origins = frozenset(origins)
        self._limits = limits or Limits()
        self._open: set[ServerConnection] = set()

    @property
    def connections(self) -> int:
        """Number of open connections, complete or not."""
        return len(self._open)

    def settings(self) -> dict[str, Any]:
        """Return the arguments for `websockets.serve`."""
        return {
            "create_connection": partial(_Counted, self),
            "open_timeout": self._limits.opening_s,
            "ping_interval": self._limits.ping_s,
            "ping_timeout": self._limits.pong_s,
            "close_timeout": self._limits.close_s,
            "compression": None,
            "server_header": None,
        }

    def refusal(self, headers: Headers) -> str | None:
        """Return why a request may not be answered; None if it may."""
        host = _only(headers, "Host")
        if host is None or not self._address.is_own(host):
            return "Open this page by an address or the name of this machine.\n"
        return None

    def refusal_of_origin(self, headers: Headers) -> str | None:
        """Return why a request may not open a WebSocket; None if it may."""
        origins = headers.get_all("Origin")
        refusal = self.refusal(headers)
        if refusal is not None or not origins:
            return refusal
        own = {f"{scheme}://{headers['Host'].lower()}" for scheme in ("http", "https")}
        if len(origins) > 1 or origins[0].lower() not in own | self._origins:
            return "Only the page that is served here and allowed viewers (--live-origin) may open this connection.\n"
        return None

    def _enter(self, connection: ServerConnection) -> bool:
        if len(self._open) >= self._limits.connections:
            return False
        self._open.add(connection)
        return True

    def _leave(self, connection: ServerConnection) -> None:
        self._open.discard(connection)


class _Counted(ServerConnection):
    """A connection that is closed at once if there are too many."""

    def __init__(self, door: Door, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._door = door

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        super().connection_made(transport)
        if not self._door._enter(self):
            self.transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        self._door._leave(self)
        super().connection_lost(exc)


def _only(headers: Headers, name: str) -> str | None:
    values = headers.get_all(name)
    return values[0] if len(values) == 1 else None
