"""Serves the live page at `/` and its data at `/feed`, a WebSocket; nothing else, and no file by its path."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable

from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from bench.errors import BadInput
from bench.live.address import LiveAddress
from bench.live.door import Door, Limits
from bench.live.feed import Feed, Place

MAX_VIEWERS = 32
OPENING_S = 1.0
"""Wall-clock time in s that a browser that has been given the page may take to open the feed."""

ASK_S = 0.02
"""Polling interval at the end, until all viewers have everything (s)."""

_FEED = "/feed"


class PageServer:
    """The page's server."""

    def __init__(
        self, address: LiveAddress, feed: Feed, page: Callable[[], Awaitable[str]], limits: Limits | None = None
    ) -> None:
        """Serve what `page` gives, and `feed`."""
        self._address = address
        self.door = Door(address, limits=limits)
        self._feed = feed
        self._page = page
        self._server: Server | None = None
        self._viewers: dict[ServerConnection, Place] = {}
        self._opening_until = 0.0

    @property
    def watched(self) -> bool:
        """Whether a page is open."""
        return bool(self._viewers)

    async def start(self) -> int:
        """Listen; return the port.

        Raises:
            BadInput: the address cannot be listened on.
        """
        host, port = self._address.host, self._address.port
        try:
            self._server = await serve(
                self._tell,
                host,
                port,
                process_request=self._answer,
                # Viewers send nothing.
                max_size=1024,
                max_queue=1,
                **self.door.settings(),
            )
        except OSError as error:
            raise BadInput(f"cannot listen on {host}:{port}: {error.strerror or error}") from error
        return int(self._server.sockets[0].getsockname()[1])

    async def stop(self) -> None:
        """Let connected viewers get everything, then close all connections.

        A viewer that does not read is waited for as long as the caller waits.
        """
        while self._is_awaited():
            await asyncio.sleep(ASK_S)
        if self._server is not None:
            self._server.close()
            await self._server.wait_closed()

    def _is_awaited(self) -> bool:
        """Whether a viewer is about to open the feed, or does not have everything yet."""
        places = self._viewers.values()
        return time.monotonic() < self._opening_until or any(self._feed.has_more(place) for place in places)

    async def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """Answer a request; None lets the WebSocket be opened."""
        refusal = self.door.refusal(request.headers)
        if refusal is not None:
            return connection.respond(403, refusal)
        path = request.path.partition("?")[0]
        if path == "/":
            page = await self._page()
            self._opening_until = time.monotonic() + OPENING_S
            return _html(page)
        if path != _FEED:
            return connection.respond(404, "Only / and /feed exist here.\n")
        refusal = self.door.refusal_of_origin(request.headers)
        if refusal is not None:
            return connection.respond(403, refusal)
        if len(self._viewers) >= MAX_VIEWERS:
            return connection.respond(503, f"There are {MAX_VIEWERS} viewers already.\n")
        return None

    async def _tell(self, viewer: ServerConnection) -> None:
        """Send a viewer everything, until it knows the end or leaves."""
        self._opening_until = 0.0
        self._viewers[viewer] = place = Place()
        gone = asyncio.ensure_future(viewer.wait_closed())
        try:
            while not place.ended:
                more = asyncio.ensure_future(self._feed.after(place))
                await asyncio.wait({more, gone}, return_when=asyncio.FIRST_COMPLETED)
                if gone.done():
                    more.cancel()
                    return
                message, place = more.result()
                await viewer.send(message)
                self._viewers[viewer] = place
            await viewer.close()
        except ConnectionClosed:
            return
        finally:
            gone.cancel()
            del self._viewers[viewer]


def _html(page: str) -> Response:
    body = page.encode()
    headers = Headers(
        [
            ("Content-Type", "text/html; charset=utf-8"),
            ("Content-Length", str(len(body))),
            ("Cache-Control", "no-store"),
            ("X-Content-Type-Options", "nosniff"),
            ("Cross-Origin-Resource-Policy", "same-origin"),
            ("X-Frame-Options", "DENY"),
            ("Connection", "close"),
        ]
    )
    return Response(200, "OK", headers, body)
