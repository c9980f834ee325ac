"""A node on direct links: when it steps, with what, and what it counts."""

import math
from collections.abc import Mapping

import numpy as np
import pytest

from bench.bus.codec import EncodeError, load_codecs
from bench.bus.link.address import Address
from bench.bus.link.base import Link
from bench.bus.link.opening import open_link
from bench.bus.reception import Reception, ReceptionState
from bench.ecu.base import Health, Outgoing, Signals, Topic
from bench.ecu.runtime import EcuNode
from bench.errors import BadInput
from bench.events import Clipped, EcuNote, NotANumber, NumberAgain

MOTION = Topic("veh1", "VehicleMotion")
PEER = Topic("v2v", "V2VPosition_2")
STATUS = Topic("veh1", "PlannerStatus")
CODECS = load_codecs(2)
MOTION_VALUES = {"VelocityX": 20.0, "VelocityY": 0.0, "YawRate": 0.0}


class Probe:
    """An ECU that keeps what it was called with and answers with a reference."""

    name = "veh1.planner"
    input_wait_s = 60.0

    def __init__(self, *inputs: Topic) -> None:
        self.inputs = inputs or (MOTION, PEER)
        self.steps: list[tuple[int, float, dict[Topic, Signals | None], Health]] = []
        self.answer = [Outgoing("veh1", "Reference", {"VelocityX": 20.0, "YawRate": 0.1, "ReferenceState": 1})]

    def step(self, cycle: int, time_s: float, inputs: Mapping[Topic, Signals | None], health: Health) -> list[Outgoing]:
        self.steps.append((cycle, time_s, dict(inputs), health))
        return self.answer


class Rig:
    """A node of `ecu` on v2v and veh1, and the other ends of both buses."""

    def __init__(self, ecu: Probe) -> None:
        address = Address.parse("direct")
        self.ecu = ecu
        self.far: dict[str, Link] = {bus: open_link(bus, address) for bus in ("veh1", "v2v")}
        self.near = {bus: open_link(bus, address) for bus in ("veh1", "v2v")}
        self.node = EcuNode(ecu.name, ecu, self.near, CODECS)

    def send(self, bus: str, message: str, values: Mapping[str, float], counter: int, *, spoil: bool = False) -> None:
        can_id, data = CODECS[bus].encode(message, values, counter)
        if spoil:
            data = bytes([data[0] ^ 1, *data[1:]])
        self.far[bus].send(can_id, data)

    def sync(self, cycle: int, *buses: str, command: int = 1) -> None:
        for bus in buses or ("veh1", "v2v"):
            values = {"Command": command, "Cycle": cycle, "Time": cycle / 100}
            self.send(bus, "BenchSync", values, cycle)

    def motion(self, cycle: int, speed: float = 20.0, *, spoil: bool = False) -> None:
        self.send("veh1", "VehicleMotion", MOTION_VALUES | {"VelocityX": speed}, cycle, spoil=spoil)

    def absent(self, cycle: int, message: str, bus: str = "veh1") -> None:
        self.send(bus, "BenchAbsent", {"Identifier": CODECS[bus].can_id(message), "Cycle": cycle}, cycle)

    def peer(self, cycle: int, x: float, *, spoil: bool = False) -> None:
        self.send("v2v", "V2VPosition_2", {"X": x, "Y": 0.0}, cycle, spoil=spoil)

    def cycle(self, number: int) -> None:
        """One whole cycle, in the usual order."""
        self.sync(number)
        self.motion(number)
        self.node.poll()
        self.peer(number, x=float(number))
        self.node.poll()

    def cycles_stepped(self) -> list[int]:
        return [cycle for cycle, *_ in self.ecu.steps]

    def seen(self, step: int, topic: Topic) -> Signals | None:
        return self.ecu.steps[step][2][topic]


@pytest.fixture
def rig() -> Rig:
    return Rig(Probe())


def test_steps_once_with_exactly_the_inputs_of_the_cycle(rig: Rig) -> None:
    rig.sync(0)
    assert rig.node.poll()
    assert rig.ecu.steps == []
    rig.motion(0, speed=21.0)
    rig.node.poll()
    rig.node.poll()
    ((cycle, time_s, inputs, health),) = rig.ecu.steps
    assert (cycle, time_s) == (0, 0.0)
    assert (health.frames_lost, health.e2e_errors) == (0, 0)
    assert health.of(MOTION) == Reception(ReceptionState.OK, 0)
    assert health.of(PEER) == Reception(ReceptionState.INIT, 1)
    assert set(inputs) == {MOTION, PEER}
    motion = inputs[MOTION]
    assert motion is not None
    assert motion["VelocityX"] == pytest.approx(21.0, abs=1e-9)


