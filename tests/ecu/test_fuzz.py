"""Random and mutated frames at every participant: nothing breaks, no wrong CRC gets in."""

import random
from collections.abc import Iterator
from contextlib import ExitStack

import pytest
from e2e.p01 import e2e_p01_check

from bench.bus.codec import Codec, load_codecs
from bench.bus.link.address import Address
from bench.bus.link.base import EXTENDED, Link
from bench.bus.link.opening import open_link
from bench.bus.network import EcuSlot
from bench.bus.node import Node
from bench.bus.sync import BENCH_SYNC
from bench.ecu.loading import DEFAULT_ECUS, make_node
from bench.faults.plan import FaultPlan
from bench.plant.main import make_nodes
from bench.scenario import load
from platoon_fmu.build import default_fmu
from tests.conftest import Tries

SCENARIO = load("formation")
CODECS = load_codecs(len(SCENARIO.vehicles))
CYCLES = 400
PARTICIPANTS = ("planner", "tracker", "plant")


class Victim:
    """One participant of vehicle 1, all others of the bus played by the test."""

    def __init__(self, role: str, stack: ExitStack) -> None:
        address = Address.parse("direct")
        self.role = role
        self.buses = EcuSlot(role, 1).buses if role != "plant" else ("veh1",)
        self.far: dict[str, Link] = {bus: open_link(bus, address) for bus in self.buses}
        plan = FaultPlan()
        self.node: Node
        if role == "plant":
            nodes = make_nodes(
                SCENARIO.model_copy(update={"vehicles": SCENARIO.vehicles[:1]}),
                default_fmu(),
                lambda bus: open_link(bus, address),
                CODECS,
                lambda *_: None,
                stack,
                plan,
            )
            self.node = nodes[0]
        else:
            links = {bus: open_link(bus, address) for bus in self.buses}
            self.node, _ = make_node(DEFAULT_ECUS[role], EcuSlot(role, 1), SCENARIO, links, CODECS, plan)

    def sync(self, cycle: int) -> None:
        for bus in self.buses:
            values = {"Command": 1, "Cycle": cycle, "Time": cycle / 100}
            self.far[bus].send(*CODECS[bus].encode(BENCH_SYNC, values, cycle))

    def others(self, cycle: int) -> list[tuple[str, int, bytes]]:
        """Good frames of all others in a cycle: a vehicle in its lane at 20 m/s, and its peers."""
        x = 0.2 * cycle
        moving = {"VelocityX": 20.0, "WheelSpeedFL": 66.0, "WheelSpeedFR": 66.0, "WheelSpeedRL": 66.0}
        values = moving | {"WheelSpeedRR": 66.0, "Speed": 20.0, "ReferenceState": 1, "CommandState": 1, "State": 1}
        frames = []
        for bus in self.buses:
            codec = CODECS[bus]
            for name in codec.names:
                sender = codec.message(name).senders[0]
                if sender not in ("Conductor", self.role.capitalize(), "Vehicle1") and codec.data_id(name):
                    place = {"X": x - 10.0 * int(name.rpartition("_")[2] or 1) if bus == "v2v" else x, "Y": 7.0}
                    known = {signal: place.get(signal, values.get(signal)) for signal in codec.start_values(name)}
                    given = {signal: value for signal, value in known.items() if value is not None}
                    frames.append((bus, *codec.encode(name, {**codec.start_values(name), **given}, cycle)))
        return frames


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


def garbage(dice: random.Random, codec: Codec, good: list[tuple[int, bytes]]) -> tuple[int, bytes]:
    """A frame that is random, or was good before something happened to it."""
    kind = dice.randrange(8)
    if kind == 0:
        return dice.randrange(1 << 11), dice.randbytes(dice.randrange(9))
    if kind == 1:
        return dice.randrange(1 << 29) | EXTENDED, dice.randbytes(8)
    if kind == 2:
        return dice.choice(codec.can_ids), dice.randbytes(dice.randrange(9))
    if kind == 3:
        return dice.choice(codec.can_ids), dice.randbytes(8)
    can_id, data = dice.choice(good)
    if kind == 4:
        return can_id, data[: dice.randrange(8)]
    if kind == 5:
        return dice.choice(codec.can_ids), data
    changed = bytearray(data)
    for _ in range(dice.randrange(1, 4)):
        changed[dice.randrange(len(changed))] ^= 1 << dice.randrange(8)
    return can_id, bytes(changed)


def is_whole(codec: Codec, can_id: int, data: bytes) -> bool:
    """Whether AUTOSAR's profile takes the frame, as another implementation sees it."""
    if can_id not in codec.can_ids or len(data) != 8 or data[1] & 0xF == 15:
        return False
    data_id = codec.data_id(codec.decode(can_id, data)[0])
    return bool(data_id) and bool(e2e_p01_check(bytearray(data), data_id))


@pytest.mark.parametrize("role", PARTICIPANTS)
def test_nothing_breaks_a_participant(role: str, stack: ExitStack, tries: Tries) -> None:
    """It goes on cycle after cycle, and sends only frames of the DBC, all of them whole."""
    frames_a_cycle = tries(100_000, 1_000_000) // CYCLES
    victim = Victim(role, stack)
    dice = random.Random(20200101)
    answered = 0
    for cycle in range(CYCLES):
        good = victim.others(cycle)
        by_bus = {bus: [(can_id, data) for on, can_id, data in good if on == bus] for bus in victim.buses}
        # Frames of the bench's own protocol are a matter of the bench; the rest of the world sends all else.
        bench = {0x010, 0x011}
        victim.sync(cycle)
        for bus, can_id, data in good:
            victim.far[bus].send(can_id, data)
        for number in range(frames_a_cycle):
            bus = victim.buses[number % len(victim.buses)]
            can_id, data = garbage(dice, CODECS[bus], by_bus[bus] or [(0x100, bytes(8))])
            if can_id not in bench:
                victim.far[bus].send(can_id, data)
        victim.node.poll()
        for bus in victim.buses:
            for can_id, data in victim.far[bus].receive():
                name, _ = CODECS[bus].decode(can_id, data)
                if CODECS[bus].data_id(name):
                    assert is_whole(CODECS[bus], can_id, data), (name, data)
                    answered += 1
    assert not victim.node.stopped
    assert answered >= CYCLES


@pytest.mark.parametrize("role", PARTICIPANTS)
def test_no_frame_with_a_wrong_crc_is_taken(role: str, stack: ExitStack, tries: Tries) -> None:
    """Of random frames the receiver takes at most those whose CRC is right by chance, one in 256."""
    victim = Victim(role, stack)
    inbox = victim.node._inbox  # type: ignore[attr-defined]
    dice = random.Random(20200102)
    inputs = {(slot.topic.bus, can_id) for bus in inbox._buses for can_id, slot in bus.slots.items()}
    targets = sorted(target for target in inputs if target[1] != 0x010)
    count, whole = tries(20_000, 100_000), 0
    for _ in range(count):
        bus, can_id = dice.choice(targets)
        data = dice.randbytes(8)
        whole += is_whole(CODECS[bus], can_id, data)
        victim.far[bus].send(can_id, data)
    while inbox.drain():
        pass
    refused = sum(bus.errors for bus in inbox._buses)
    assert whole == pytest.approx(count / 256 * 15 / 16, rel=0.4)
    assert count - refused <= whole
