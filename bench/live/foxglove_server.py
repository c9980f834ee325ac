"""The log's messages on the Foxglove WebSocket protocol, with the log's own topics, schemas and times.

Foxglove and Lichtblick connect to it ("Open connection", "Foxglove WebSocket"); `door` says who may. A viewer that
does not read loses the oldest of more than `BACKLOG` waiting messages; one that answers no ping is disconnected.
Protocol: https://docs.foxglove.dev/docs/sdk/websocket-server
"""

from __future__ import annotations

import asyncio
import base64
import itertools
import json
import struct
import time
from collections import deque
from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
from mcap.records import Channel, Schema
from websockets.asyncio.server import Server, ServerConnection, serve
from websockets.exceptions import ConnectionClosed, InvalidState
from websockets.http11 import Request, Response
from websockets.typing import Subprotocol

from bench.errors import BadInput
from bench.live.address import LiveAddress
from bench.live.door import VIEWERS, Door, Limits
from bench.mcap.records import MESSAGE, MESSAGE_FIELDS
from bench.mcap.scan import ScannedFile, message_heads

BACKLOG = 1 << 15
"""Messages queued per viewer: about 3 MB, the messages of three vehicles in 3 s."""

BACKLOG_BYTES = 16 * 1024 * 1024
"""Bytes queued per viewer."""

LATCHED = ("/scene",)
"""Topics that are written once; a viewer that joins later gets their last message."""

SUBPROTOCOLS = (Subprotocol("foxglove.sdk.v1"), Subprotocol("foxglove.websocket.v1"))
"""Names of the protocol: Foxglove's own, and the one that Lichtblick and older versions of Foxglove ask for."""

MOST_REQUEST_BYTES = 1 << 20
"""Size of a viewer's message; a subscription to all topics of sixteen vehicles takes a twentieth of it."""

BATCH = 64
"""Messages written to a viewer's socket at a time."""

_MESSAGE = struct.Struct("<BIQ")
_TIME = struct.Struct("<BQ")
_MESSAGE_OPCODE, _TIME_OPCODE = 1, 2


class _Viewer:
    """One connection: its subscriptions, and what it has still to be sent.

    Attributes:
        subscriptions: channel -> ids of its subscriptions.
    """

    def __init__(self, connection: ServerConnection) -> None:
        self.subscriptions: dict[int, set[int]] = {}
        self._connection = connection
        self._control: deque[str] = deque()
        self._waiting: deque[bytes] = deque()
        self._waiting_bytes = 0
        self._more = asyncio.Event()

    def tell(self, text: dict[str, Any]) -> None:
        """Queue a message about the server or its channels."""
        self._control.append(json.dumps(text))
        self._more.set()

    def send(self, data: bytes) -> None:
        """Queue a message or a time; drop the oldest of too many."""
        self._waiting.append(data)
        self._waiting_bytes += len(data)
        while len(self._waiting) > BACKLOG or self._waiting_bytes > BACKLOG_BYTES:
            self._waiting_bytes -= len(self._waiting.popleft())
        self._more.set()

    @property
    def idle(self) -> bool:
        """Whether nothing waits to be sent."""
        return not (self._control or self._waiting)

    async def sending(self) -> None:
        """Send what is queued, for as long as the connection is open."""
        while True:
            await self._more.wait()
            self._more.clear()
            while self._control:
                await self._connection.send(self._control.popleft())
            while self._waiting and not self._control:
                await self._send_batch()

    async def _send_batch(self) -> None:
        """Send some messages with one call of the system: of three vehicles there are thousands a second."""
        for _ in range(min(BATCH, len(self._waiting))):
            data = self._waiting.popleft()
            self._waiting_bytes -= len(data)
            self._connection.protocol.send_binary(data)
        self._connection.send_data()
        await self._connection.drain()


