"""The recorder: writes a run to one MCAP file, fast enough to run in the conductor's process.

Frames and truth rows are buffered on arrival (under 1 us each) and encoded in batches, with numpy. Data is written, in
the chunks of `bench.mcap.chunking`, when half a second old. A killed run loses at most that. With a `BusTimeline`,
frames then get their times on the wire, and are logged in that order within their cycle.

Topics: `/can/<bus>` raw frames, `/signals/<bus>/<Message>` the decoded signals, `/truth/veh<i>`, `/tf`, `/scene`,
`/plan/veh<i>`, `/events`, `/events/data`, `/processes/<name>`. log_time and publish_time are simulated time in ns; the
host's receive time is in the frame.
"""

from __future__ import annotations

import logging
import struct
import time
import tomllib
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
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
from bench.bus.frame import BusFrame, RefusedFrame
from bench.bus.wire.timing import FRAME, BusTimeline
from bench.errors import RunFailed
from bench.events import Event
from bench.files import already_exists
from bench.mcap.chunking import ChunkGroups, Records
from bench.mcap.container import MESSAGE, MESSAGE_FIELDS, McapFile, media_type, storable
from bench.mcap.gathering import scatter
from bench.record import can_frame, dbc_files, foxglove, process_usage
from bench.record import event as event_record
from bench.record.layout import Field, Layout, file_descriptor_set
from bench.record.process_usage import ProcessUsage
from bench.record.signals import SignalMessage, SignalTable, signal_message

CHUNK_BYTES = 64 * 1024
FLUSH_S = 0.5
"""Data older than this, by the host's clock or by simulated time, is written; by the latter only full chunks."""
PLAN_MESSAGE = "PlannerTarget"

# A `FRAME` that has not been on the wire yet.
_pack_pending = struct.Struct("<qq16x8sIHBB").pack
# Average bytes of a frame in a chunk, raw and decoded; only sets when a chunk counts as full.
_BYTES_A_FRAME = 150

_log = logging.getLogger(__name__)

