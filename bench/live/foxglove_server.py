"""The log's messages on the Foxglove WebSocket protocol, with the log's own topics, schemas and times.

Foxglove and Lichtblick connect to it ("Open connection", "Foxglove WebSocket"). foxglove-sdk implements the protocol
and handles viewers that do not read: beyond `BACKLOG` waiting messages it drops the oldest.
Protocol: https://docs.foxglove.dev/docs/sdk/websocket-server
"""

from __future__ import annotations

import asyncio
import itertools
import queue
import time
from collections.abc import Collection, Mapping

import foxglove
import numpy as np
from foxglove.websocket import Capability, ChannelView, Client, ServerListener, WebSocketServer
from mcap.records import Channel, Schema

from bench.errors import BadInput
from bench.mcap.container import MESSAGE, MESSAGE_FIELDS
from bench.mcap.scan import ScannedFile, message_heads

BACKLOG = 1 << 15
"""Messages queued per viewer: about 3 MB, the messages of three vehicles in 3 s."""

SETTLE_S = 0.002
"""Wall-clock time in s that foxglove-sdk has to send its queue."""

LATCHED = ("/scene",)
"""Topics that are written once; a viewer that joins later gets their last message."""


class FoxgloveServer(ServerListener):
    """Serves the messages of one log.

    Attributes:
        port: where it listens.
    """

    def __init__(self, name: str, host: str, port: int) -> None:
        """Listen on `host`, on any free port where `port` is 0.

        Raises:
            BadInput: the address cannot be listened on.
        """
        self._context = foxglove.Context()
        try:
            self._server: WebSocketServer = foxglove.start_server(
                name=name,
                host=host,
                port=port,
                capabilities=[Capability.Time],
                server_listener=self,
                context=self._context,
                message_backlog_size=BACKLOG,
            )
        except RuntimeError as error:
            raise BadInput(f"cannot listen on {host}:{port} for Foxglove: {error}") from error
        self.port = self._server.port
        self._channels: dict[int, foxglove.Channel] = {}
        self._asked: queue.SimpleQueue[str] = queue.SimpleQueue()

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:  # noqa: ARG002 - named by foxglove-sdk
        """Note that a viewer subscribed to a topic; called in a thread of foxglove-sdk."""
        if channel.topic in LATCHED:
            self._asked.put(channel.topic)

    def advertise(self, channels: Mapping[int, Channel], schemas: Mapping[int, Schema]) -> None:
        """Offer the log's channels, by id, that are not offered yet."""
        for number in channels.keys() - self._channels.keys():
            channel, schema = channels[number], schemas.get(channels[number].schema_id)
            if schema is not None:
                self._channels[number] = foxglove.Channel(
                    channel.topic,
                    schema=foxglove.Schema(name=schema.name, encoding=schema.encoding, data=schema.data),
                    message_encoding=channel.message_encoding,
                    metadata=channel.metadata,
                    context=self._context,
                )

    @property
    def wanted(self) -> set[int]:
        """Ids of the log's channels that a viewer wants now."""
        return {number for number, channel in self._channels.items() if channel.has_sinks()}

    def newly_asked(self) -> set[int]:
        """Return the ids of the `LATCHED` channels that a viewer has asked for since the last call."""
        topics = set()
        while not self._asked.empty():
            topics.add(self._asked.get())
        return {number for number, channel in self._channels.items() if channel.topic() in topics}

    async def play(self, log: ScannedFile, wanted: Collection[int], span_ns: tuple[int, int], within_s: float) -> None:
        """Send the messages of these channels from a span of time, spread over `within_s` of wall-clock time.

        Viewers assign a message to the last time they received, and foxglove-sdk has separate queues for times and
        messages: so both get a moment to arrive.
        """
        messages = _messages(log, wanted, span_ns)
        steps = [(time_ns, list(group)) for time_ns, group in itertools.groupby(messages, lambda message: message[0])]
        begun = time.monotonic()
        for number, (time_ns, step) in enumerate(steps, 1):
            self._server.broadcast_time(time_ns)
            await asyncio.sleep(SETTLE_S)
            for _, channel, payload in step:
                self._channels[channel].log(payload, log_time=time_ns)
            await asyncio.sleep(max(SETTLE_S, begun + within_s * number / len(steps) - time.monotonic()))

    def send_last(self, log: ScannedFile, wanted: Collection[int], time_ns: int) -> None:
        """Send the last message of each of these channels in the log as one of `time_ns`."""
        last = {channel: payload for _, channel, payload in _messages(log, wanted)}
        for channel, payload in last.items():
            self._channels[channel].log(payload, log_time=time_ns)

    def stop(self) -> None:
        """Close all connections."""
        self._server.stop()


def _messages(
    log: ScannedFile, wanted: Collection[int], span_ns: tuple[int, int] = (0, 1 << 63)
) -> list[tuple[int, int, bytes]]:
    """Return log_time, channel and payload of the messages of some channels, those of one time as in the file."""
    found: list[tuple[int, int, bytes]] = []
    for number in range(len(log.contents.chunks)):
        data = log.chunk(number)
        if data is None:
            continue
        by_channel = log.messages(number, data)
        offsets = np.sort(np.concatenate([np.empty(0, np.int64), *(by_channel[n] for n in by_channel.keys() & wanted)]))
        heads = message_heads(data, offsets)
        for start, head in zip((offsets + MESSAGE.itemsize).tolist(), heads, strict=True):
            time_ns = int(head["log_time"])
            if span_ns[0] <= time_ns < span_ns[1]:
                payload = data[start : start + int(head["length"]) - MESSAGE_FIELDS].tobytes()
                found.append((time_ns, int(head["channel"]), payload))
    return sorted(found, key=lambda message: message[0])
