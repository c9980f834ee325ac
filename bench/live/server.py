"""The live server: follows a log, sends what is new to the page and Foxglove, and finally shows the complete run.

The log is read only while somebody watches, and for at most `SHARE` of the time, so that the bench has the cores it
needs.
"""

from __future__ import annotations

import asyncio
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from bench.live.address import LiveAddress
from bench.live.cursor import SPAN_NS, Cursor, Span
from bench.live.feed import Feed
from bench.live.foxglove_server import FoxgloveServer
from bench.live.page import LivePage
from bench.live.page_server import PageServer
from bench.live.tail import Tail
from bench.mcap.scan import ScannedFile

POLL_S = 0.25
"""Polling interval of the log (s)."""

SHARE = 0.1
"""Greatest share of the time that this process works."""

LONGEST_PLAY_S = 1.0
"""Foxglove gets news at the speed of the run, within at most this time (s)."""

GOODBYE_S = 3.0
"""Wall-clock time in s that viewers have at the end to receive the rest."""


@dataclass(frozen=True)
class Served:
    """Where a viewer finds the server: URLs of the page and for Foxglove."""

    page: str
    foxglove: str

    def __str__(self) -> str:
        """Return the line for a person."""
        return f"live: {self.page}/  foxglove: {self.foxglove}"


class LiveServer:
    """Serves one log: `start`, `follow`, `finish` and `stop`, in this order."""

    def __init__(self, log: Path, address: LiveAddress) -> None:
        """Serve `log`, which need not be there yet, at `address`."""
        self._tail = Tail(log)
        self._address = address
        self._feed = Feed()
        self._page = LivePage(log, self._feed)
        self._page_server = PageServer(address, self._feed, self._page.html)
        self._page_cursor = Cursor()
        self._foxglove = FoxgloveServer(log.name, address)
        self._foxglove_cursor = Cursor()
        self._heads = 0

    async def start(self) -> Served:
        """Listen.

        Raises:
            BadInput: the address cannot be listened on, or what is there is no log.
        """
        self._tail.poll()
        port = await self._page_server.start()
        foxglove_port = await self._foxglove.start()
        return Served(self._address.url("http", port), self._address.url("ws", foxglove_port))

    async def follow(self, over: asyncio.Event) -> None:
        """Send news to viewers until the log has ended or `over` is set.

        Raises:
            BadInput: the log cannot be read.
        """
        await asyncio.gather(self._follow_for_foxglove(over), self._follow_for_page(over))

    async def finish(self) -> None:
        """Show the whole run on the page, to those who watch and to those who come."""
        await self._page.end()

    @property
    def page_wanted(self) -> bool:
        """Whether anybody has asked for the page."""
        return self._page.wanted

    def say(self, status: str) -> None:
        """Set the page's status line."""
        self._feed.say(status)

    async def stop(self) -> None:
        """Give viewers some time to receive the rest, and close all connections."""
        with suppress(TimeoutError):
            async with asyncio.timeout(GOODBYE_S):
                await asyncio.gather(self._foxglove.stop(), self._page_server.stop())
        self._tail.close()

    async def _follow_for_foxglove(self, over: asyncio.Event) -> None:
        last_at = time.monotonic()
        while True:
            is_over = over.is_set()
            self._tail.poll()
            since, last_at = time.monotonic() - last_at, time.monotonic()
            span = self._foxglove_cursor.next(self._tail)
            if span is not None:
                await self._tell_foxglove(span, within_s=min(since, LONGEST_PLAY_S))
            elif self._tail.ended or (is_over and self._tail.quiet):
                return
            await _passed(over, max(0.0, last_at + POLL_S - time.monotonic()))

    async def _tell_foxglove(self, span: Span, within_s: float) -> None:
        """Send a span of time to Foxglove; later viewers do not get it again."""
        self._foxglove_cursor.told_ns = span.end_ns
        if self._tail.heads > self._heads:
            self._heads = self._tail.heads
            with self._tail.piece([]) as piece:
                contents = ScannedFile(piece).contents
            self._foxglove.advertise(contents.channels, contents.schemas)
        for channel in self._foxglove.newly_asked():
            having = [chunk for chunk in self._tail.chunks if channel in chunk.indexes]
            with self._tail.piece(having[-1:]) as piece:
                self._foxglove.send_last(ScannedFile(piece), {channel}, span.start_ns)
        wanted = self._foxglove.wanted
        if wanted:
            with self._tail.piece(span.chunks) as piece:
                log = ScannedFile(piece)
            await self._foxglove.play(log, wanted, (span.start_ns, span.end_ns), within_s)

    async def _follow_for_page(self, over: asyncio.Event) -> None:
        while not (self._tail.ended or over.is_set()):
            begun = time.process_time()
            span = self._page_cursor.next(self._tail) if self._page.wanted else None
            if span is not None:
                with self._tail.piece(span.chunks) as piece:
                    told = await self._page.tell(piece, span.start_ns, span.end_ns)
                # A span without truth is tried again together with the next.
                if told or span.end_ns - span.start_ns >= SPAN_NS:
                    self._page_cursor.told_ns = span.end_ns
            worked = time.process_time() - begun
            await _passed(over, max(POLL_S, worked / SHARE - worked))


async def _passed(over: asyncio.Event, seconds: float) -> None:
    """Wait for a time or until `over` is set."""
    try:
        async with asyncio.timeout(seconds):
            await over.wait()
    except TimeoutError:
        return