def test_waits_for_the_bench_sync_of_every_bus_it_is_on(rig: Rig) -> None:
    rig.motion(0)
    rig.sync(0, "veh1")
    rig.node.poll()
    assert rig.ecu.steps == []
    rig.sync(0, "v2v")
    rig.node.poll()
    assert rig.cycles_stepped() == [0]


def test_what_comes_by_radio_takes_part_one_cycle_later(rig: Rig) -> None:
    for number in range(40):
        rig.cycle(number)
    assert rig.cycles_stepped() == list(range(40))
    assert rig.seen(0, PEER) is None
    for number in range(1, 40):
        heard = rig.seen(number, PEER)
        assert heard is not None
        assert heard["X"] == pytest.approx(number - 1, abs=2e-4)
    assert rig.ecu.steps[-1][3].e2e_errors == 0


def test_peers_frame_before_the_own_bench_sync_waits_for_its_cycle(rig: Rig) -> None:
    rig.cycle(0)
    rig.peer(1, x=77.0)
    rig.node.poll()
    rig.motion(1)
    rig.node.poll()
    assert rig.cycles_stepped() == [0]
    rig.sync(1)
    rig.node.poll()
    rig.sync(2)
    rig.motion(2)
    rig.node.poll()
    assert rig.cycles_stepped() == [0, 1, 2]
    heard = [rig.seen(step, PEER) for step in (1, 2)]
    assert [values and round(values["X"]) for values in heard] == [0, 77]
    assert rig.ecu.steps[-1][3].e2e_errors == 0


def test_peers_first_frame_may_come_before_any_bench_sync(rig: Rig) -> None:
    rig.peer(0, x=5.0)
    rig.node.poll()
    rig.sync(0)
    rig.motion(0)
    rig.node.poll()
    rig.sync(1)
    rig.motion(1)
    rig.node.poll()
    heard = rig.seen(1, PEER)
    assert heard is not None
    assert round(heard["X"]) == 5


def test_a_damaged_frame_is_missing_and_counted(rig: Rig) -> None:
    rig.cycle(0)
    rig.sync(1)
    rig.motion(1, spoil=True)
    rig.node.poll()
    assert rig.cycles_stepped() == [0]
    rig.absent(1, "VehicleMotion")
    rig.node.poll()
    assert rig.cycles_stepped() == [0, 1]
    assert rig.seen(1, MOTION) is None
    assert rig.ecu.steps[1][3].of(MOTION) == Reception(ReceptionState.ERROR, 1)
    rig.peer(1, x=1.0)
    rig.cycle(2)
    assert rig.seen(2, MOTION) is not None
    assert rig.ecu.steps[2][3].e2e_errors == 1


def test_a_damaged_frame_too_many_takes_no_good_ones_place(rig: Rig) -> None:
    rig.cycle(0)
    rig.sync(1)
    rig.motion(1, speed=10.0, spoil=True)
    rig.motion(1, speed=11.0)
    rig.node.poll()
    motion = rig.seen(1, MOTION)
    assert motion is not None
    assert round(motion["VelocityX"]) == 11
    assert rig.ecu.steps[1][3].of(MOTION) == Reception(ReceptionState.OK, 0)


def test_a_message_is_lost_after_its_timeout_and_found_again(rig: Rig) -> None:
    rig.cycle(0)
    timeout = CODECS["veh1"].timeout_cycles("VehicleMotion")
    assert timeout > 1
    for number in range(1, timeout + 2):
        rig.sync(number)
        rig.peer(number - 1, x=0.0)
        rig.absent(number, "VehicleMotion")
        rig.node.poll()
    receptions = [health.of(MOTION) for _, _, _, health in rig.ecu.steps[1:]]
    assert [reception.age for reception in receptions] == list(range(1, timeout + 2))
    assert [reception.lost for reception in receptions] == [False] * (timeout - 1) + [True] * 2
    assert receptions[0].state is ReceptionState.MISSING
    rig.peer(timeout + 1, x=0.0)
    rig.cycle(timeout + 2)
    assert rig.ecu.steps[-1][3].of(MOTION) == Reception(ReceptionState.OK, 0)


