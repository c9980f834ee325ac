"""What viewers are told: all of it, whenever they come and however slowly they read."""

import asyncio
import json

from bench.live.feed import Feed, Place


def told(feed: Feed, place: Place) -> tuple[dict, Place]:
    message, place = asyncio.run(asyncio.wait_for(feed.after(place), 1.0))
    return json.loads(message), place


def test_a_viewer_that_comes_late_is_told_all_so_far() -> None:
    feed = Feed()
    feed.append({"t": [0.0, 0.01], "1.X": [1.0, None]}, [{"time_s": 0.0, "text": "a"}])
    feed.append({"t": [0.02], "1.X": [3.0]}, [])
    message, place = told(feed, Place())
    assert message == {
        "append": {"pool": {"t": [0.0, 0.01, 0.02], "1.X": [1.0, None, 3.0]}, "events": [{"time_s": 0.0, "text": "a"}]}
    }
    feed.append({"t": [0.03], "1.X": [4.0]}, [{"time_s": 0.03, "text": "b"}])
    message, _ = told(feed, place)
    assert message == {"append": {"pool": {"t": [0.03], "1.X": [4.0]}, "events": [{"time_s": 0.03, "text": "b"}]}}


def test_viewers_at_different_places_are_told_what_each_lacks() -> None:
    feed = Feed()
    feed.append({"t": [0.0]}, [])
    _, early = told(feed, Place())
    feed.append({"t": [1.0]}, [])
    _, later = told(feed, early)
    feed.append({"t": [2.0]}, [])
    assert told(feed, early)[0]["append"]["pool"] == {"t": [1.0, 2.0]}
    assert told(feed, later)[0]["append"]["pool"] == {"t": [2.0]}
    assert told(feed, early)[1] == told(feed, later)[1]


def test_the_end_takes_the_place_of_all_before() -> None:
    feed = Feed()
    feed.append({"t": [0.0]}, [])
    feed.say("nearly there")
    feed.end({"pool": {"t": [0.0]}})
    message, place = told(feed, Place())
    assert message == {"replace": {"pool": {"t": [0.0]}}}
    assert place.ended


def test_a_status_is_told_once() -> None:
    async def check() -> None:
        feed = Feed()
        feed.say("waiting")
        message, place = await feed.after(Place())
        assert json.loads(message) == {"status": "waiting"}
        waiting = asyncio.ensure_future(feed.after(place))
        await asyncio.sleep(0)
        assert not waiting.done()
        feed.say("running")
        assert json.loads((await waiting)[0]) == {"status": "running"}

    asyncio.run(check())
