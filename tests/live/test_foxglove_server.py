"""What Foxglove is told, seen by a client that knows nothing but the protocol: the same numbers as in the log."""

import asyncio
import json
from pathlib import Path

import numpy as np
import pytest

from bench.errors import BadInput
from bench.live import foxglove_server
from bench.live.address import LiveAddress
from bench.live.door import Limits
from bench.live.foxglove_server import FoxgloveServer
from bench.live.server import LiveServer
from bench.mcap.scan import ScannedFile
from bench.record.reader import Run

from .foxglove_viewer import Viewer


async def watch(log: ScannedFile, *topics: str) -> tuple[FoxgloveServer, Viewer]:
    """Serve a log's channels to a viewer that has asked for some."""
    server = FoxgloveServer("run.mcap", LiveAddress.parse("127.0.0.1:0"), Limits(ping_s=1000.0))
    viewer = await Viewer.connect(f"ws://127.0.0.1:{await server.start()}", "run.mcap")
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
        await server.stop()
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
        await server.stop()
        await viewer.rest()
        return viewer.shown

    shown = asyncio.run(check())
    assert len(shown) == 100
    assert all(told == own for told, own in shown)


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
        await server.stop()

    asyncio.run(check())


def test_a_taken_port_is_refused() -> None:
    async def check() -> None:
        server = FoxgloveServer("a", LiveAddress.parse("127.0.0.1:0"))
        port = await server.start()
        with pytest.raises(BadInput, match=f"cannot listen on 127.0.0.1:{port} for Foxglove"):
            await FoxgloveServer("b", LiveAddress.parse(f"127.0.0.1:{port - 1}")).start()
        await server.stop()

    asyncio.run(check())


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


@pytest.mark.parametrize("protocol", ["foxglove.sdk.v1", "foxglove.websocket.v1"])
def test_foxglove_and_lichtblick_agree_on_a_protocol(protocol: str) -> None:
    async def check() -> None:
        server = FoxgloveServer("run.mcap", LiveAddress.parse("127.0.0.1:0"))
        viewer = await Viewer.connect(f"ws://127.0.0.1:{await server.start()}", "run.mcap", protocol)
        assert viewer.socket.subprotocol == protocol
        await server.stop()

    asyncio.run(check())


@pytest.mark.parametrize(
    "request_",
    [
        "[" * 100_000,
        "{}",
        "1",
        '{"op": "subscribe", "subscriptions": 3}',
        '{"op": "subscribe", "subscriptions": [{"channelId": 1e999, "id": 1}]}',
        '{"op": "subscribe", "subscriptions": [{"channelId": NaN, "id": 1}]}',
        f'{{"op": "subscribe", "subscriptions": [{{"channelId": {"9" * 5000}, "id": 1}}]}}',
        '{"op": "unsubscribe", "subscriptionIds": [Infinity]}',
        b"\x00",
        "\u00e9",
    ],
)
def test_a_request_that_is_none_is_answered_and_harms_nobody(whole_log: Path, request_: str | bytes) -> None:
    async def check() -> None:
        log = ScannedFile(whole_log)
        server, viewer = await watch(log, "/truth/veh1")
        await viewer.socket.send(request_)
        while "cannot be understood" not in (message := await viewer.socket.recv()):
            viewer.take(message)
        await server.play(log, server.wanted, (0, 20_000_000), 0.0)
        await viewer.expect("/truth/veh1")
        await server.stop()

    asyncio.run(check())


def test_a_viewer_that_unsubscribes_gets_no_more(whole_log: Path) -> None:
    async def check() -> None:
        log = ScannedFile(whole_log)
        server, viewer = await watch(log, "/truth/veh1")
        number = viewer.channels["/truth/veh1"]["id"]
        await viewer.socket.send(json.dumps({"op": "unsubscribe", "subscriptionIds": [number]}))
        while server.wanted:
            await asyncio.sleep(0.01)
        await server.stop()

    asyncio.run(check())


def test_a_viewer_that_does_not_read_loses_the_oldest_and_holds_up_nobody(
    whole_log: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(foxglove_server, "BACKLOG", 1000)

    async def check() -> tuple[int, int, Viewer]:
        log = ScannedFile(whole_log)
        server, hanging = await watch(log, "/truth/veh1")
        hanging.socket.transport.pause_reading()
        url = f"ws://127.0.0.1:{hanging.socket.remote_address[1]}"
        reading = await Viewer.connect(url, "run.mcap")
        await reading.expect_channels({"/truth/veh1"})
        await reading.subscribe("/truth/veh1")
        taking = asyncio.create_task(reading.rest())
        while len(server._viewers) < 2 or not all(each.subscriptions for each in server._viewers):
            await asyncio.sleep(0.01)
        rounds = 0
        # The system's buffers take the first of them.
        while max(len(each._waiting) for each in server._viewers) < 1000:
            rounds += 1
            await server.play(log, server.wanted, (0, 1_000_000_000), 0.0)
            while len(reading.messages["/truth/veh1"]) < rounds * 100:
                await asyncio.sleep(0)
        await server.play(log, server.wanted, (0, 1_000_000_000), 0.0)
        queued = max(len(each._waiting) for each in server._viewers)
        await server.stop()
        hanging.socket.transport.abort()
        await taking
        return queued, rounds, reading

    queued, rounds, reading = asyncio.run(check())
    assert queued == 1000
    assert len(reading.messages["/truth/veh1"]) == (rounds + 1) * 100
