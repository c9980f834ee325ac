"""The page's server: who is let in, and what becomes of viewers that come late, leave or do not read."""

import asyncio
import http.client
import json
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, closing

import pytest
from websockets.asyncio.client import connect
from websockets.exceptions import InvalidStatus

from bench.errors import BadInput
from bench.live.address import LiveAddress
from bench.live.feed import Feed
from bench.live.page_server import PageServer


@asynccontextmanager
async def serving(feed: Feed) -> AsyncIterator[tuple[PageServer, int]]:
    async def page() -> str:
        return "<p>page</p>"

    server = PageServer(LiveAddress.parse("127.0.0.1:0"), feed, page)
    port = await server.start()
    try:
        yield server, port
    finally:
        async with asyncio.timeout(10.0):
            await server.stop()


def in_server(feed_check: Callable[[Feed, PageServer, int], Awaitable[None]]) -> None:
    """Run a check in a loop that serves a feed."""

    async def run() -> None:
        feed = Feed()
        async with serving(feed) as (server, port):
            await feed_check(feed, server, port)
            feed.end({})

    asyncio.run(run())


def get(port: int, path: str, host: str) -> tuple[int, str]:
    with closing(http.client.HTTPConnection("127.0.0.1", port, timeout=10.0)) as connection:
        connection.request("GET", path, headers={"Host": host})
        answer = connection.getresponse()
        return answer.status, answer.read().decode()


@pytest.mark.parametrize(
    ("path", "host", "status"),
    [
        ("/", "127.0.0.1:{}", 200),
        ("/", "localhost:{}", 200),
        ("/?now", "[::1]:{}", 200),
        ("/", "evil.example:{}", 403),
        ("/", "127.0.0.1.evil.example:{}", 403),
        ("/", "", 403),
        ("/", "localhost.:{}", 200),
        ("/", "evil.example.:{}", 403),
        ("/", "[::1]evil.example:{}", 403),
        ("/", "127.0.0.1@evil.example:{}", 403),
        ("/", "127.0.0.1:evil.example:{}", 403),
        ("/", "[::1", 403),
        ("/etc/passwd", "127.0.0.1:{}", 404),
        ("//[", "127.0.0.1:{}", 404),
        ("http://[", "127.0.0.1:{}", 404),
        ("/../../etc/passwd", "127.0.0.1:{}", 404),
    ],
)
def test_there_is_one_page_for_who_calls_this_machine_by_its_name(path: str, host: str, status: int) -> None:
    async def check(_feed: Feed, _server: PageServer, port: int) -> None:
        answer, body = await asyncio.to_thread(get, port, path, host.format(port))
        assert answer == status
        assert (body == "<p>page</p>") == (status == 200)

    in_server(check)


@pytest.mark.parametrize("origin", ["http://evil.example", "http://127.0.0.1:1", "null"])
def test_a_page_from_elsewhere_may_not_open_the_feed(origin: str) -> None:
    async def check(_feed: Feed, _server: PageServer, port: int) -> None:
        with pytest.raises(InvalidStatus, match="403"):
            await connect(f"ws://127.0.0.1:{port}/feed", origin=origin)  # type: ignore[arg-type]

    in_server(check)


def test_viewers_are_told_all_and_then_the_end() -> None:
    async def check(feed: Feed, server: PageServer, port: int) -> None:
        feed.append({"t": [0.0]}, [])
        origin = f"http://127.0.0.1:{port}"
        async with connect(f"ws://127.0.0.1:{port}/feed", origin=origin) as viewer:  # type: ignore[arg-type]
            assert json.loads(await viewer.recv())["append"]["pool"] == {"t": [0.0]}
            feed.append({"t": [1.0]}, [])
            assert json.loads(await viewer.recv())["append"]["pool"] == {"t": [1.0]}
            async with connect(f"ws://127.0.0.1:{port}/feed") as late:
                assert json.loads(await late.recv())["append"]["pool"] == {"t": [0.0, 1.0]}
                feed.end({"pool": {}})
                for each in (viewer, late):
                    assert json.loads(await each.recv()) == {"replace": {"pool": {}}}
                    await each.wait_closed()
        while server.watched:
            await asyncio.sleep(0.01)

    in_server(check)


def test_a_viewer_that_leaves_is_forgotten() -> None:
    async def check(feed: Feed, server: PageServer, port: int) -> None:
        feed.append({"t": [0.0]}, [])
        async with connect(f"ws://127.0.0.1:{port}/feed") as viewer:
            await viewer.recv()
            assert server.watched
        while server.watched:
            await asyncio.sleep(0.01)

    in_server(check)


def test_a_viewer_that_does_not_read_holds_up_nobody() -> None:
    async def check(feed: Feed, _server: PageServer, port: int) -> None:
        # It takes part in the opening, and never reads again.
        hanging = await connect(f"ws://127.0.0.1:{port}/feed", max_queue=1, ping_interval=None)
        hanging.transport.pause_reading()
        async with connect(f"ws://127.0.0.1:{port}/feed", max_size=None) as reading:
            rows = 0
            for _ in range(40):
                feed.append({"t": [0.5] * 50_000}, [])
                rows += len(json.loads(await reading.recv())["append"]["pool"]["t"])
            assert rows == 40 * 50_000
        hanging.transport.abort()

    in_server(check)


def test_a_taken_port_is_refused() -> None:
    async def check(_feed: Feed, _server: PageServer, port: int) -> None:
        with pytest.raises(BadInput, match=f"cannot listen on 127.0.0.1:{port}"):
            await PageServer(LiveAddress.parse(f"127.0.0.1:{port}"), Feed(), _no_page).start()

    in_server(check)


async def _no_page() -> str:
    return ""


@pytest.mark.parametrize(
    "text", ["", "8080", ":8080", "host:", "host:x", "host:65535", "host:-1", "host:٣", "host:²", f"host:{'9' * 5000}"]
)
def test_an_address_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(BadInput, match="write HOST:PORT"):
        LiveAddress.parse(text)


def test_addresses() -> None:
    assert LiveAddress.parse("[::1]:80").url("http", 80) == "http://[::1]:80"
    assert LiveAddress.parse("127.0.0.1:8000").foxglove_port == 8001
    assert LiveAddress.parse("127.0.0.1:0").foxglove_port == 0
    assert LiveAddress.parse("bench.example:1").is_own("bench.example:1")
    assert not LiveAddress.parse("0.0.0.0:1").is_own("bench.example:1")