_T = TypeVar("_T")


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
        self._pending = bytearray()
        self._pending_truth: list[tuple[int, int, bytes]] = []
        self._pending_other: list[tuple[int, int, bytes]] = []
        self._pending_bytes = 0
        self._newest = -1
        self._poses: dict[int, tuple[int, tuple[float, float, float, float]]] = {}
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
        for bus, can_id, data in frames:
            if len(data) > can_frame.MAX_DATA:
                raise ValueError(f"frame 0x{can_id:03X} on {bus}: {len(data)} bytes, not 0 to {can_frame.MAX_DATA}")
        self._make_room(time_ns, _BYTES_A_FRAME * len(frames))
        pack, numbers = _pack_pending, self._bus_numbers
        self._pending += b"".join(
            [
                pack(
                    time_ns, received, frame[2], frame[1], numbers[frame[0]], len(frame[2]), type(frame) is RefusedFrame
                )
                for frame, received in zip(frames, receive_ns, strict=True)
            ]
        )

    def truth(self, vehicle: int, time_ns: int, values: Sequence[float] | npt.NDArray[np.float64]) -> None:
        """Record a truth row: the values of `truth_names`, in that order.

        Raises:
            ValueError: the row does not have as many values as there are names.
            RunFailed: the file cannot be written.
        """
        if len(values) != self._truth_count:
            raise ValueError(f"truth row of {len(values)} values, not {self._truth_count}")
        row = struct.pack(f"<{self._truth_count}d", *values)
        self._make_room(time_ns, len(self._truth_layout.template) + MESSAGE.itemsize)
        self._pending_truth.append((vehicle, time_ns, row))
        self._note_pose(vehicle, time_ns, values)

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
        if len(frames) or self._pending_truth or self._pending_other:
            records, group = self._encode(frames)
            for number, part in records.by_group(group):
                self._groups.add(number, part)
        self._pending.clear()
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
        templates = [_template(can_frame.template(length)) for length in range(9)]
        messages: list[SignalMessage] = []
        places: dict[tuple[str, bytes], int] = {}
        self._bus_numbers: dict[str, int] = {}
        self._raw_channels: list[int] = []
        self._plan_channels: dict[int, tuple[str, int, SignalMessage]] = {}
        decoded: dict[int, _Decoded] = {}
        poses_schema = self._file.add_schema(*foxglove.schema(PosesInFrame))
        for number, (bus, codec) in enumerate(codecs.items()):
            self._bus_numbers[bus] = number
            about = {"bus": bus, dbc_files.METADATA: dbc_names[bus]}
            self._raw_channels.append(self._file.add_channel(f"/can/{bus}", raw_schema, about))
            for message in _messages(bus, codec):
                place = places.setdefault((message.schema_name, message.schema), len(messages))
                if place == len(messages):
                    messages.append(message)
                    templates.append(_template(message.layout.template))
                schema = self._file.add_schema(message.schema_name, message.schema)
                topic = f"/signals/{bus}/{message.name}"
                channel = self._file.add_channel(topic, schema, {"bus": bus, **message.channel_metadata})
                decoded[number << 32 | message.can_id] = _Decoded(channel, 9 + place, place, message.length)
                if message.name == PLAN_MESSAGE:
                    plan = self._file.add_channel(f"/plan/{bus}", poses_schema, {"source": topic})
                    self._plan_channels[channel] = (bus, plan, message)
        self._raw_channel_array = np.array(self._raw_channels, np.int64)
        self._table = SignalTable(messages)
        self._signal_places = _SignalPlaces(messages)
        self._decoded = _DecodedTable(decoded)
        self._templates = templates

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
        self._truth_layout, self._truth_count = layout, len(names)
        self._truth_places = np.array([layout.offset(name) for name in names], np.int64) + MESSAGE.itemsize
        self._truth_template = len(self._templates)
        self._templates.append(_template(layout.template))
        self._template_size = np.array([len(template) for template in self._templates], np.int64)
        self._template_start = np.cumsum(self._template_size) - self._template_size
        self._template_bytes = np.frombuffer(b"".join(self._templates), np.uint8)
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
            elif self._pending_bytes >= CHUNK_BYTES:
                self._encode_pending(self._on_the_wire())
        self._pending_bytes += size

    def _other(self, channel: int, time_ns: int, payload: bytes) -> None:
        self._make_room(time_ns, len(payload) + MESSAGE.itemsize)
        self._pending_other.append((channel, time_ns, payload))

    def _on_the_wire(self, *, last: bool = False) -> npt.NDArray[Any]:
        """Return the pending frames that can be written, with their times on the wire."""
        frames = np.frombuffer(self._pending.copy(), FRAME)
        return frames if self._timeline is None else self._timeline.send(frames, last=last)

    def _note_pose(self, vehicle: int, time_ns: int, values: Sequence[float] | npt.NDArray[np.float64]) -> None:
        """Write the transforms when every vehicle's pose of this time is known."""
        if self._pose_columns is None:
            return
        x, y, psi, phi = (float(values[column]) for column in self._pose_columns)
        self._poses[vehicle] = (time_ns, (x, y, psi, phi))
        now = [pose for at, pose in self._poses.values() if at == time_ns]
        if len(now) < self._vehicles:
            return
        if not self._scene_written:
            self._scene_written = True
            self._other(self._scene_channel, time_ns, foxglove.scene(time_ns, self._vehicles, self._lanes))
        ordered = [self._poses[number][1] for number in sorted(self._poses)]
        self._other(self._pose_channel, time_ns, foxglove.transforms(time_ns, ordered))

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

    def _encode(self, frames: npt.NDArray[Any]) -> tuple[Records, npt.NDArray[np.int64]]:
        """Return all pending data as records, group by group in the order of time, and the group of each.

        Among messages of one time: the frames in their order, each raw and then decoded, then truth, then all others.
        """
        which = self._decoded.find(frames)
        known = np.flatnonzero(which >= 0)
        which = which[known]
        signal_frame, signal, value = self._table.decode(frames["data"][known], self._decoded.message[which])
        plans = self._plans(frames["time"][known], self._decoded.channel[which], signal_frame, value)
        truth, others = self._pending_truth, self._pending_other + plans
        n_frames, n_known, n_truth = len(frames), len(known), len(truth)
        # Records in four blocks: raw, decoded, truth, others. `rank` puts them in order among equal times.
        truth_channels = [self._truth_channels[vehicle] for vehicle, _, _ in truth]
        channel = np.concatenate(
            [
                self._raw_channel_array[frames["bus"]],
                self._decoded.channel[which],
                np.array(truth_channels, np.int64),
                np.array([number for number, _, _ in others], np.int64),
            ]
        )
        times = [at for _, at, _ in truth] + [at for _, at, _ in others]
        log_time = np.concatenate([frames["time"], frames["time"][known], np.array(times, np.int64)])
        rank = np.concatenate([np.arange(n_frames) * 2, known * 2 + 1, 2 * n_frames + np.arange(len(times))])
        template = np.concatenate(
            [frames["length"].astype(np.int64), self._decoded.template[which], np.full(n_truth, self._truth_template)]
        )
        payloads = [MESSAGE.itemsize + len(payload) for _, _, payload in others]
        size = np.concatenate([self._template_size[template], np.array(payloads, np.int64)])
        group = self._group[channel]
        order = np.lexsort((rank, log_time, group))
        offset = np.empty(len(order), np.int64)
        offset[order] = np.cumsum(size[order]) - size[order]
        out = np.zeros(int(size.sum()), np.uint8)

        n_made = len(template)
        self._fill_templates(out, offset[:n_made], size[:n_made], self._template_start[template])
        _fill_headers(out, offset, size, channel, log_time, self._next_sequence(channel, order))
        can_frame.fill(out, offset[:n_frames] + MESSAGE.itemsize, frames)
        self._signal_places.fill(out, offset[n_frames : n_frames + n_known][signal_frame], signal, value)
        rows = np.frombuffer(b"".join(row for _, _, row in truth), "<f8")
        scatter(out, (offset[n_frames + n_known : n_made, None] + self._truth_places).reshape(-1), rows)
        for (_, _, payload), start in zip(others, offset[n_made:].tolist(), strict=True):
            out[start + MESSAGE.itemsize : start + MESSAGE.itemsize + len(payload)] = np.frombuffer(payload, np.uint8)
        return Records(out, channel[order], log_time[order], offset[order]), group[order]

    def _fill_templates(
        self,
        out: npt.NDArray[np.uint8],
        offset: npt.NDArray[np.int64],
        size: npt.NDArray[np.int64],
        source: npt.NDArray[np.int64],
    ) -> None:
        within = np.arange(int(size.sum())) - np.repeat(np.cumsum(size) - size, size)
        out[within + np.repeat(offset, size)] = self._template_bytes[within + np.repeat(source, size)]

    def _next_sequence(self, channel: npt.NDArray[np.int64], order: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
        """Return each message's sequence number in its channel, in the order of the file."""
        by_channel = order[np.argsort(channel[order], kind="stable")]
        grouped = channel[by_channel]
        starts = np.flatnonzero(np.concatenate([[True], grouped[1:] != grouped[:-1]]))
        counts = np.diff(np.append(starts, len(grouped)))
        within = np.arange(len(grouped)) - np.repeat(starts, counts)
        sequence = np.empty(len(channel), np.int64)
        sequence[by_channel] = self._sequence[grouped] + within
        self._sequence[grouped[starts]] += counts
        return sequence

    def _plans(
        self,
        log_time: npt.NDArray[np.int64],
        channel: npt.NDArray[np.int64],
        signal_frame: npt.NDArray[np.int64],
        value: npt.NDArray[np.float64],
    ) -> list[tuple[int, int, bytes]]:
        """Return a plan for each frame that carries a planner's target, and the transforms to these slots."""
        plans: list[tuple[int, int, bytes]] = []
        slots: dict[int, dict[str, tuple[float, float]]] = {}
        for decoded, (bus, plan_channel, message) in self._plan_channels.items():
            names = message.layout.values
            columns = names.index("TargetX"), names.index("TargetY")
            for frame in np.flatnonzero(channel == decoded).tolist():
                first = int(np.searchsorted(signal_frame, frame))
                if not value[first : first + len(names)].any():
                    # Start values: the planner has no target yet, or does not say.
                    continue
                at = int(log_time[frame])
                x, y = (float(value[first + column]) for column in columns)
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


class _SignalPlaces:
    """Position and encoding of each signal of the table in its record."""

    def __init__(self, messages: Sequence[SignalMessage]) -> None:
        places = [message.layout.offset(name) for message in messages for name in message.layout.values]
        types = [str(message.layout.dtype[name].str) for message in messages for name in message.layout.values]
        self._place = np.array(places, np.int64) + MESSAGE.itemsize
        self._types = sorted(set(types))
        self._type = np.array([self._types.index(item) for item in types], np.int64)

    def fill(
        self,
        out: npt.NDArray[np.uint8],
        record: npt.NDArray[np.int64],
        signal: npt.NDArray[np.int64],
        value: npt.NDArray[np.float64],
    ) -> None:
        """Write values (n,) of signals (n,) into their records, which start at `record` (n,)."""
        kind = self._type[signal]
        place = record + self._place[signal]
        for number, name in enumerate(self._types):
            chosen = np.flatnonzero(kind == number)
            if len(chosen):
                scatter(out, place[chosen], value[chosen].astype(name))


def _messages(bus: str, codec: Codec) -> list[SignalMessage]:
    """Return the log's form of all messages of a bus; `veh1` and `veh2` share their schemas as `veh`."""
    package = f"platoon.{bus.rstrip('0123456789')}"
    return [signal_message(package, codec, name) for name in codec.names]


def _template(payload: bytes) -> bytes:
    header = np.zeros(1, MESSAGE)
    header["opcode"], header["length"] = 5, MESSAGE_FIELDS + len(payload)
    return header.tobytes() + payload


def _fill_headers(
    out: npt.NDArray[np.uint8],
    offset: npt.NDArray[np.int64],
    size: npt.NDArray[np.int64],
    channel: npt.NDArray[np.int64],
    log_time: npt.NDArray[np.int64],
    sequence: npt.NDArray[np.int64],
) -> None:
    header = np.empty(len(offset), MESSAGE)
    header["opcode"] = 5
    header["length"] = size - 9
    header["channel"], header["sequence"] = channel, sequence & 0xFFFFFFFF
    header["log_time"] = header["publish_time"] = log_time
    scatter(out, offset, header)


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
