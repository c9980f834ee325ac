"""A client of the Foxglove WebSocket protocol that knows nothing of the bench."""

import asyncio
import base64
import json
import struct
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass, field

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from websockets.asyncio.client import ClientConnection, connect
from websockets.typing import Subprotocol

_DATA = struct.Struct("<BIQ")
_TIME = struct.Struct("<BQ")


@dataclass
class Viewer:
    """A client of the Foxglove WebSocket protocol."""

    socket: ClientConnection
    channels: dict[str, dict] = field(default_factory=dict)
    messages: dict[str, list[tuple[int, bytes]]] = field(default_factory=lambda: defaultdict(list))
    times: list[int] = field(default_factory=list)
    # For each message the time that had been told last, and its own.
    shown: list[tuple[int, int]] = field(default_factory=list)

    @classmethod
    async def connect(cls, url: str, name: str, protocol: str = "foxglove.sdk.v1") -> "Viewer":
        """Connect to a server, which is to have this name."""
        socket = await connect(url, subprotocols=[Subprotocol(protocol)], max_size=None)
        info = json.loads(await socket.recv())
        assert (info["op"], info["name"], info["capabilities"]) == ("serverInfo", name, ["time"])
        return cls(socket)

    async def expect_channels(self, topics: Iterable[str]) -> None:
        """Take what comes until these topics have been offered."""
        wanted = set(topics)
        while not wanted <= self.channels.keys():
            self.take(await asyncio.wait_for(self.socket.recv(), 30.0))

    async def expect(self, topic: str) -> None:
        """Take what comes until a message of the topic has."""
        before = len(self.messages[topic])
        while len(self.messages[topic]) == before:
            self.take(await asyncio.wait_for(self.socket.recv(), 30.0))

    async def rest(self) -> None:
        """Take all that comes until the server closes."""
        async for message in self.socket:
            self.take(message)

    def take(self, message: str | bytes) -> None:
        if isinstance(message, str):
            for channel in json.loads(message).get("channels", []):
                self.channels[channel["topic"]] = channel
        elif message[0] == 1:
            _, subscription, time_ns = _DATA.unpack_from(message)
            topic = next(name for name, channel in self.channels.items() if channel["id"] == subscription)
            self.messages[topic].append((time_ns, message[_DATA.size :]))
            self.shown.append((self.times[-1] if self.times else -1, time_ns))
        else:
            self.times.append(_TIME.unpack(message)[1])

    async def subscribe(self, *topics: str) -> None:
        """Ask for topics; a subscription has the number of its channel."""
        numbers = [self.channels[topic]["id"] for topic in topics]
        asked = [{"id": number, "channelId": number} for number in numbers]
        await self.socket.send(json.dumps({"op": "subscribe", "subscriptions": asked}))

    def decoded(self, topic: str, name: str) -> list[float]:
        """Values of a field, by the schema that the server has advertised."""
        channel = self.channels[topic]
        assert (channel["encoding"], channel["schemaEncoding"]) == ("protobuf", "protobuf")
        pool = descriptor_pool.DescriptorPool()
        for file in descriptor_pb2.FileDescriptorSet.FromString(base64.b64decode(channel["schema"])).file:
            pool.Add(file)
        kind = message_factory.GetMessageClass(pool.FindMessageTypeByName(channel["schemaName"]))
        return [getattr(kind.FromString(payload), name) for _, payload in self.messages[topic]]
