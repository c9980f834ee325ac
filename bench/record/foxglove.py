"""Poses, scene, plans and events as Foxglove's well-known messages, so that its viewers show a run directly.

https://docs.foxglove.dev/docs/sdk/schemas; the descriptors come from the package `foxglove-schemas-protobuf`.
Frames: `map` is the road frame (X along the road, Y to the left, Z up), `veh<i>` the body frame of vehicle i at its
centre of mass projected onto the road (ISO 8855 axes), `veh<i>/slot` its planner's target, along the road.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping, Sequence
from functools import lru_cache
from typing import Any

from foxglove_schemas_protobuf.LinePrimitive_pb2 import LinePrimitive
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.SceneEntity_pb2 import SceneEntity
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.message import Message

from bench.record.drawing import BOXES, LANE_WIDTH, colour, lane_edges
from bench.record.layout import tag, varint
from platoon_fmu.parameters import BODY

MAP_FRAME = "map"
LEVELS = {"debug": Log.DEBUG, "info": Log.INFO, "warning": Log.WARNING, "error": Log.ERROR, "fatal": Log.FATAL}
LEVEL_NAMES = {number: name for name, number in LEVELS.items()}
_ROAD_START, _ROAD_END = -100.0, 2000.0
_LINE_WIDTH = 0.12


def schema(message: type[Message]) -> tuple[str, bytes]:
    """Return a message type's full name and serialised FileDescriptorSet, dependencies first."""
    files: dict[str, Any] = {}

    def collect(file: Any) -> None:
        for dependency in file.dependencies:
            collect(dependency)
        files.setdefault(file.name, file)

    collect(message.DESCRIPTOR.file)
    result = FileDescriptorSet()
    for file in files.values():
        file.CopyToProto(result.file.add())
    return message.DESCRIPTOR.full_name, result.SerializeToString()


def frame_id(vehicle: int) -> str:
    """Return the name of vehicle `vehicle`'s body frame."""
    return f"veh{vehicle}"


def slot_frame_id(bus: str) -> str:
    """Return the name of the frame of the planner's target slot on `bus`."""
    return f"{bus}/slot"


def transforms(time_ns: int, poses: Sequence[tuple[float, float, float, float]]) -> bytes:
    """Return one FrameTransforms from `map` to each vehicle.

    Args:
        time_ns: simulated time.
        poses: X [m], Y [m], psi (yaw) [rad] and phi (roll) [rad] of each vehicle.
    """
    stamp, found = _timestamp(time_ns), []
    for vehicle, (x, y, psi, phi) in enumerate(poses, start=1):
        cos_yaw, sin_yaw = math.cos(psi / 2.0), math.sin(psi / 2.0)
        cos_roll, sin_roll = math.cos(phi / 2.0), math.sin(phi / 2.0)
        rotation = cos_yaw * sin_roll, sin_yaw * sin_roll, sin_yaw * cos_roll, cos_yaw * cos_roll
        found.append(_field(1, stamp + _frames(frame_id(vehicle)) + _placed(4, x, y, *rotation)))
    return b"".join(found)


def slots(time_ns: int, places: Mapping[str, tuple[float, float]]) -> bytes:
    """Return one FrameTransforms from `map` to the slots: by bus X and Y in m."""
    stamp = _timestamp(time_ns)
    return b"".join(
        _field(1, stamp + _frames(slot_frame_id(bus)) + _placed(4, x, y, *_ALONG_THE_ROAD))
        for bus, (x, y) in places.items()
    )


def plan(time_ns: int, x: float, y: float) -> bytes:
    """Return a plan of one pose in the road frame: the planner's target."""
    return _timestamp(time_ns) + _MAP + _field(3, _placed(1, x, y, *_ALONG_THE_ROAD))


# These messages are in every cycle, so they are encoded here, not by protobuf: in a third of the time.
_ALONG_THE_ROAD = (0.0, 0.0, 0.0, 1.0)
# Vector3 x, y and Quaternion x, y, z, w, each field a tag and a double, in the two fields of a transform or a pose.
_PLACED = struct.Struct("<BBBdBdBBBdBdBdBd").pack


def _field(number: int, content: bytes) -> bytes:
    """Return a field of a message that is a message or text."""
    if len(content) < 128:
        return bytes((number << 3 | 2, len(content))) + content
    return tag(number, 2) + varint(len(content)) + content


@lru_cache(maxsize=256)
def _timestamp(time_ns: int) -> bytes:
    """Return the field `timestamp`."""
    seconds, nanoseconds = divmod(time_ns, 1_000_000_000)
    return _field(1, tag(1, 0) + varint(seconds) + tag(2, 0) + varint(nanoseconds))