def test_a_frame_that_is_cycles_late_is_not_used(rig: Rig) -> None:
    for number in range(3):
        rig.cycle(number)
    for number in (3, 4):
        rig.sync(number)
        rig.absent(number, "VehicleMotion")
        rig.peer(number - 1, x=0.0)
        rig.node.poll()
    rig.sync(5)
    rig.peer(4, x=0.0)
    rig.motion(3)
    rig.absent(5, "VehicleMotion")
    rig.node.poll()
    assert rig.cycles_stepped()[-1] == 5
    assert rig.seen(5, MOTION) is None
    assert rig.ecu.steps[-1][3].of(MOTION).state is ReceptionState.WRONG_SEQUENCE


def test_a_node_the_others_went_on_without_leaves_those_cycles_out(rig: Rig) -> None:
    rig.node = EcuNode("veh1.planner", rig.ecu, rig.near, CODECS, [Topic("veh1", "Reference")])
    rig.cycle(0)
    for number in range(1, 41):
        rig.sync(number)
        rig.absent(number, "Reference")
        rig.motion(number)
        rig.peer(number, x=float(number))
    rig.sync(41)
    rig.motion(41)
    rig.node.poll()
    assert rig.cycles_stepped() == [0, 41]
    heard = rig.seen(1, PEER)
    assert heard is not None
    assert round(heard["X"]) == 40


def test_in_real_time_late_cycles_are_left_out(rig: Rig) -> None:
    for number in range(4):
        rig.sync(number, command=2)
        rig.motion(number)
        rig.peer(number, x=float(number))
    rig.node.poll()
    assert rig.cycles_stepped() == [3]
    assert rig.ecu.steps[0][3].late_cycles == 3


def test_in_real_time_nobody_waits_for_ever(rig: Rig) -> None:
    rig.ecu.input_wait_s = 0.0
    rig.node = EcuNode("veh1.planner", rig.ecu, rig.near, CODECS)
    rig.sync(0, command=2)
    rig.node.poll()
    assert rig.cycles_stepped() == [0]
    assert rig.seen(0, MOTION) is None
    assert rig.node.wake_at is None


def test_what_an_ecu_does_not_say_is_announced_as_absent(rig: Rig) -> None:
    rig.ecu.answer = []
    rig.node = EcuNode("veh1.planner", rig.ecu, rig.near, CODECS, [Topic("veh1", "Reference"), STATUS])
    with pytest.warns(UserWarning, match="it does not send Reference") as told:
        rig.cycle(0)
    # Diagnostics may be left out without a word.
    assert len(told) == 1
    assert absent(rig) == [0x200, 0x500]


def absent(rig: Rig) -> list[float]:
    """The identifiers announced as absent on the vehicle's bus, which has nothing else from this ECU."""
    sent = [CODECS["veh1"].decode(*frame) for frame in rig.far["veh1"].receive()]
    assert {name for name, _ in sent} <= {"BenchAbsent"}
    return [values["Identifier"] for _, values in sent]


def test_a_repeated_frame_is_counted_and_left_aside(rig: Rig) -> None:
    rig.cycle(0)
    rig.sync(1)
    rig.motion(1, speed=10.0)
    rig.motion(1, speed=30.0)
    rig.node.poll()
    motion = rig.seen(1, MOTION)
    assert motion is not None
    assert round(motion["VelocityX"]) == 10
    rig.peer(1, x=1.0)
    rig.cycle(2)
    assert rig.cycles_stepped() == [0, 1, 2]
    assert rig.ecu.steps[2][3].e2e_errors == 1


def test_a_frame_may_come_after_the_next_bench_sync(rig: Rig) -> None:
    rig.cycle(0)
    rig.sync(1)
    rig.sync(2)
    rig.node.poll()
    assert rig.cycles_stepped() == [0]
    rig.motion(1, speed=10.0)
    rig.node.poll()
    assert rig.cycles_stepped() == [0, 1]
    rig.motion(2, speed=11.0)
    rig.peer(1, x=1.0)
    rig.node.poll()
    assert rig.cycles_stepped() == [0, 1, 2]
    speeds = [rig.seen(step, MOTION) for step in (1, 2)]
    assert [values and round(values["VelocityX"]) for values in speeds] == [10, 11]
    assert rig.ecu.steps[-1][3].e2e_errors == 0


