"""The bus's machine code gives the same bits as its plain text; for inbox and outbox see `test_inbox_fuzz`."""

import socket
from contextlib import closing

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from bench.bus.codec import load_codecs
from bench.bus.frame import BusFrame
from bench.bus.link.base import EXTENDED
from bench.bus.states import BenchCommand, CommandState, ReferenceState
from bench.bus.topic import Topic
from bench.cycle import CYCLE_NS
from tests.plain import bits, compiled, plain

WAYS = (compiled, plain)
frames_of_8 = st.binary(min_size=8, max_size=8)
relaxed = settings(deadline=None, max_examples=60, suppress_health_check=[HealthCheck.too_slow])


def both(name: str) -> list:
    return [way(f"bench.bus.{name}") for way in WAYS]


@pytest.fixture(scope="module")
def codecs() -> list:
    """The codecs of two vehicles' buses, with compiled layouts and with interpreted ones."""
    return [load_codecs(2), plain("bench.bus.codec").load_codecs(2)]


@relaxed
@given(st.binary(min_size=2, max_size=64), st.integers(0, 0xFFFF), st.integers(0, 14), st.data())
def test_e2e_protection(data, data_id, counter, drawn):
    found = []
    changed = drawn.draw(st.integers(0, len(data) - 1))
    for e2e in both("e2e"):
        sent = bytearray(data)
        e2e.protect(sent, data_id, counter)
        wrong = bytearray(sent)
        wrong[changed] ^= 1 + data[0] % 255
        found.append(
            (bytes(sent), e2e.crc_of_message(data, data_id), e2e.check(sent, data_id), e2e.check(wrong, data_id))
        )
    assert found[0] == found[1]
    assert found[0][2:] == (True, False)


@relaxed
@given(st.lists(st.one_of(st.none(), st.integers(0, 15), st.binary(max_size=9)), max_size=30), st.integers(1, 14))
def test_e2e_receiver(events, max_step):
    """Missing frames, whole ones with any counter, and any bytes."""
    found = []
    for e2e in both("e2e"):
        receiver, seen = e2e.Receiver(7, max_step), []
        for event in events:
            if event is None:
                status = receiver.missed()
            else:
                data = bytearray(event if isinstance(event, bytes) else 8)
                if isinstance(event, int):
                    e2e.protect(data, 7, event)
                status = receiver.check(bytes(data))
            seen.append((status.name, receiver.age, receiver.errors))
        found.append(seen)
    assert found[0] == found[1]


numbers = st.one_of(st.floats(), st.floats(-100.0, 100.0), st.integers(-(10**6), 10**6))


@relaxed
@given(st.data())
def test_frames_are_encoded_and_decoded(codecs, data):
    bus = data.draw(st.sampled_from(sorted(codecs[0])))
    name = data.draw(st.sampled_from(sorted(codecs[0][bus].names)))
    signals = sorted(codecs[0][bus].start_values(name))
    values = {signal: data.draw(numbers) for signal in signals}
    counter, raw = data.draw(st.integers(0, 10**6)), data.draw(frames_of_8)
    found = []
    for codec in (each[bus] for each in codecs):
        frame = codec.encode(name, values, counter)
        layout = codec.layout(name)
        decoded = [codec.decode(layout.can_id, each[: layout.length]) for each in (frame.data, raw)]
        possible = [layout.is_possible(each) for _, each in decoded]
        found.append(bits((frame.can_id, frame.data, decoded, possible, codec.saturated, codec.not_numbers)))
    assert found[0] == found[1]


@relaxed
@given(frames_of_8, st.integers(0, 2**20), st.sampled_from(list(BenchCommand)), st.integers(0, 7))
def test_cycle_openings_and_absences(codecs, raw, cycle, command, wrong):
    found = []
    for sync, absence, each in zip(both("sync"), both("absence"), codecs, strict=True):
        codec = each["v2v"]
        values = {**codec.start_values("BenchSync"), "Command": command, "Cycle": cycle, "Time": 0.01 * cycle}
        opening = codec.encode("BenchSync", values, cycle).data
        announced = codec.encode("BenchAbsent", {"Identifier": 0x123, "Cycle": cycle}, cycle).data
        bent = bytes(byte ^ (place == wrong) for place, byte in enumerate(opening))
        layouts = codec.layout("BenchSync"), codec.layout("BenchAbsent")
        frames = (opening, announced, bent, raw)
        read = [sync.read_sync(layouts[0], frame) for frame in frames]
        read += [absence.read_absence(layouts[1], frame) for frame in frames]
        found.append(bits(read))
    assert found[0] == found[1]