class FoxgloveServer:
    """Serves the messages of one log: `start`, then what there is, and `stop`."""

    def __init__(self, name: str, address: LiveAddress, limits: Limits | None = None) -> None:
        """Serve a log of this name at `address`."""
        self._name = name
        self._address = address
        self.door = Door(address, {*VIEWERS, *address.origins}, limits)
        self._session = str(time.time_ns())
        self._server: Server | None = None
        self._viewers: set[_Viewer] = set()
        self._channels: dict[int, dict[str, Any]] = {}
        self._asked: set[int] = set()

    async def start(self) -> int:
        """Listen; return the port.

        Raises:
            BadInput: the address cannot be listened on.
        """
        host, port = self._address.host, self._address.foxglove_port
        try:
            self._server = await serve(
                self._serve,
                host,
                port,
                subprotocols=SUBPROTOCOLS,
                process_request=self._answer,
                max_size=MOST_REQUEST_BYTES,
                **self.door.settings(),
            )
        except OSError as error:
            raise BadInput(f"cannot listen on {host}:{port} for Foxglove: {error.strerror or error}") from error
        return int(self._server.sockets[0].getsockname()[1])

    def advertise(self, channels: Mapping[int, Channel], schemas: Mapping[int, Schema]) -> None:
        """Offer the log's channels, by id, that are not offered yet."""
        new = []
        for number in channels.keys() - self._channels.keys():
            channel, schema = channels[number], schemas.get(channels[number].schema_id)
            if schema is not None:
                self._channels[number] = _offer(number, channel, schema)
                new.append(self._channels[number])
        for viewer in self._viewers if new else ():
            viewer.tell({"op": "advertise", "channels": new})

    @property
    def wanted(self) -> set[int]:
        """Ids of the log's channels that a viewer wants now."""
        return {channel for viewer in self._viewers for channel in viewer.subscriptions}

    def newly_asked(self) -> set[int]:
        """Return the ids of the `LATCHED` channels that a viewer has asked for since the last call."""
        asked, self._asked = self._asked, set()
        return asked

    async def play(self, log: ScannedFile, wanted: Collection[int], span_ns: tuple[int, int], within_s: float) -> None:
        """Send the messages of these channels from a span of time, spread over `within_s` of wall-clock time.

        Viewers assign a message to the last time they received.
        """
        messages = _messages(log, wanted, span_ns)
        steps = [(time_ns, list(group)) for time_ns, group in itertools.groupby(messages, lambda message: message[0])]
        begun = time.monotonic()
        for number, (time_ns, step) in enumerate(steps, 1):
            for viewer in self._viewers:
                viewer.send(_TIME.pack(_TIME_OPCODE, time_ns))
            for _, channel, payload in step:
                self._send(channel, time_ns, payload)
            await asyncio.sleep(max(0.0, begun + within_s * number / len(steps) - time.monotonic()))

    def send_last(self, log: ScannedFile, wanted: Collection[int], time_ns: int) -> None:
        """Send the last message of each of these channels in the log as one of `time_ns`."""
        last = {channel: payload for _, channel, payload in _messages(log, wanted)}
        for channel, payload in last.items():
            self._send(channel, time_ns, payload)

    async def stop(self, within_s: float = 0.5) -> None:
        """Let viewers receive what is queued, for at most this wall-clock time (s), and close all connections."""
        end = time.monotonic() + within_s
        while any(not viewer.idle for viewer in self._viewers) and time.monotonic() < end:
            await asyncio.sleep(0.01)
        if self._server is not None:
            self._server.close()
            await self._server.wait_closed()

    def _send(self, channel: int, time_ns: int, payload: bytes) -> None:
        for viewer in self._viewers:
            for subscription in viewer.subscriptions.get(channel, ()):
                viewer.send(_MESSAGE.pack(_MESSAGE_OPCODE, subscription, time_ns) + payload)

    def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """Refuse a request; None lets the WebSocket be opened."""
        refusal = self.door.refusal_of_origin(request.headers)
        if refusal is not None:
            return connection.respond(403, refusal)
        offered = ",".join(request.headers.get_all("Sec-WebSocket-Protocol"))
        if not {name.strip() for name in offered.split(",")} & {*SUBPROTOCOLS}:
            return connection.respond(400, f"This is a server of the protocol {' or '.join(SUBPROTOCOLS)}.\n")
        return None

    async def _serve(self, connection: ServerConnection) -> None:
        viewer = _Viewer(connection)
        viewer.tell({"op": "serverInfo", "name": self._name, "capabilities": ["time"], "sessionId": self._session})
        if self._channels:
            viewer.tell({"op": "advertise", "channels": list(self._channels.values())})
        self._viewers.add(viewer)
        sending = asyncio.create_task(viewer.sending())
        hearing = asyncio.create_task(self._hear(viewer, connection))
        try:
            await asyncio.wait({sending, hearing}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            self._viewers.discard(viewer)
            for task in (sending, hearing):
                task.cancel()
            ended = await asyncio.gather(sending, hearing, return_exceptions=True)
        for result in ended:
            if isinstance(result, Exception) and not isinstance(result, (ConnectionClosed, InvalidState, OSError)):
                raise result

    async def _hear(self, viewer: _Viewer, connection: ServerConnection) -> None:
        async for request in connection:
            try:
                self._take(viewer, request)
            except (ValueError, TypeError, KeyError, AttributeError, OverflowError, RecursionError):
                viewer.tell({"op": "status", "level": 2, "message": "a request that cannot be understood"})

    def _take(self, viewer: _Viewer, request: str | bytes) -> None:
        """Take a viewer's request.

        Raises:
            ValueError, TypeError, KeyError, AttributeError, OverflowError, RecursionError: it is none of the protocol.
        """
        asked = json.loads(request)
        if asked["op"] == "subscribe":
            for each in asked["subscriptions"]:
                self._subscribe(viewer, int(each["channelId"]), int(each["id"]))
        elif asked["op"] == "unsubscribe":
            gone = set(map(int, asked["subscriptionIds"]))
            kept = {channel: ids - gone for channel, ids in viewer.subscriptions.items()}
            viewer.subscriptions = {channel: ids for channel, ids in kept.items() if ids}

    def _subscribe(self, viewer: _Viewer, channel: int, subscription: int) -> None:
        if channel not in self._channels or not 0 <= subscription < 1 << 32:
            raise ValueError(f"no channel {channel}")
        # As the protocol has it: one subscription to a channel.
        viewer.subscriptions.setdefault(channel, {subscription})
        if self._channels[channel]["topic"] in LATCHED:
            self._asked.add(channel)


def _offer(number: int, channel: Channel, schema: Schema) -> dict[str, Any]:
    """Return a channel as the protocol has it; a binary schema is in base64."""
    is_text = schema.encoding in ("jsonschema", "ros1msg", "ros2msg", "ros2idl", "omgidl")
    return {
        "id": number,
        "topic": channel.topic,
        "encoding": channel.message_encoding,
        "schemaName": schema.name,
        "schema": schema.data.decode(errors="replace") if is_text else base64.b64encode(schema.data).decode(),
        "schemaEncoding": schema.encoding,
        "metadata": channel.metadata,
    }


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
