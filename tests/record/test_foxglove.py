"""The poses that are encoded by hand are what protobuf encodes."""

import math

import pytest
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from hypothesis import given
from hypothesis import strategies as st

from bench.record import foxglove

times = st.integers(0, 2**60)
lengths = st.floats(allow_nan=False)
angles = st.floats(-10.0, 10.0)


def transform(message, time_ns, child, x, y, rotation):
    item = message.transforms.add(parent_frame_id="map", child_frame_id=child)
    item.timestamp.FromNanoseconds(time_ns)
    item.translation.x, item.translation.y = x, y
    item.rotation.x, item.rotation.y, item.rotation.z, item.rotation.w = rotation


@given(times, st.lists(st.tuples(lengths, lengths, angles, angles), max_size=16))
def test_transforms_are_roll_about_the_yawed_axis(time_ns, poses):
    wanted = FrameTransforms()
    for vehicle, (x, y, psi, phi) in enumerate(poses, start=1):
        yaw, roll = (math.cos(psi / 2), math.sin(psi / 2)), (math.cos(phi / 2), math.sin(phi / 2))
        rotation = yaw[0] * roll[1], yaw[1] * roll[1], yaw[1] * roll[0], yaw[0] * roll[0]
        transform(wanted, time_ns, f"veh{vehicle}", x, y, rotation)
    assert FrameTransforms.FromString(foxglove.transforms(time_ns, poses)) == wanted


@given(times, st.dictionaries(st.text(max_size=200), st.tuples(lengths, lengths)))
def test_slots_lie_along_the_road(time_ns, places):
    wanted = FrameTransforms()
    for bus, (x, y) in places.items():
        transform(wanted, time_ns, f"{bus}/slot", x, y, (0.0, 0.0, 0.0, 1.0))
    assert FrameTransforms.FromString(foxglove.slots(time_ns, places)) == wanted


@given(times, lengths, lengths)
def test_a_plan_is_one_pose_along_the_road(time_ns, x, y):
    wanted = PosesInFrame(frame_id="map")
    wanted.timestamp.FromNanoseconds(time_ns)
    pose = wanted.poses.add()
    pose.position.x, pose.position.y, pose.orientation.w = x, y, 1.0
    assert PosesInFrame.FromString(foxglove.plan(time_ns, x, y)) == wanted


@pytest.mark.parametrize("level", foxglove.LEVELS)
def test_every_level_has_a_name(level):
    assert foxglove.LEVEL_NAMES[foxglove.LEVELS[level]] == level
