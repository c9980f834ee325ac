"""What Foxglove is told, seen by a client that knows nothing but the protocol: the same numbers as in the log."""

import asyncio
from pathlib import Path

import numpy as np
import pytest

from bench.errors import BadInput
from bench.live.address import LiveAddress
from bench.live.foxglove_server import FoxgloveServer
from bench.live.server import LiveServer
from bench.mcap.scan import ScannedFile
from bench.record.reader import Run

from .foxglove_viewer import Viewer


async def watch(log: ScannedFile, *topics: str) -> tuple[FoxgloveServer, Viewer]:
    """Serve a log's channels to a viewer that has asked for some."""
    server = FoxgloveServer("run.mcap", "127.0.0.1", 0)
    viewer = await Viewer.connect(f"ws://127.0.0.1:{server.port}", "run.mcap")
    server.advertise(log.contents.channels, log.contents.schemas)
    await viewer.expect_channels(channel.topic for channel in log.contents.channels.values())
    await viewer.subscribe(*topics)
    while len(server.wanted) < len(topics):
        await asyncio.sleep(0.01)
    return server, viewer


def test_topics_schemas_and_numbers_are_those_of_the_log(whole_log: Path) -> None:
    topics = "/signals/veh2/VehicleMotion", "/truth/veh1", "/can/veh1", "/tf"

    async def check() -> Viewer:
        log = ScannedFile(whole_log)
        server, viewer = await watch(log, *topics)
        await server.play(log, server.wanted, (1_000_000_000, 2_000_000_000), 0.5)
        await asyncio.sleep(0.2)
        await asyncio.to_thread(server.stop)
        await viewer.rest()
        return viewer

    viewer, run = asyncio.run(check()), Run(whole_log)
    assert viewer.channels.keys() == run.topics.keys()
    assert all(channel.get("metadata", {}) == run.topics[topic].metadata for topic, channel in viewer.channels.items())
    for topic, name, (t, values) in (
        (topics[0], "YawRate", run.signal("veh2", "VehicleMotion", "YawRate")),
        (topics[1], "v_x", (run.truth(1)["t"], run.truth(1)["v_x"])),
    ):
        inside = (t >= 1.0) & (t < 2.0)
        assert [time_ns for time_ns, _ in viewer.messages[topic]] == np.rint(t[inside] * 1e9).astype(int).tolist()
        assert viewer.decoded(topic, name) == values[inside].tolist()
    frames = run.frame_table("veh1")
    inside = (frames["time"] >= 1_000_000_000) & (frames["time"] < 2_000_000_000)
    assert viewer.decoded(topics[2], "id") == frames["can_id"][inside].tolist()
    assert viewer.times == sorted(viewer.times)
    assert set(viewer.times) == {time_ns for time_ns, _ in viewer.messages["/tf"]}
    assert viewer.messages.keys() == set(topics)


def test_messages_come_after_their_time_has_been_told(whole_log: Path) -> None:
    """Viewers take a message for one of the last time that they have been told."""

    async def check() -> list[tuple[int, int]]:
        log = ScannedFile(whole_log)
        server, viewer = await watch(log, "/truth/veh1", "/truth/veh2")
        await server.play(log, server.wanted, (0, 500_000_000), 2.0)
        await asyncio.sleep(0.2)
        await asyncio.to_thread(server.stop)
        await viewer.rest()
        return viewer.shown

    shown = asyncio.run(check())
    assert len(shown) == 100
    # Not all: how two threads of foxglove-sdk's get on is not ours.
    assert sum(told == own for told, own in shown) >= 50


def test_the_scene_is_sent_to_who_comes_late(whole_log: Path) -> None:
    async def check() -> None:
        log = ScannedFile(whole_log)
        server, viewer = await watch(log, "/scene", "/truth/veh1")
        asked = server.newly_asked()
        assert [log.contents.channels[number].topic for number in asked] == ["/scene"]
        assert server.newly_asked() == set()
        server.send_last(log, asked, 3_000_000_000)
        await viewer.expect("/scene")
        assert [time_ns for time_ns, _ in viewer.messages["/scene"]] == [3_000_000_000]
        assert len(viewer.decoded("/scene", "entities")[0]) > 0
        await viewer.socket.close()
        server.stop()

    asyncio.run(check())


def test_a_taken_port_is_refused() -> None:
    server = FoxgloveServer("a", "127.0.0.1", 0)
    with pytest.raises(BadInput, match=f"cannot listen on 127.0.0.1:{server.port} for Foxglove"):
        FoxgloveServer("b", "127.0.0.1", server.port)
    server.stop()


def test_a_log_is_shown_as_it_grows(whole_log: Path, tmp_path: Path) -> None:
    """Whoever asks for a topic before it begins is told all of it; who comes later is told the scene first."""

    async def check() -> tuple[Viewer, Viewer]:
        log, over = tmp_path / "run.mcap", asyncio.Event()
        server = LiveServer(log, LiveAddress.parse("127.0.0.1:0"))
        url = (await server.start()).foxglove
        following = asyncio.create_task(server.follow(over))
        first = await Viewer.connect(url, "run.mcap")
        whole = whole_log.read_bytes()
        with log.open("wb") as stream:
            stream.write(whole[: len(whole) // 4])
            stream.flush()
            await first.expect_channels({"/truth/veh1", "/scene"})
            await first.subscribe("/truth/veh1", "/scene")
            await asyncio.sleep(0.5)
            reading = asyncio.create_task(first.rest())
            stream.write(whole[len(whole) // 4 : len(whole) // 2])
            stream.flush()
            late = await Viewer.connect(url, "run.mcap")
            await late.expect_channels({"/scene"})
            await late.subscribe("/scene")
            await asyncio.sleep(0.5)
            stream.write(whole[len(whole) // 2 :])
        await late.expect("/scene")
        await following
        await asyncio.sleep(0.2)
        await server.stop()
        await reading
        return first, late

    (first, late), run = asyncio.run(check()), Run(whole_log)
    assert len(late.messages["/scene"]) >= 1
    told = np.array([time_ns for time_ns, _ in first.messages["/truth/veh1"]])
    t, speed = run.truth(1)["t"], run.truth(1)["v_x"]
    assert (np.diff(told) == 10_000_000).all()
    assert told[-1] == round(t[-1] * 1e9)
    assert first.decoded("/truth/veh1", "v_x") == speed[-len(told) :].tolist()
    assert len(told) > 50
