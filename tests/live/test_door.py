"""Who may connect to the live servers, and what becomes of connections that stay half open: raw sockets."""

import asyncio
import itertools
import socket
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress

import pytest
from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.typing import Origin, Subprotocol

from bench.errors import BadInput
from bench.live.address import LiveAddress
from bench.live.door import Limits
from bench.live.feed import Feed
from bench.live.foxglove_server import FoxgloveServer
from bench.live.page_server import PageServer

from .conftest import Start

GUARD_S = 60.0
"""Ends a test that hangs; nothing is said of how fast things must be."""

SHORT = Limits(connections=8, opening_s=0.5, ping_s=0.2, pong_s=0.3, close_s=0.2)
PAGE = "<p>" + "page" * 2_000_000
PROTOCOL = Subprotocol("foxglove.sdk.v1")

KINDS = ["page", "foxglove"]
Server = PageServer | FoxgloveServer


@asynccontextmanager
async def serving(
    kind: str, limits: Limits | None = None, origins: tuple[str, ...] = ()
) -> AsyncIterator[tuple[Server, int]]:
    address = LiveAddress.parse("127.0.0.1:0", origins)
    server: Server

    async def page() -> str:
        return PAGE

    if kind == "page":
        server = PageServer(address, Feed(), page, limits)
    else:
        server = FoxgloveServer("run.mcap", address, limits)
    port = await server.start()
    try:
        yield server, port
    finally:
        async with asyncio.timeout(GUARD_S):
            await server.stop()


def run(check: Callable[[], Awaitable[None]]) -> None:
    async def guarded() -> None:
        async with asyncio.timeout(GUARD_S):
            await check()

    asyncio.run(guarded())


async def opened(kind: str, port: int, origin: str | None, host: str | None = None) -> None:
    """Open and close a WebSocket."""
    headers = {} if host is None else {"Host": host}
    path = "feed" if kind == "page" else ""
    async with connect(
        f"ws://127.0.0.1:{port}/{path}",
        origin=None if origin is None else Origin(origin),
        subprotocols=None if kind == "page" else [PROTOCOL],
        additional_headers=headers,
    ):
        pass


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    "origin",
    [
        "http://evil.example",
        "https://app.foxglove.dev.evil.example",
        "null",
        "",
        "http://127.0.0.1:1",
        "file:///x",
        "http://localhost:8080",
        "http://app.foxglove.dev",
        "https://app.foxglove.dev:444",
    ],
)
def test_a_web_page_from_elsewhere_may_not_connect(kind: str, origin: str) -> None:
    async def check() -> None:
        async with serving(kind) as (_, port):
            with pytest.raises(InvalidStatus, match="403"):
                await opened(kind, port, origin)

    run(check)


@pytest.mark.parametrize("kind", KINDS)
def test_neither_may_who_calls_this_machine_by_a_foreign_name(kind: str) -> None:
    async def check() -> None:
        async with serving(kind) as (_, port):
            for request in (
                f"GET /feed HTTP/1.1\r\nHost: evil.example:{port}\r\n",
                f"GET /feed HTTP/1.1\r\nHost: evil.example:{port}\r\nOrigin: http://evil.example:{port}\r\n",
                f"GET /feed HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nHost: evil.example\r\n",
                "GET /feed HTTP/1.1\r\n",
            ):
                assert "403" in await status_of(port, request)

    run(check)


async def status_of(port: int, request: str) -> str:
    reader, writer = await asyncio.open_connection("127.0.0.1", port)
    opening = "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
    opening += f"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Protocol: {PROTOCOL}\r\n"
    writer.write(f"{request}{opening}\r\n".encode())
    status = (await reader.readline()).decode()
    writer.close()
    return status


@pytest.mark.parametrize(
    ("kind", "origin"),
    [
        ("page", None),
        ("page", "http://127.0.0.1:{port}"),
        ("foxglove", None),
        ("foxglove", "https://app.foxglove.dev"),
        ("foxglove", "file://"),
        ("foxglove", "http://127.0.0.1:{port}"),
        ("foxglove", "http://localhost:8080"),
        ("foxglove", "https://viewer.example"),
    ],
)
def test_viewers_may_connect(kind: str, origin: str | None) -> None:
    async def check() -> None:
        async with serving(kind, origins=("http://LOCALHOST:8080/", "https://viewer.example:443")) as (_, port):
            await opened(kind, port, origin and origin.format(port=port))

    run(check)


@pytest.mark.parametrize("text", ["", "*", "null", "file://", "localhost:8080", "http://", "http://a/b", "http://u@h"])
def test_an_origin_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(BadInput, match=r"--live-origin .*give the address of a viewer's page"):
        LiveAddress.parse("127.0.0.1:0", [text])


