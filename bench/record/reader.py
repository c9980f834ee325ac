"""A recorded run, read back: signals, truth and frames as numpy arrays.

A log that was cut off (a killed run) is read up to its last whole chunk, after one warning.
"""

from __future__ import annotations

import json
import tomllib
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from google.protobuf.message import DecodeError, Message
from mcap.records import Channel, Schema

from bench.errors import BadInput
from bench.record import can_frame, foxglove
from bench.record.can_frame import Frame
from bench.record.container import MESSAGE, MESSAGE_FIELDS
from bench.record.file_scan import ScannedFile, message_heads
from bench.record.layout import Layout, message_class

if TYPE_CHECKING:
    from bench.scenario import Scenario

CACHED_BYTES = 64 * 1024 * 1024
"""Unpacked chunks kept in memory at most; a run of 10 s is about 15 MB."""

FRAME_TABLE = np.dtype(
    [
        ("time", "<i8"),
        ("receive", "<i8"),
        ("wire", "<i8"),
        ("response", "<i8"),
        ("can_id", "<u4"),
        ("length", "u1"),
        ("data", "u1", (can_frame.MAX_DATA,)),
    ]
)
"""One frame of `Run.frame_table`: times in ns as in `can_frame.Frame`, data padded with zeros."""


class Columns(dict[str, npt.NDArray[Any]]):
    """The values of a topic by name, each (n,), and `t`, the time in s.

    Asking for a value that the topic does not have raises BadInput, as the log is not what it should be.
    """

    def __init__(self, where: str, values: Mapping[str, npt.NDArray[Any]]) -> None:
        super().__init__(values)
        self._where = where

    def select(self, rows: npt.NDArray[Any]) -> Columns:
        """Return these rows of all values."""
        return Columns(self._where, {name: values[rows] for name, values in self.items()})

    def __missing__(self, name: str) -> npt.NDArray[Any]:
        """Refuse a value the topic does not have."""
        raise BadInput(f"{self._where} has no {name!r}; it has {', '.join(key for key in self if key != 't')}")


class LogDamaged(UserWarning):
    """A log is cut off or damaged; what could be read was."""


@dataclass(frozen=True)
class Event:
    """Something that happened: `level` as in `foxglove.LEVELS`, `source` who says so."""

    time_s: float
    level: str
    source: str
    text: str


