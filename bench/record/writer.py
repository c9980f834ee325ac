"""The recorder: writes a run to one MCAP file, fast enough to run in the conductor's process.

Frames and truth rows are buffered on arrival (under 1 us each); all that follows from them (times on the wire, signals,
poses) is computed in batches, by compiled loops. Data is written, in the chunks of `bench.mcap.chunking`, when half a
second old. A killed run loses at most that. With a `BusTimeline`, frames get their times on the wire, and are logged in
that order within their cycle.

Topics: `/can/<bus>` raw frames, `/signals/<bus>/<Message>` the decoded signals, `/truth/veh<i>`, `/tf`, `/scene`,
`/plan/veh<i>`, `/events`, `/events/data`, `/processes/<name>`. log_time and publish_time are simulated time in ns; the
host's receive time is in the frame.
"""

from __future__ import annotations

import logging
import time
import tomllib
from array import array
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path
from types import TracebackType
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate

from bench.bus.codec import Codec
from bench.bus.frame import BusFrame
from bench.bus.wire.timing import BusTimeline, FrameBuffer
from bench.errors import RunFailed
from bench.events import Event
from bench.files import already_exists
from bench.mcap.chunking import ChunkGroups
from bench.mcap.container import McapFile, media_type, storable
from bench.mcap.gathering import scatter
from bench.mcap.records import MESSAGE, Records, Templates
from bench.record import can_frame, dbc_files, foxglove, process_usage
from bench.record import event as event_record
from bench.record.layout import Field, Layout, file_descriptor_set
from bench.record.process_usage import ProcessUsage
from bench.record.signals import SignalMessage, SignalTable, signal_message

CHUNK_BYTES = 64 * 1024
BATCH_BYTES = 256 * 1024
"""Buffered data is encoded when it has about this size, if it is not written before."""
FLUSH_S = 0.5
"""Data older than this, by the host's clock or by simulated time, is written; by the latter only full chunks."""
PLAN_MESSAGE = "PlannerTarget"

# Average bytes of a frame in a chunk, raw and decoded; only sets when a chunk counts as full.
_BYTES_A_FRAME = 150

_log = logging.getLogger(__name__)

_T = TypeVar("_T")

_Message = tuple[int, int, bytes]
"""Channel, time in ns and payload."""
_time = itemgetter(1)


@dataclass(frozen=True)
class _Decoded:
    """One DBC message on one bus: its decoded channel and its place in the template and signal tables."""

    channel: int
    template: int
    message: int
    length: int


