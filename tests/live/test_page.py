"""The live page is made from pieces of a log, and is told the same values as the whole log has."""

import asyncio
import json
from pathlib import Path

from bench.analysis.page_data import page_data
from bench.live.cursor import Cursor
from bench.live.feed import Feed, Place
from bench.live.page import LivePage
from bench.live.tail import Tail
from bench.record.reader import Run


def test_what_it_is_told_piece_by_piece_is_what_the_report_shows(whole_log: Path) -> None:
    async def check() -> tuple[str, dict, dict]:
        feed = Feed()
        page, tail, cursor = LivePage(whole_log, feed), Tail(whole_log), Cursor()
        tail.poll()
        while (span := cursor.next(tail)) is not None:
            with tail.piece(span.chunks) as piece:
                await page.tell(piece, span.start_ns, span.end_ns)
            cursor.told_ns = span.end_ns
        told, place = await feed.after(Place())
        html = await page.html()
        await page.end()
        end, _ = await feed.after(place)
        return html, json.loads(told)["append"], json.loads(end)["replace"]

    html, told, end = asyncio.run(check())
    whole = json.loads(json.dumps(page_data(Run(whole_log))))
    assert '"live":true' in html
    assert whole_log.name in html
    assert end == whole
    assert told["events"] == whole["events"]
    over_time = {name for name, values in whole["pool"].items() if len(values) == len(whole["pool"]["t"])}
    # What is reckoned from all of a run comes at its end only: the load of the buses.
    shared = over_time & told["pool"].keys()
    assert {"t", "1.X", "3.psi", "2.v_x", "distance.1-2", "1.torque.FL"} <= shared
    assert {name: told["pool"][name] for name in shared} == {name: whole["pool"][name] for name in shared}


def test_a_log_without_truth_is_waited_for(tmp_path: Path) -> None:
    async def check() -> None:
        page = LivePage(tmp_path / "none.mcap", Feed())
        assert "Waiting for the run" in await page.html()
        assert page.wanted

    asyncio.run(check())