class Run:
    """One run's log.

    Attributes:
        path: the file.
        damage: what is wrong with the file, empty for a whole one.
        attachments: file name -> content.
        result: what the run ended with; empty where it was cut off.
        metadata: all metadata of the run and its result, flat.
        topics: topic -> channel, of everything that was recorded.
    """

    def __init__(self, path: Path | str) -> None:
        """Open a log.

        Raises:
            BadInput: the file cannot be read or is not a log.
        """
        self.path = Path(path)
        self._file = ScannedFile(self.path)
        contents = self._file.contents
        self.damage = contents.damage
        self._warned = False
        self.attachments = contents.attachments
        self.result = contents.metadata.get("result", {})
        self.metadata = {**contents.metadata.get("run", {}), **self.result}
        self.topics: dict[str, Channel] = {channel.topic: channel for channel in contents.channels.values()}
        if self.damage:
            self._warn(self.damage)
        kept = max(1, CACHED_BYTES // max((place.size for place in contents.chunks), default=CACHED_BYTES))
        self._chunk = lru_cache(kept)(self._read_chunk)
        self._columns: dict[str, Columns] = {}

    @property
    def vehicles(self) -> int:
        """Number of vehicles."""
        try:
            return int(self.metadata["vehicles"])
        except (KeyError, ValueError) as error:
            raise BadInput(f"{self.path} is not a run's log: its metadata has no number of vehicles") from error

    @property
    def buses(self) -> list[str]:
        """Names of the buses with frames, in their order."""
        found = [channel for topic, channel in self.topics.items() if topic.startswith("/can/")]
        return [channel.topic.removeprefix("/can/") for channel in sorted(found, key=lambda channel: channel.id)]

    @cached_property
    def events(self) -> list[Event]:
        """What happened, in order."""
        names = {number: name for name, number in foxglove.LEVELS.items()}
        return [
            Event(time_ns / 1e9, names.get(log.level, "info"), log.name, log.message)
            for time_ns, log in self._parsed("/events")
        ]

    @cached_property
    def scenario_text(self) -> str:
        """The scenario as TOML, whole, with all defaults.

        Raises:
            BadInput: the log carries none.
        """
        try:
            return self.attachments["scenario.toml"].decode()
        except (KeyError, UnicodeDecodeError) as error:
            raise BadInput(
                f"{self.path} is not the log of a run, or what was recorded of it ends before the scenario"
            ) from error

    @cached_property
    def scenario(self) -> Scenario:
        """The scenario of the run, validated.

        Raises:
            BadInput: the log carries none that this version can read.
        """
        # Logs are also read where no scenario is wanted, and its validation takes a while to import.
        from bench.scenario import Scenario

        try:
            return Scenario.model_validate_json(json.dumps(tomllib.loads(self.scenario_text)))
        except ValueError as error:
            raise BadInput(f"{self.path}: the scenario attached to it cannot be read: {error}") from error

    def messages(self, bus: str) -> list[str]:
        """Return the names of the messages recorded decoded on `bus`, in the order of their identifiers."""
        prefix = f"/signals/{bus}/"
        found = [topic for topic in self.topics if topic.startswith(prefix)]
        names = [topic.removeprefix(prefix) for topic in found]
        return sorted(names, key=lambda name: (self.can_id(bus, name), name))

    def can_id(self, bus: str, message: str) -> int:
        """Return the identifier of a message, -1 where the log does not tell.

        Raises:
            BadInput: no such message was recorded.
        """
        try:
            return int(self._channel(f"/signals/{bus}/{message}").metadata["can_id"], 16)
        except (KeyError, ValueError):
            return -1

    def has(self, bus: str, message: str) -> bool:
        """Return whether `message` was recorded on `bus`."""
        return f"/signals/{bus}/{message}" in self.topics

    def message(self, bus: str, message: str) -> Columns:
        """Return all signals of a message, by name, and `t`, the time in s; each (n,).

        Raises:
            BadInput: no such message was recorded.
        """
        return self._table(f"/signals/{bus}/{message}")

    def signal(self, bus: str, message: str, signal: str) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        """Return the times (n,) in s and the physical values (n,) of a signal.

        Raises:
            BadInput: no such signal was recorded.
        """
        columns = self.message(bus, message)
        return columns["t"], columns[signal].astype(np.float64)

    def truth(self, vehicle: int) -> Columns:
        """Return a vehicle's true values by their FMU name, and `t`, the time in s; each (n,).

        Raises:
            BadInput: none was recorded.
        """
        return self._table(f"/truth/veh{vehicle}")

    def unit(self, topic: str, name: str) -> str:
        """Return the unit of a value in the topic, empty for none."""
        return str(self._channel(topic).metadata.get(f"unit {name}", ""))

    def wall_clock_ids(self, bus: str) -> set[int]:
        """Return the identifiers on `bus` whose frames carry wall-clock figures, which differ from run to run."""
        return {self.can_id(bus, message) for message in self.messages(bus) if self.is_wall_clock(bus, message)}

    def is_wall_clock(self, bus: str, message: str) -> bool:
        """Return whether a message carries wall-clock figures.

        Raises:
            BadInput: no such message was recorded.
        """
        return bool(self._channel(f"/signals/{bus}/{message}").metadata.get("wall_clock") == "yes")

    def frame_table(self, bus: str) -> npt.NDArray[Any]:
        """Return all raw frames of a bus in the order of the file, as `FRAME_TABLE`.

        Raises:
            BadInput: no frame was recorded there.
        """
        channel = self._channel(f"/can/{bus}").id
        numbers = range(len(self._file.contents.chunks))
        return np.concatenate([np.empty(0, FRAME_TABLE), *(self._frames_of_chunk(n, channel)[1] for n in numbers)])

    def frames(self) -> Iterator[Frame]:
        """Give every raw frame in the order of the file, in bounded memory."""
        buses = {self.topics[f"/can/{bus}"].id: bus for bus in self.buses}
        for number in range(len(self._file.contents.chunks)):
            tables, places, names = [], [], []
            for channel, bus in buses.items():
                offsets, table = self._frames_of_chunk(number, channel)
                tables.append(table)
                places.append(offsets)
                names += [bus] * len(offsets)
            if not names:
                continue
            table = np.concatenate(tables)
            for index in np.argsort(np.concatenate(places)).tolist():
                row = table[index]
                data = row["data"].tobytes()[: int(row["length"])]
                yield Frame(
                    time_ns=int(row["time"]),
                    bus=names[index],
                    can_id=int(row["can_id"]),
                    data=data,
                    receive_ns=int(row["receive"]),
                    wire_ns=int(row["wire"]),
                    response_ns=int(row["response"]),
                )

    def _frames_of_chunk(self, number: int, channel: int) -> tuple[npt.NDArray[np.int64], npt.NDArray[Any]]:
        data, messages = self._chunk(number)
        offsets = messages.get(channel, np.empty(0, np.int64))
        table = np.zeros(len(offsets), FRAME_TABLE)
        if len(offsets):
            heads = message_heads(data, offsets)
            table["time"] = heads["log_time"].astype(np.int64)
            if not can_frame.read(data, offsets + MESSAGE.itemsize, heads["length"] - MESSAGE_FIELDS, table):
                raise BadInput(f"{self.path}: chunk {number} has frames that are not {can_frame.NAME}")
        return offsets, table

    def _table(self, topic: str) -> Columns:
        if topic not in self._columns:
            self._columns[topic] = self._read_table(self._channel(topic))
        return self._columns[topic]

    def _read_table(self, channel: Channel) -> Columns:
        kind = self._message_class(channel)
        layout = Layout.of(kind)
        names = [field.name for field in kind.DESCRIPTOR.fields]
        times, parts = [], []
        for number in range(len(self._file.contents.chunks)):
            data, messages = self._chunk(number)
            offsets = messages.get(channel.id)
            if offsets is None:
                continue
            heads = message_heads(data, offsets)
            times.append(heads["log_time"].astype(np.int64))
            parts.append(_flat(data, offsets, heads["length"], layout) if layout else None)
            if parts[-1] is None:
                parts[-1] = self._parse_flat(data, offsets, heads["length"], kind, names)
        columns = {"t": np.concatenate(times) / 1e9 if times else np.empty(0)}
        for name in names:
            columns[name] = np.concatenate([part[name] for part in parts if part is not None]) if parts else np.empty(0)
        return Columns(f"{self.path}: topic {channel.topic}", columns)

    def _parse_flat(
        self,
        data: npt.NDArray[np.uint8],
        offsets: npt.NDArray[np.int64],
        lengths: npt.NDArray[np.uint64],
        kind: type[Message],
        names: list[str],
    ) -> dict[str, npt.NDArray[Any]]:
        """Decode messages that another writer encoded in its own way."""
        rows = [self._parse(kind, payload) for payload in _payloads(data, offsets, lengths)]
        return {name: np.array([getattr(row, name) for row in rows]) for name in names}

    def _parse(self, kind: type[Message], payload: bytes) -> Message:
        try:
            return kind.FromString(payload)
        except DecodeError as error:
            raise BadInput(f"{self.path}: a message {kind.DESCRIPTOR.full_name} cannot be decoded: {error}") from error

    def _parsed(self, topic: str) -> Iterator[tuple[int, Any]]:
        """Give time in ns and message of a topic, one by one; nothing where the topic was not recorded."""
        if topic not in self.topics:
            return
        channel = self.topics[topic]
        kind = self._message_class(channel)
        for number in range(len(self._file.contents.chunks)):
            data, messages = self._chunk(number)
            offsets = messages.get(channel.id)
            if offsets is not None:
                heads = message_heads(data, offsets)
                payloads = _payloads(data, offsets, heads["length"])
                for time_ns, payload in zip(heads["log_time"].tolist(), payloads, strict=True):
                    yield time_ns, self._parse(kind, payload)

    def _message_class(self, channel: Channel) -> type[Message]:
        schema: Schema | None = self._file.contents.schemas.get(channel.schema_id)
        if schema is None or schema.encoding != "protobuf":
            raise BadInput(f"{self.path}: topic {channel.topic} has no protobuf schema")
        try:
            return message_class(schema.name, schema.data)
        except ValueError as error:
            raise BadInput(f"{self.path}: {error}") from error

    def _channel(self, topic: str) -> Channel:
        try:
            return self.topics[topic]
        except KeyError:
            near = sorted(name for name in self.topics if name.startswith(topic.rpartition("/")[0]))
            have = ", ".join(near or sorted(self.topics)) or "nothing"
            raise BadInput(f"{self.path} has no topic {topic}; recorded are {have}") from None

    def _read_chunk(self, number: int) -> tuple[npt.NDArray[np.uint8], dict[int, npt.NDArray[np.int64]]]:
        data = self._file.chunk(number)
        if data is None:
            self._warn(f"chunk {number} is damaged and left out")
            return np.empty(0, np.uint8), {}
        return data, self._file.messages(number, data)

    def _warn(self, what: str) -> None:
        """Warn once a log."""
        if not self._warned:
            self._warned = True
            warnings.warn(f"{self.path}: {what}", LogDamaged, stacklevel=4)
        self.damage = self.damage or what


def _flat(
    data: npt.NDArray[np.uint8], offsets: npt.NDArray[np.int64], lengths: npt.NDArray[np.uint64], layout: Layout
) -> Any:
    """Return the messages of one chunk as a structured array, None where they are not in this layout."""
    size = layout.dtype.itemsize
    if (lengths != size + MESSAGE_FIELDS).any():
        return None
    return layout.view(data[offsets[:, None] + (MESSAGE.itemsize + np.arange(size))])


def _payloads(
    data: npt.NDArray[np.uint8], offsets: npt.NDArray[np.int64], lengths: npt.NDArray[np.uint64]
) -> Iterator[bytes]:
    for start, length in zip(offsets.tolist(), lengths.tolist(), strict=True):
        yield data[start + MESSAGE.itemsize : start + MESSAGE.itemsize + length - MESSAGE_FIELDS].tobytes()