async def is_closed(reader: asyncio.StreamReader) -> bool:
    """Wait until the server has closed a connection, whatever it sends."""
    with suppress(ConnectionError):
        while await reader.read(1 << 16):
            pass
    return True


OPENING = (
    "GET {path} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n"
    f"Sec-WebSocket-Protocol: {PROTOCOL}\r\n\r\n"
)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    "sent",
    [
        pytest.param("", id="silence"),
        pytest.param("GET / HT", id="part of a request"),
        pytest.param("GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nX: ", id="part of a header"),
        pytest.param(OPENING, id="no pong"),
        pytest.param(OPENING + "\x81\xfe", id="part of a frame's head"),
        pytest.param(OPENING + "\x81\x8a\x00\x00\x00\x00abc", id="part of a frame"),
    ],
)
def test_a_half_open_connection_ends_by_itself(kind: str, sent: str) -> None:
    async def check() -> None:
        async with serving(kind, SHORT) as (server, port):
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            path = "/feed" if kind == "page" else "/"
            writer.write(sent.format(path=path, port=port).encode("latin-1"))
            assert await is_closed(reader)
            while server.door.connections:
                await asyncio.sleep(0.01)
            writer.close()

    run(check)


@pytest.mark.parametrize("kind", KINDS)
def test_a_request_that_comes_byte_by_byte_ends_too(kind: str) -> None:
    async def check() -> None:
        async with serving(kind, SHORT) as (_, port):
            reader, writer = await asyncio.open_connection("127.0.0.1", port)
            closed = asyncio.create_task(is_closed(reader))
            for byte in itertools.chain(b"GET / HTTP/1.1\r\nX: ", itertools.repeat(ord("x"))):
                if closed.done():
                    break
                with suppress(ConnectionError):
                    writer.write(bytes([byte]))
                    await writer.drain()
                await asyncio.sleep(0.05)
            writer.close()

    run(check)


def test_who_asks_for_the_page_and_does_not_read_it_is_left() -> None:
    async def check() -> None:
        async with serving("page", SHORT) as (server, port):
            with socket.create_connection(("127.0.0.1", port)) as hanging:
                hanging.sendall(f"GET / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n\r\n".encode())
                while not server.door.connections:
                    await asyncio.sleep(0.01)
                while server.door.connections:
                    await asyncio.sleep(0.01)

    run(check)


@pytest.mark.parametrize("kind", KINDS)
def test_a_viewer_that_does_not_read_is_left(kind: str) -> None:
    async def check() -> None:
        async with serving(kind, SHORT) as (server, port):
            path = "feed" if kind == "page" else ""
            protocols = None if kind == "page" else [PROTOCOL]
            hanging = await connect(f"ws://127.0.0.1:{port}/{path}", subprotocols=protocols, ping_interval=None)
            hanging.transport.pause_reading()
            while server.door.connections:
                await asyncio.sleep(0.01)
            hanging.transport.abort()

    run(check)


@pytest.mark.parametrize("kind", KINDS)
def test_connections_beyond_the_limit_are_closed_and_others_go_on(kind: str) -> None:
    limits = Limits(connections=8, opening_s=30.0)

    async def check() -> None:
        async with serving(kind, limits) as (server, port):
            silent = [await asyncio.open_connection("127.0.0.1", port) for _ in range(limits.connections)]
            while server.door.connections < limits.connections:
                await asyncio.sleep(0.01)
            for _ in range(20):
                reader, writer = await asyncio.open_connection("127.0.0.1", port)
                assert await is_closed(reader)
                writer.close()
            assert server.door.connections == limits.connections
            for _, writer in silent:
                writer.close()
            while server.door.connections:
                await asyncio.sleep(0.01)
            await opened(kind, port, None)

    run(check)


async def all_of(viewer: ClientConnection) -> None:
    while True:
        await viewer.recv()


@pytest.mark.parametrize("kind", KINDS)
def test_a_request_that_is_too_large_ends_its_connection_only(kind: str) -> None:
    async def check() -> None:
        async with serving(kind) as (_, port):
            path = "feed" if kind == "page" else ""
            protocols = None if kind == "page" else [PROTOCOL]
            async with connect(f"ws://127.0.0.1:{port}/{path}", subprotocols=protocols) as viewer:
                await viewer.send("x" * (2 << 20))
                with pytest.raises(ConnectionClosed):
                    await all_of(viewer)
            await opened(kind, port, None)

    run(check)


def test_a_run_that_is_watched_lets_in_who_it_is_told_to(start: Start) -> None:
    bench = start("--can", "direct", "--live-origin", "http://localhost:8080", duration=2.0)

    async def check() -> None:
        await opened("foxglove", bench.foxglove_port, "http://localhost:8080")
        with pytest.raises(InvalidStatus, match="403"):
            await opened("foxglove", bench.foxglove_port, "http://evil.example")

    run(check)
    bench.end()