@relaxed
@given(st.lists(st.floats(-1e3, 1e3), min_size=6, max_size=6))
def test_quantities(values):
    x, y, z, u, v, w = values
    found = []
    for q in both("quantities"):
        motion = q.Motion.read({"VelocityX": x, "VelocityY": y, "YawRate": z})
        pose = q.Pose.read({"X": x, "Y": y}, {"Yaw": z})
        peer = q.Peer.read({"X": x, "Y": y}, {"Speed": z, "Course": u, "YawRate": v})
        command = q.Command.of_wheels(x, [y, z, u, v]).messages(CommandState.VALID)
        reference = q.Reference(v, w).messages(ReferenceState.DEGRADED)
        found.append(bits((motion, pose, peer, peer.messages(2), command, reference, list(q.broadcast(3)))))
    assert found[0] == found[1]


identifiers = st.one_of(st.integers(0, 0x7FF), st.integers(0, 0x1FFFFFFF).map(lambda number: number | EXTENDED))


@relaxed
@given(st.lists(st.tuples(identifiers, st.binary(max_size=8)), max_size=30))
def test_length_and_priority_of_frames(frames):
    ids = np.array([can_id for can_id, _ in frames], np.uint32)
    sizes = np.array([len(data) for _, data in frames], np.uint8)
    data = np.array([list(data.ljust(8, b"\xa5")) for _, data in frames], np.uint8).reshape(-1, 8)
    one, other = (bits((each.frame_bits(ids, sizes, data), each.priority(ids))) for each in both("wire.frame_length"))
    assert one == other


@settings(relaxed, max_examples=20)
@given(st.data())
def test_times_on_the_wire(codecs, data):
    """Any messages of two vehicles, cycle after cycle, in lockstep and by the wall clock."""
    names = {bus: sorted(set(codec.names) - {"BenchAbsent", "BenchSync"}) for bus, codec in codecs[0].items()}
    messages = {bus: st.lists(st.sampled_from(names[bus]), unique=True, max_size=8) for bus in names}
    sent = data.draw(st.lists(st.fixed_dictionaries(messages), min_size=1, max_size=3))
    realtime = data.draw(st.booleans())
    found = []
    for timing, frame, codec in zip(
        both("wire.timing"), (BusFrame, plain("bench.bus.frame").BusFrame), codecs, strict=True
    ):
        inputs = {"veh1.planner": [Topic("veh1", "VehiclePosition"), Topic("v2v", "V2VMotion_2")]}
        timeline = timing.BusTimeline(codec, inputs, realtime=realtime)
        buffer, out = timing.FrameBuffer(codec), []
        for cycle, buses in enumerate(sent):
            frames = []
            for bus, names_sent in buses.items():
                for name in ["BenchSync", *names_sent]:
                    values = {"Cycle": cycle, "Time": 0.01 * cycle, "Command": BenchCommand.RUN}
                    if name != "BenchSync":
                        values = codec[bus].start_values(name)
                    can = codec[bus].encode(name, values, cycle)
                    frames.append(frame(bus, can.can_id, can.data))
            times = [10**9 + cycle * CYCLE_NS + 1000 * number for number in range(len(frames))]
            buffer.add(cycle * CYCLE_NS, frames, times)
            out.append(timeline.send(buffer.take(), last=cycle == len(sent) - 1).tobytes())
        found.append(out)
    assert found[0] == found[1]
    assert any(found[0])


@settings(relaxed, max_examples=20)
@given(st.lists(st.binary(min_size=1, max_size=40), min_size=1, max_size=100))
def test_datagrams_arrive_as_they_were_sent(sent):
    for module in both("link.datagrams"):
        with (
            closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as here,
            closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as there,
        ):
            here.bind(("127.0.0.1", 0))
            there.setblocking(False)
            here.setblocking(False)
            module.Datagrams(there, here.getsockname()).send(sent)
            receiver, received = module.Datagrams(here), []
            while len(received) < len(sent):
                received += receiver.receive(None)
            assert received == sent