@lru_cache(maxsize=256)
def _frames(child: str) -> bytes:
    """Return the fields `parent_frame_id` and `child_frame_id` of a transform."""
    return _field(2, MAP_FRAME.encode()) + _field(3, child.encode())


_MAP = _field(2, MAP_FRAME.encode())


def _placed(number: int, x: float, y: float, qx: float, qy: float, qz: float, qw: float) -> bytes:
    """Return translation and rotation, fields `number` and the one after, or position and orientation."""
    first, second = number << 3 | 2, number + 1 << 3 | 2
    return _PLACED(first, 18, 9, x, 17, y, second, 36, 9, qx, 17, qy, 25, qz, 33, qw)


def log(time_ns: int, level: str, source: str, text: str) -> bytes:
    """Return a log message.

    Raises:
        KeyError: `level` is not one of `LEVELS`.
    """
    message = Log(level=LEVELS[level], name=source, message=text)
    message.timestamp.FromNanoseconds(time_ns)
    return message.SerializeToString()


def scene(time_ns: int, vehicles: int, lanes: Sequence[float]) -> bytes:
    """Return the scene: a body and a name fixed to each vehicle's frame, an outline to its slot's, the lane markings.

    Args:
        time_ns: simulated time.
        vehicles: number of vehicles.
        lanes: Y of the middle of each lane, m.
    """
    update = SceneUpdate()
    for vehicle in range(1, vehicles + 1):
        name = frame_id(vehicle)
        slot = slot_frame_id(name)
        _add_body(update.entities.add(id=name, frame_id=name, frame_locked=True), vehicle)
        _add_slot(update.entities.add(id=slot, frame_id=slot, frame_locked=True), vehicle)
    if lanes:
        _add_road(update.entities.add(id="road", frame_id=MAP_FRAME, frame_locked=True), lanes)
    for entity in update.entities:
        entity.timestamp.FromNanoseconds(time_ns)
    return update.SerializeToString()


def _add_body(entity: SceneEntity, vehicle: int) -> None:
    red, green, blue = _rgb(vehicle)
    for middle, base, (length, width, height), alpha in BOXES:
        cube = entity.cubes.add()
        cube.pose.position.x, cube.pose.position.z = middle, base + height / 2.0
        cube.pose.orientation.w = 1.0
        cube.size.x, cube.size.y, cube.size.z = length, width, height
        cube.color.r, cube.color.g, cube.color.b, cube.color.a = red, green, blue, alpha
    label = entity.texts.add(text=frame_id(vehicle), billboard=True, font_size=24.0, scale_invariant=True)
    label.pose.position.z = 2.2
    label.pose.orientation.w = 1.0
    label.color.r = label.color.g = label.color.b = label.color.a = 1.0


def _add_slot(entity: SceneEntity, vehicle: int) -> None:
    line = entity.lines.add(type=LinePrimitive.LINE_LOOP, thickness=_LINE_WIDTH)
    line.pose.orientation.w = 1.0
    line.color.r, line.color.g, line.color.b = _rgb(vehicle)
    line.color.a = 0.8
    end, side = BODY.length / 2.0, BODY.width / 2.0
    for x, y in ((end, side), (-end, side), (-end, -side), (end, -side)):
        line.points.add(x=x, y=y, z=0.02)


def _rgb(vehicle: int) -> tuple[float, float, float]:
    text = colour(vehicle)
    return int(text[1:3], 16) / 255.0, int(text[3:5], 16) / 255.0, int(text[5:7], 16) / 255.0


def _add_road(entity: SceneEntity, lanes: Sequence[float]) -> None:
    low, high = min(lanes) - LANE_WIDTH / 2.0, max(lanes) + LANE_WIDTH / 2.0
    surface = entity.cubes.add()
    surface.pose.position.x, surface.pose.position.y = (_ROAD_START + _ROAD_END) / 2.0, (low + high) / 2.0
    surface.pose.position.z = -0.06
    surface.pose.orientation.w = 1.0
    surface.size.x, surface.size.y, surface.size.z = _ROAD_END - _ROAD_START, high - low + 1.0, 0.1
    surface.color.r = surface.color.g = surface.color.b = 0.25
    surface.color.a = 1.0
    for y, solid in lane_edges(lanes):
        line = entity.lines.add(thickness=_LINE_WIDTH)
        line.type = line.LINE_LIST
        line.pose.orientation.w = 1.0
        line.color.r = line.color.g = line.color.b = line.color.a = 1.0
        step, dash = (100.0, 100.0) if solid else (12.0, 4.0)
        for index in range(int((_ROAD_END - _ROAD_START) / step)):
            start = _ROAD_START + index * step
            line.points.add(x=start, y=y)
            line.points.add(x=start + dash, y=y)
