"""The live page: the report's page, whose curves start empty and grow with the run."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

from bench.errors import BadInput
from bench.live.feed import Feed, Pool

FIRST_S = 2.0
"""How long a request for the page waits while there is nothing to show (s); then the page reloads itself."""

_WAITING = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="color-scheme" content="light dark">
<meta http-equiv="refresh" content="1"><link rel="icon" href="data:,"><title>platoon: waiting for the run</title></head>
<body><p>Waiting for the run to begin ...</p></body></html>
"""


class LivePage:
    """The page of one log.

    Attributes:
        wanted: whether anybody has asked for it yet.
    """

    def __init__(self, log: Path, feed: Feed) -> None:
        """Show `log` and send news to `feed`."""
        self.wanted = False
        self._log = log
        self._feed = feed
        self._html = ""
        self._topics = 0
        self._begun = asyncio.Event()

    async def html(self) -> str:
        """Return the page, or one that asks again soon where there is nothing to show yet."""
        self.wanted = True
        try:
            async with asyncio.timeout(FIRST_S):
                await self._begun.wait()
        except TimeoutError:
            return _WAITING
        return self._html

    async def tell(self, piece: Path, start_ns: int, end_ns: int) -> bool:
        """Deliver a piece of the log from `start_ns` until before `end_ns`; return whether it held anything.

        If the piece has topics that no earlier one had, the page for later viewers is made from it.
        """
        try:
            pool, events = await asyncio.to_thread(self._read, piece, start_ns / 1e9, end_ns / 1e9)
        except BadInput:
            # There is no truth of all vehicles yet.
            return False
        self._begun.set()
        self._feed.append(pool, events)
        return True

    async def end(self) -> None:
        """Show the whole run.

        Raises:
            BadInput: the log cannot be read, has no truth or no scenario.
        """
        self._html, data = await asyncio.to_thread(self._whole)
        self._begun.set()
        self._feed.end(data)

    def _read(self, piece: Path, start_s: float, end_s: float) -> tuple[Pool, list[dict[str, Any]]]:
        # Not at the top: these take a while to import, and nobody may ever ask for the page.
        from bench.analysis.figures import pool_of
        from bench.analysis.page_data import events_of
        from bench.analysis.report import render_live
        from bench.record.reader import Run

        run, span = Run(piece), (start_s, end_s)
        run.path = self._log
        pool = pool_of(run, span)
        if len(run.topics) > self._topics:
            self._topics = len(run.topics)
            self._html = render_live(run)
        return pool, events_of(run.events, span)

    def _whole(self) -> tuple[str, dict[str, Any]]:
        from bench.analysis.page_data import page_data
        from bench.analysis.report import render_live
        from bench.record.reader import Run

        run = Run(self._log)
        return self._html or render_live(run), page_data(run)