class RunWriter:
    """Writes one run.

    Use as a context manager, or call `close`. Not thread-safe.
    """

    def __init__(
        self,
        path: Path,
        *,
        codecs: Mapping[str, Codec],
        truth_names: Sequence[str],
        vehicles: int,
        metadata: Mapping[str, str],
        attachments: Mapping[str, bytes],
        truth_units: Mapping[str, str] | None = None,
        timeline: BusTimeline | None = None,
    ) -> None:
        """Create the file and write the data known before the run.

        Args:
            path: file to create; it must not exist.
            codecs: bus name -> codec.
            truth_names: names of the values of a truth row, in order; X, Y, psi and phi among them give the poses.
            vehicles: number of vehicles.
            metadata: description of the run: versions, seed, host, clock ...
            attachments: file name -> content, besides the codecs' DBC files; lanes for the scene are read from
                `scenario.toml`.
            truth_units: unit of each truth value that has one.
            timeline: created for the same codecs; None leaves frames without times on the wire, in the order of
                arrival.

        Raises:
            RunFailed: the file cannot be created.
            BadInput: the file exists, or the log cannot hold a DBC message.
        """
        self._path = path
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._stream = path.open("xb")
        except FileExistsError as error:
            # Checked before; another process has created it since.
            raise already_exists(path, "--out") from error
        except OSError as error:
            raise RunFailed(f"cannot write the log {path}: {error.strerror or error}") from error
        self._vehicles = vehicles
        self._timeline = timeline
        self._closed = False
        self._file = self._guard(lambda: McapFile(self._stream, "platoon"))
        dbc_names, files = dbc_files.attached_files(codecs, attachments)
        self._guard(lambda: self._write_head(metadata, files))
        self._make_can_channels(codecs, dbc_names)
        self._make_truth_channels(truth_names, truth_units or {})
        self._rest_group = len(codecs) + 2
        self._group = self._groups_of_channels()
        self._pending = FrameBuffer(codecs)
        self._pending_truth: list[tuple[int, int, array[float]]] = []
        self._pending_other: list[_Message] = []
        self._pending_bytes = 0
        self._newest = -1
        self._poses: dict[int, tuple[int, array[float]]] = {}
        self._process_channels: dict[str, int] = {}
        # Channels are numbered from 1.
        self._sequence = np.zeros(self._channels + 1, np.int64)
        self._groups = ChunkGroups(CHUNK_BYTES)
        self._flushed_at = time.monotonic()
        self._flushed_ns = 0
        self._lanes = _lanes(attachments.get("scenario.toml", b""))
        self._scene_written = False

    def __enter__(self) -> RunWriter:
        """Return the writer itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close the file, with status `failed` after an exception."""
        if not self._closed:
            self.close({"status": "failed" if error else "done"})

    def frame(self, bus: str, time_ns: int, can_id: int, data: bytes, receive_ns: int) -> None:
        """Record one frame; see `frames`."""
        self.frames(time_ns, [BusFrame(bus, can_id, data)], [receive_ns])

    def frames(self, time_ns: int, frames: Sequence[BusFrame], receive_ns: Sequence[int]) -> None:
        """Record frames of one time.

        Args:
            time_ns: simulated time.
            frames: (n,) bus name (one of the codecs'), identifier and data, at most 8 bytes; a `RefusedFrame` is
                recorded, but not decoded.
            receive_ns: (n,) arrival time of each by the host's clock.

        Raises:
            ValueError: a frame has more than 8 bytes; then none of these frames is recorded.
            RunFailed: the file cannot be written.
        """
        self._make_room(time_ns, _BYTES_A_FRAME * len(frames))
        self._pending.add(time_ns, frames, receive_ns)

    def truth(self, vehicle: int, time_ns: int, values: Sequence[float] | npt.NDArray[np.float64]) -> None:
        """Record a truth row: the values of `truth_names`, in that order.

        Raises:
            ValueError: the row does not have as many values as there are names.
            RunFailed: the file cannot be written.
        """
        if len(values) != self._truth_count:
            raise ValueError(f"truth row of {len(values)} values, not {self._truth_count}")
        self._make_room(time_ns, self._truth_bytes)
        self._pending_truth.append((vehicle, time_ns, array("d", values)))

    def event(self, time_ns: int, event: Event) -> None:
        """Record an event: for people on `/events`, for programs on `/events/data`.

        Raises:
            ValueError: an unknown level, or fields that JSON cannot hold.
            RunFailed: the file cannot be written.
        """
        if event.level not in foxglove.LEVELS:
            raise ValueError(f"event level {event.level!r}: allowed are {', '.join(foxglove.LEVELS)}")
        data = event_record.encoded(event)
        self._other(
            self._event_channel, time_ns, foxglove.log(time_ns, event.level, event.source, storable(event.text))
        )
        self._other(self._event_data_channel, time_ns, data)

    def process(self, name: str, time_ns: int, usage: ProcessUsage) -> None:
        """Record the processor usage of the process `name`.

        Raises:
            RunFailed: the file cannot be written.
        """
        if name not in self._process_channels:
            schema = self._file.add_schema(process_usage.NAME, process_usage.SCHEMA)
            channel = self._file.add_channel(f"/processes/{name}", schema, process_usage.UNITS)
            self._process_channels[name] = channel
            self._sequence = np.append(self._sequence, 0)
            self._group = np.append(self._group, self._rest_group)
        self._other(self._process_channels[name], time_ns, usage.encoded())

    def flush(self) -> None:
        """Write all buffered data, through to the operating system.

        Called by the writer itself when `FLUSH_S` have passed and data of a later cycle arrives; call it also between
        two cycles while waiting for a missing frame.

        Raises:
            RunFailed: the file cannot be written.
        """
        self._flushed_at = time.monotonic()
        self._flushed_ns = self._newest
        if self._pending_bytes:
            self._encode_pending(self._on_the_wire())
        self._write_chunks()

    def _encode_pending(self, frames: npt.NDArray[Any]) -> None:
        # If the bus was busy, all frames received may be on the wire only in the next cycle.
        others = [*self._pending_other, *self._transforms(), *self._add_frames(frames)]
        self._add_truth()
        self._add_others(others)
        self._pending_truth.clear()
        self._pending_other.clear()
        self._pending_bytes = 0

    def _write_chunks(self) -> None:
        def write() -> None:
            for chunk in self._groups.take():
                self._file.add_chunk(chunk.data.data, chunk.channel, chunk.log_time, chunk.offset)

        self._guard(write)

    def close(self, result: Mapping[str, str]) -> None:
        """Write pending data, the result as metadata `result`, the summary, and close the file.

        Raises:
            RunFailed: the file cannot be written.
        """
        if self._closed:
            return
        try:
            self.flush()
            self._encode_pending(self._on_the_wire(last=True))
            self._write_chunks()
            self._guard(lambda: self._file.add_metadata("result", result))
            self._guard(self._file.finish)
        finally:
            self._closed = True
            self._stream.close()

    def _write_head(self, metadata: Mapping[str, str], attachments: Mapping[str, bytes]) -> None:
        self._file.add_metadata("run", {"vehicles": str(self._vehicles), **metadata})
        for name, data in attachments.items():
            self._file.add_attachment(name, media_type(name), data)

    def _make_can_channels(self, codecs: Mapping[str, Codec], dbc_names: Mapping[str, str]) -> None:
        """Register a raw channel per bus and a decoded one per bus and message, with their templates."""
        raw_schema = self._file.add_schema(can_frame.NAME, can_frame.SCHEMA)
        # Templates 0..8 are raw frames of that many bytes, followed by the decoded messages, then truth.
        templates = [can_frame.template(length) for length in range(9)]
        messages: list[SignalMessage] = []
        places: dict[tuple[str, bytes], int] = {}
        # `veh1` and `veh2` share their schemas, as `veh`.
        described: dict[tuple[str, bytes], list[SignalMessage]] = {}
        self._raw_channels: list[int] = []
        self._plan_channels: dict[int, tuple[str, int, SignalMessage]] = {}
        decoded: dict[int, _Decoded] = {}
        poses_schema = self._file.add_schema(*foxglove.schema(PosesInFrame))
        for number, (bus, codec) in enumerate(codecs.items()):
            about = {"bus": bus, dbc_files.METADATA: dbc_names[bus]}
            self._raw_channels.append(self._file.add_channel(f"/can/{bus}", raw_schema, about))
            package = f"platoon.{bus.rstrip('0123456789')}"
            form = package, codec.dbc
            if form not in described:
                described[form] = [signal_message(package, codec, name) for name in codec.names]
            for message in described[form]:
                place = places.setdefault((message.schema_name, message.schema), len(messages))
                if place == len(messages):
                    messages.append(message)
                    templates.append(message.layout.template)
                schema = self._file.add_schema(message.schema_name, message.schema)
                topic = f"/signals/{bus}/{message.name}"
                channel = self._file.add_channel(topic, schema, {"bus": bus, **message.channel_metadata})
                decoded[number << 32 | message.can_id] = _Decoded(channel, 9 + place, place, message.length)
                if message.name == PLAN_MESSAGE:
                    plan = self._file.add_channel(f"/plan/{bus}", poses_schema, {"source": topic})
                    self._plan_channels[channel] = (bus, plan, message)
        self._raw_channel_array = np.array(self._raw_channels, np.int64)
        self._table = SignalTable(messages)
        self._decoded = _DecodedTable(decoded)
        self._payloads = templates

    def _make_truth_channels(self, names: Sequence[str], units: Mapping[str, str]) -> None:
        """Register the truth, pose, scene and event channels and finish the template table."""
        layout = Layout([Field(name, "double", units.get(name, "")) for name in names])
        schema = self._file.add_schema(
            "platoon.Truth", file_descriptor_set("platoon.Truth", layout, "The vehicle's true state, from its FMU.")
        )
        unit_metadata = {f"unit {name}": unit for name, unit in units.items() if name in names}
        self._truth_channels = {
            vehicle: self._file.add_channel(f"/truth/veh{vehicle}", schema, {"vehicle": str(vehicle), **unit_metadata})
            for vehicle in range(1, self._vehicles + 1)
        }
        self._truth_count, self._truth_bytes = len(names), len(layout.template) + MESSAGE.itemsize
        self._truth_places = np.array([layout.offset(name) for name in names], np.int64) + MESSAGE.itemsize
        self._truth_template = len(self._payloads)
        self._templates = Templates([*self._payloads, layout.template])
        pose_names = ("X", "Y", "psi", "phi")
        self._pose_columns = [names.index(name) for name in pose_names] if set(pose_names) <= set(names) else None
        self._pose_channel = self._foxglove_channel("/tf", FrameTransforms)
        self._scene_channel = self._foxglove_channel("/scene", SceneUpdate)
        self._event_channel = self._foxglove_channel("/events", Log)
        event_schema = self._file.add_schema(event_record.NAME, event_record.SCHEMA)
        self._event_data_channel = self._channels = self._file.add_channel(event_record.TOPIC, event_schema, {})

    def _groups_of_channels(self) -> npt.NDArray[np.int64]:
        """Return the groups of channels that share chunks: all raw frames, each bus's signals, all truth, others."""
        groups = np.full(self._channels + 1, self._rest_group)
        groups[self._raw_channels] = 0
        groups[self._decoded.channel] = 1 + self._decoded.bus
        groups[list(self._truth_channels.values())] = self._rest_group - 1
        return groups

    def _foxglove_channel(self, topic: str, message: Any) -> int:
        return self._file.add_channel(topic, self._file.add_schema(*foxglove.schema(message)), {})

    def _make_room(self, time_ns: int, size: int) -> None:
        """Write buffered data if due, before new data is buffered. A cycle's frames stay together."""
        if time_ns > self._newest:
            old_ns = time_ns - self._flushed_ns
            held = self._pending_bytes + self._groups.bytes
            self._newest = time_ns
            if time.monotonic() - self._flushed_at >= FLUSH_S or (held >= CHUNK_BYTES and old_ns >= FLUSH_S * 1e9):
                self.flush()
            elif self._pending_bytes >= BATCH_BYTES:
                self._encode_pending(self._on_the_wire())
        self._pending_bytes += size

    def _other(self, channel: int, time_ns: int, payload: bytes) -> None:
        self._make_room(time_ns, len(payload) + MESSAGE.itemsize)
        self._pending_other.append((channel, time_ns, payload))

    def _on_the_wire(self, *, last: bool = False) -> npt.NDArray[Any]:
        """Return the pending frames that can be written, with their times on the wire."""
        frames = self._pending.take()
        return frames if self._timeline is None else self._timeline.send(frames, last=last)

    def _transforms(self) -> list[_Message]:
        """Return the transforms of each time at which every vehicle's pose is known, and before the first the scene."""
        if self._pose_columns is None:
            return []
        x, y, psi, phi = self._pose_columns
        found: list[_Message] = []
        for vehicle, time_ns, values in self._pending_truth:
            self._poses[vehicle] = time_ns, values
            if len(self._poses) < self._vehicles or any(at != time_ns for at, _ in self._poses.values()):
                continue
            if not self._scene_written:
                self._scene_written = True
                found.append((self._scene_channel, time_ns, foxglove.scene(time_ns, self._vehicles, self._lanes)))
            rows = [self._poses[number][1] for number in sorted(self._poses)]
            poses = [(row[x], row[y], row[psi], row[phi]) for row in rows]
            found.append((self._pose_channel, time_ns, foxglove.transforms(time_ns, poses)))
        return found

    def _guard(self, write: Callable[[], _T]) -> _T:
        """Call `write`; a full disk or similar becomes one clear error, after which nothing more is written."""
        try:
            return write()
        except OSError as error:
            self._closed = True
            # Closing tries again to write the data.
            with suppress(OSError):
                self._stream.close()
            raise RunFailed(f"cannot write the log {self._path}: {error.strerror or error}") from error

    def _add_frames(self, frames: npt.NDArray[Any]) -> list[_Message]:
        """Encode frames, raw and decoded, each bus's in the order of time; return the plans in them."""
        if not len(frames):
            return []
        if (np.diff(frames["time"]) < 0).any():
            frames = frames[np.argsort(frames["time"], kind="stable")]
        raw = self._records(frames["length"].astype(np.int64), self._raw_channel_array[frames["bus"]], frames["time"])
        can_frame.fill(raw.data, raw.offset + MESSAGE.itemsize, frames)
        self._groups.add(0, raw)
        which = self._decoded.find(frames)
        known = np.flatnonzero(which >= 0)
        known = known[np.argsort(frames["bus"][known], kind="stable")]
        frames, which = frames[known], which[known]
        message, channel = self._decoded.message[which], self._decoded.channel[which]
        first, value = self._table.decode(frames["data"], message)
        records = self._records(self._decoded.template[which], channel, frames["time"])
        self._table.fill(records.data, records.offset + MESSAGE.itemsize, message, value)
        for group, part in records.by_group(self._group[channel]):
            self._groups.add(group, part)
        return self._plans(frames["time"], channel, first, value)

    def _add_truth(self) -> None:
        if not self._pending_truth:
            return
        truth = sorted(self._pending_truth, key=_time)
        template = np.full(len(truth), self._truth_template)
        channel = np.array([self._truth_channels[vehicle] for vehicle, _, _ in truth], np.int64)
        records = self._records(template, channel, np.array([at for _, at, _ in truth], np.int64))
        rows = np.frombuffer(b"".join(row for _, _, row in truth), "<f8")
        scatter(records.data, (records.offset[:, None] + self._truth_places).reshape(-1), rows)
        self._groups.add(self._rest_group - 1, records)

    def _add_others(self, others: Sequence[_Message]) -> None:
        if not others:
            return
        ordered = sorted(others, key=_time)
        channel, log_time = (np.array([each[column] for each in ordered], np.int64) for column in (0, 1))
        templates = Templates([payload for _, _, payload in ordered])
        records = templates.records(np.arange(len(ordered)), channel, log_time, self._sequence)
        self._groups.add(self._rest_group, records)

    def _records(
        self, template: npt.NDArray[np.int64], channel: npt.NDArray[np.int64], log_time: npt.NDArray[np.int64]
    ) -> Records:
        return self._templates.records(template, channel, np.ascontiguousarray(log_time), self._sequence)

    def _plans(
        self,
        log_time: npt.NDArray[np.int64],
        channel: npt.NDArray[np.int64],
        first: npt.NDArray[np.int64],
        value: npt.NDArray[np.float64],
    ) -> list[_Message]:
        """Return a plan for each frame that carries a planner's target, and the transforms to these slots."""
        plans: list[_Message] = []
        slots: dict[int, dict[str, tuple[float, float]]] = {}
        for decoded, (bus, plan_channel, message) in self._plan_channels.items():
            rows = np.flatnonzero(channel == decoded)
            names = message.layout.values
            values = value[first[rows][:, None] + np.arange(len(names))]
            # Start values: the planner has no target yet, or does not say.
            given = values.any(axis=1)
            targets = values[:, (names.index("TargetX"), names.index("TargetY"))][given].tolist()
            for at, (x, y) in zip(log_time[rows[given]].tolist(), targets, strict=True):
                plans.append((plan_channel, at, foxglove.plan(at, x, y)))
                slots.setdefault(at, {})[bus] = x, y
        plans += [(self._pose_channel, at, foxglove.slots(at, places)) for at, places in slots.items()]
        return plans