def test_joins_a_run_under_way(rig: Rig) -> None:
    rig.peer(1233, x=1.0)
    rig.sync(1234)
    rig.motion(1234)
    rig.node.poll()
    rig.sync(1235)
    rig.motion(1235)
    rig.peer(1234, x=9.0)
    rig.node.poll()
    assert rig.cycles_stepped() == [1234, 1235]
    assert rig.ecu.steps[0][1] == pytest.approx(12.34)
    heard = rig.seen(1, PEER)
    assert heard is not None
    assert round(heard["X"]) == 9


def test_stops_without_another_step(rig: Rig) -> None:
    rig.cycle(0)
    rig.sync(1, command=0)
    rig.motion(1)
    rig.node.poll()
    assert rig.node.stopped
    assert rig.cycles_stepped() == [0]


def test_sends_with_the_cycle_as_alive_counter(rig: Rig) -> None:
    for number in range(17):
        rig.cycle(number)
    can_id = CODECS["veh1"].can_id("Reference")
    counters = [data[1] & 0x0F for got, data in rig.far["veh1"].receive() if got == can_id]
    assert counters == [*range(15), 0, 1]


def test_a_signal_left_out_is_sent_with_its_start_value(rig: Rig) -> None:
    rig.ecu.answer = [Outgoing("veh1", "Reference", {"YawRate": 0.25})]
    rig.cycle(0)
    values = dict(CODECS["veh1"].decode(*frame) for frame in rig.far["veh1"].receive())["Reference"]
    assert values["YawRate"] == pytest.approx(0.25)
    assert values["VelocityX"] == CODECS["veh1"].start_values("Reference")["VelocityX"]


NOT_NUMBERS = [math.nan, math.inf, -math.inf, np.float64("nan"), np.float32("inf")]


@pytest.mark.parametrize("value", NOT_NUMBERS, ids=repr)
def test_a_message_with_a_value_that_is_not_a_number_is_not_sent(rig: Rig, value: float) -> None:
    """Any number in its place would be obeyed: receivers of none hold, and then go to their safe state."""
    notes: list[EcuNote] = []
    topics = [Topic("veh1", "Reference"), STATUS]
    rig.node = EcuNode("veh1.planner", rig.ecu, rig.near, CODECS, topics, note=notes.append)
    good = Outgoing("veh1", "PlannerStatus", {"Slot": 3})
    bad = Outgoing("veh1", "Reference", {"YawRate": value, "VelocityX": 20.0})
    rig.ecu.answer = [bad, good]
    for cycle in (0, 1, 2):
        rig.cycle(cycle)
        sent = [CODECS["veh1"].decode(*frame) for frame in rig.far["veh1"].receive()]
        assert [name for name, _ in sent] == ["PlannerStatus", "BenchAbsent"]
        assert sent[1][1]["Identifier"] == 0x200
    rig.ecu.answer = [Outgoing("veh1", "Reference", {"YawRate": 0.1}), good]
    rig.cycle(3)
    assert len(rig.far["veh1"].receive()) == 2
    # Once, not in every cycle: it may last.
    assert notes == [
        NotANumber("veh1.planner", 0, "Reference", "YawRate", str(float(value)), command=True),
        NumberAgain("veh1.planner", 3, "Reference", "YawRate", 3),
    ]
    assert notes[0].level == "error"
    assert rig.node.not_numbers == 3


def test_a_diagnostic_that_is_not_a_number_is_not_sent_either(rig: Rig) -> None:
    notes: list[EcuNote] = []
    rig.node = EcuNode("veh1.planner", rig.ecu, rig.near, CODECS, [STATUS], note=notes.append)
    rig.ecu.answer = [Outgoing("veh1", "PlannerStatus", {"OptimisationCost": math.nan, "Slot": 1})]
    rig.cycle(0)
    assert absent(rig) == [0x500]
    assert notes == [NotANumber("veh1.planner", 0, "PlannerStatus", "OptimisationCost", "nan", command=False)]
    assert notes[0].level == "warning"


def test_a_value_outside_its_range_is_sent_as_the_end_of_it_and_that_is_said_once(rig: Rig) -> None:
    notes: list[EcuNote] = []
    rig.node = EcuNode("veh1.planner", rig.ecu, rig.near, CODECS, note=notes.append)
    for cycle, rate in enumerate((-1.5, 0.0, 7.0)):
        rig.ecu.answer = [Outgoing("veh1", "Reference", {"YawRate": rate, "VelocityX": 65.0})]
        rig.cycle(cycle)
    sent = [CODECS["veh1"].decode(*frame)[1]["YawRate"] for frame in rig.far["veh1"].receive()]
    assert sent == pytest.approx([-1.0, 0.0, 1.0])
    assert notes == [Clipped("veh1.planner", 0, "Reference", "YawRate", -1.5, -1.0)]


def test_times_of_the_wall_clock_may_be_too_long_for_their_signal(rig: Rig) -> None:
    notes: list[EcuNote] = []
    rig.node = EcuNode("veh1.planner", rig.ecu, rig.near, CODECS, note=notes.append)
    rig.ecu.answer = [Outgoing("veh1", "PlannerTiming", {"StepTime": 9e9})]
    rig.cycle(0)
    assert notes == []


def test_where_nobody_takes_notes_they_are_warnings(rig: Rig) -> None:
    rig.ecu.answer = [Outgoing("veh1", "Reference", {"YawRate": math.nan})]
    with pytest.warns(UserWarning, match=r"veh1\.planner: in cycle 0 Reference\.YawRate = nan is not a number"):
        rig.cycle(0)


def test_frames_of_others_do_not_matter(rig: Rig) -> None:
    rig.far["veh1"].send(0x7FF, b"")
    rig.far["veh1"].send(CODECS["veh1"].can_id("PlannerStatus"), bytes(8))
    rig.cycle(0)
    assert rig.cycles_stepped() == [0]
    assert rig.ecu.steps[0][3].e2e_errors == 0


def test_refuses_inputs_that_cannot_be() -> None:
    with pytest.raises(BadInput, match=r"veh1\.planner: input Nonsense does not exist on bus veh1.*VehicleMotion"):
        Rig(Probe(Topic("veh1", "Nonsense")))
    with pytest.raises(BadInput, match="PlannerStatus on bus veh1 has no alive counter"):
        Rig(Probe(Topic("veh1", "PlannerStatus")))
    with pytest.raises(BadInput, match="VehicleMotion is on bus veh2; this node has veh1, v2v"):
        Rig(Probe(Topic("veh2", "VehicleMotion")))


def test_refuses_to_send_on_a_bus_it_is_not_on(rig: Rig) -> None:
    rig.ecu.answer = [Outgoing("veh2", "Reference", {})]
    with pytest.raises(BadInput, match=r"veh1\.planner sends Reference on bus veh2; it is on veh1, v2v"):
        rig.cycle(0)


def test_refuses_to_send_a_message_that_the_dbc_does_not_have(rig: Rig) -> None:
    rig.ecu.answer = [Outgoing("veh1", "Nonsense", {})]
    with pytest.raises(EncodeError, match="Nonsense"):
        rig.cycle(0)


def test_diagnostics_that_a_step_leaves_out_are_not_sent(rig: Rig) -> None:
    """Not even with start values, which nobody could tell from values."""
    health = Topic("veh1", "PlannerBusHealth")
    rig.node = EcuNode("veh1.planner", rig.ecu, rig.near, CODECS, [STATUS, health])
    rig.ecu.answer = []
    period = CODECS["veh1"].period("PlannerBusHealth")
    assert period > 1
    for cycle in range(period + 1):
        rig.cycle(cycle)
        # Announced when it is due, so that nobody waits for it.
        due = [0x500, 0x504] if cycle % period == 0 else [0x500]
        assert absent(rig) == due

    rig.ecu.answer = [Outgoing("veh1", "PlannerStatus", {"Slot": 3})]
    rig.cycle(period + 1)
    sent = [CODECS["veh1"].decode(*frame) for frame in rig.far["veh1"].receive()]
    assert [(name, values["Slot"]) for name, values in sent] == [("PlannerStatus", 3)]


def test_in_real_time_nobody_waits_so_nothing_is_announced(rig: Rig) -> None:
    rig.node = EcuNode("veh1.planner", rig.ecu, rig.near, CODECS, [STATUS])
    rig.ecu.answer = []
    rig.sync(0, command=2)
    rig.motion(0)
    rig.node.poll()
    assert rig.cycles_stepped() == [0]
    assert absent(rig) == []