class _DecodedTable:
    """Finds the decoded channel of each frame by bus, identifier and length."""

    def __init__(self, decoded: Mapping[int, _Decoded]) -> None:
        keys = sorted(decoded)
        self._keys = np.array(keys, np.int64)
        self._length = np.array([decoded[key].length for key in keys], np.int64)
        self.bus = self._keys >> 32
        self.channel = np.array([decoded[key].channel for key in keys], np.int64)
        self.template = np.array([decoded[key].template for key in keys], np.int64)
        self.message = np.array([decoded[key].message for key in keys], np.int64)

    def find(self, frames: npt.NDArray[Any]) -> npt.NDArray[np.int64]:
        """Return each frame's index in this table, -1 if refused, or if the DBC has not its identifier and length."""
        if not len(self._keys):
            return np.full(len(frames), -1, np.int64)
        keys = frames["bus"].astype(np.int64) << 32 | frames["can_id"].astype(np.int64)
        found = np.minimum(np.searchsorted(self._keys, keys), len(self._keys) - 1)
        good = (self._keys[found] == keys) & (frames["length"] == self._length[found]) & (frames["refused"] == 0)
        return np.where(good, found, -1)


def _lanes(scenario: bytes) -> list[float]:
    """Return the centres of the lanes in which a scenario's vehicles start and end, m; none if it cannot be read."""
    try:
        values = tomllib.loads(scenario.decode())
        lanes = {float(values["platoon"]["lane_y_m"])}
        lanes |= {float(vehicle["y_m"]) for vehicle in values["vehicles"]}
    except (UnicodeDecodeError, tomllib.TOMLDecodeError, KeyError, TypeError, ValueError) as error:
        _log.debug("no lanes in the scene: %s", error)
        return []
    return sorted(lanes)
