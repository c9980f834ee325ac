"""A node's inbox on direct links: which cycle a frame belongs to, what is refused, and what a step is told of it."""

from collections.abc import Collection, Mapping

import pytest

from bench.bus.codec import load_codecs
from bench.bus.e2e import protect
from bench.bus.inbox import Inbox
from bench.bus.link.address import Address
from bench.bus.link.direct import DirectLink, Hub
from bench.bus.link.opening import open_link
from bench.bus.reception import Reception, ReceptionState
from bench.bus.states import BenchCommand
from bench.bus.topic import Signals, Topic
from bench.errors import BadInput
from bench.faults.base import Fault
from bench.faults.nodes import BusOff, V2VOutage
from bench.faults.plan import FaultBoard, FaultPlan

MOTION = Topic("veh1", "VehicleMotion")
PEER = Topic("v2v", "V2VPosition_2")
REFERENCE = Topic("veh1", "Reference")
BUSES = ("veh1", "v2v")
CODECS = load_codecs(2)
MOTION_VALUES = {"VelocityX": 20.0, "VelocityY": 0.0, "YawRate": 0.0}
MOTION_ID = CODECS["veh1"].can_id("VehicleMotion")
TIMEOUT = CODECS["veh1"].timeout_cycles("VehicleMotion")


class Rig:
    """An inbox on both buses of veh1, and the other ends; `now` is its clock (s)."""

    def __init__(
        self,
        *topics: Topic,
        own: tuple[Topic, ...] = (),
        faults: tuple[Fault, ...] = (),
        board: FaultBoard | None = None,
    ) -> None:
        address = Address.parse("direct")
        self.far = {bus: open_link(bus, address) for bus in BUSES}
        near = {bus: open_link(bus, address) for bus in BUSES}
        self.now = 0.0
        self.inbox = Inbox(
            near,
            CODECS,
            topics or (MOTION,),
            name="veh1.planner",
            own=own,
            plan=FaultPlan(faults, board=board),
            clock=lambda: self.now,
        )

    def send(self, bus: str, message: str, values: Mapping[str, float], counter: int, turned_bit: int = 0) -> None:
        can_id, data = CODECS[bus].encode(message, values, counter)
        self.far[bus].send(can_id, bytes([data[0] ^ turned_bit, *data[1:]]))

    def sync(self, cycle: int, *buses: str, command: BenchCommand = BenchCommand.RUN) -> None:
        for bus in buses or BUSES:
            self.send(bus, "BenchSync", {"Command": command, "Cycle": cycle, "Time": cycle / 100}, cycle)

    def motion(self, cycle: int, v_x: float = 20.0, turned_bit: int = 0) -> None:
        self.send("veh1", "VehicleMotion", MOTION_VALUES | {"VelocityX": v_x}, cycle, turned_bit)

    def peer(self, cycle: int, x: float) -> None:
        self.send("v2v", "V2VPosition_2", {"X": x, "Y": 0.0}, cycle)

    def absent(self, cycle: int, message: str, bus: str = "veh1", turned_bit: int = 0) -> None:
        values = {"Identifier": CODECS[bus].can_id(message), "Cycle": cycle}
        self.send(bus, "BenchAbsent", values, cycle, turned_bit)

    def drained(self) -> Inbox:
        self.inbox.drain()
        return self.inbox

    def step(self, topic: Topic = MOTION) -> Signals | None:
        """Take in what has come and step, which must be possible; what the step gets of `topic`."""
        assert self.drained().complete
        return self.inbox.take()[topic]

    def heard(self, topic: Topic = MOTION) -> Reception:
        return self.inbox.health.of(topic)


def test_there_is_nothing_to_drain_where_nothing_came() -> None:
    rig = Rig()
    assert rig.inbox.drain() is False
    rig.sync(0)
    assert rig.inbox.drain() is True
    assert rig.inbox.drain() is False


def test_before_the_first_bench_sync_no_cycle_is_open_and_time_is_virtual() -> None:
    inbox = Rig().inbox
    assert (inbox.cycle, inbox.opened, inbox.stopped, inbox.realtime) == (0, -1, False, False)
    assert (inbox.opened_at, inbox.late) == (0.0, 0)


def test_links_are_told_which_frames_are_wanted() -> None:
    class Selective(DirectLink):
        wanted: Collection[int] = ()

        def select(self, can_ids: Collection[int]) -> None:
            self.wanted = can_ids

    links = {bus: Selective(bus, Hub()) for bus in BUSES}
    Inbox(links, CODECS, (MOTION, PEER))
    for bus, message in (("veh1", "VehicleMotion"), ("v2v", "V2VPosition_2")):
        wanted = [CODECS[bus].can_id(name) for name in ("BenchSync", "BenchAbsent", message)]
        assert sorted(links[bus].wanted) == sorted(wanted)


def test_a_frame_that_was_not_asked_for_changes_nothing() -> None:
    """To a link, the selection is a hint."""

    class Unselective(DirectLink):
        def select(self, can_ids: Collection[int]) -> None:
            pass

    hub = Hub()
    far, near = DirectLink("veh1", hub), Unselective("veh1", hub)
    inbox = Inbox({"veh1": near}, CODECS, (MOTION,))
    far.send(0x7FF, bytes(8))
    assert inbox.drain()
    assert (inbox.health.e2e_errors, inbox.opened, inbox.complete) == (0, -1, False)


def test_a_cycle_is_complete_with_every_bench_sync_and_every_input() -> None:
    rig = Rig()
    rig.sync(0, "veh1")
    rig.motion(0)
    assert not rig.drained().complete
    rig.sync(0, "v2v")
    assert rig.drained().complete


def test_in_virtual_time_a_node_awaits_the_first_of_its_buses_that_lacks_a_frame() -> None:
    rig = Rig(MOTION, PEER)
    near = {bus.link.name: bus.link for bus in rig.inbox._buses}
    assert rig.drained().awaited is None, "it does not know yet which cycle is next"
    rig.sync(0)
    assert rig.drained().awaited is near["veh1"]
    rig.motion(0)
    assert rig.drained().complete, "in the first cycle there is no peer's frame of the one before"
    assert rig.inbox.awaited is None
    rig.inbox.take()
    rig.sync(1, "veh1")
    rig.motion(1)
    assert rig.drained().awaited is near["v2v"]


def test_in_real_time_frames_on_any_bus_matter() -> None:
    rig = Rig()
    rig.sync(0, command=BenchCommand.RUN_REALTIME)
    assert rig.drained().awaited is None


def test_a_bench_sync_twice_counts_once_and_is_an_error() -> None:
    rig = Rig()
    rig.sync(0, "veh1", "veh1")
    rig.motion(0)
    assert not rig.drained().complete
    assert rig.inbox.health.e2e_errors == 0, "it is told with the next"
    rig.sync(0, "v2v")
    assert rig.drained().complete
    rig.inbox.take()
    rig.sync(1)
    assert rig.drained().health.e2e_errors == 1


def test_the_count_of_errors_is_that_up_to_the_newest_bench_sync() -> None:
    """So it does not depend on how soon a frame was read."""
    rig = Rig()
    rig.sync(0)
    rig.motion(0, turned_bit=1)
    assert rig.drained().health.e2e_errors == 0
    rig.motion(0)
    assert rig.step() is not None
    rig.sync(1)
    assert rig.drained().health.e2e_errors == 1


def test_states_outside_their_value_table_make_a_frame_an_error_though_its_crc_is_good() -> None:
    rig = Rig(REFERENCE)
    values = CODECS["veh1"].start_values("Reference")
    state = CODECS["veh1"].message("Reference").get_signal_by_name("ReferenceState")
    for cycle in range(2):
        rig.sync(cycle)
        can_id, data = CODECS["veh1"].encode("Reference", values, cycle)
        impossible = int.from_bytes(data, "little") | (1 << state.length) - 1 << state.start
        frame = bytearray(impossible.to_bytes(len(data), "little"))
        protect(frame, CODECS["veh1"].data_id("Reference"), cycle)
        rig.far["veh1"].send(can_id, bytes(frame))
        assert rig.step(REFERENCE) is None
        assert rig.heard(REFERENCE) == Reception(ReceptionState.ERROR, 1 + cycle)
    rig.sync(2)
    rig.send("veh1", "Reference", values | {"ReferenceState": 1}, 2)
    assert rig.step(REFERENCE) is not None
    assert rig.heard(REFERENCE) == Reception(ReceptionState.OK, 0)
    assert rig.inbox.health.e2e_errors == 2


def test_every_refused_frame_counts() -> None:
    rig = Rig(MOTION, REFERENCE)
    rig.sync(0)
    for _ in range(3):
        rig.motion(0, turned_bit=1)
    for turned_bit in (1, 0):
        rig.absent(0, "VehicleMotion", turned_bit=turned_bit)
    rig.absent(0, "Reference", turned_bit=1)
    rig.absent(0, "Reference")
    rig.step()
    rig.sync(1)
    rig.motion(0)  # twice late by a cycle
    rig.motion(0)
    assert rig.drained().health.e2e_errors == 5
    rig.sync(2)
    assert rig.drained().health.e2e_errors == 7


@pytest.mark.parametrize("length", [2, 7, 9])
def test_a_frame_of_another_length_is_an_error_though_its_crc_is_good(length: int) -> None:
    rig = Rig()
    rig.sync(0)
    frame = bytearray(length)
    protect(frame, CODECS["veh1"].data_id("VehicleMotion"), 0)
    rig.far["veh1"].send(MOTION_ID, bytes(frame))
    assert not rig.drained().complete
    rig.absent(0, "VehicleMotion")
    assert rig.step() is None
    assert rig.heard() == Reception(ReceptionState.ERROR, 1)


@pytest.mark.parametrize("length", [0, 1, 7])
def test_a_frame_of_another_length_is_an_error(length: int) -> None:
    rig = Rig()
    rig.sync(0)
    can_id, data = CODECS["veh1"].encode("VehicleMotion", MOTION_VALUES, 0)
    rig.far["veh1"].send(can_id, data[:length])
    assert not rig.drained().complete
    rig.absent(0, "VehicleMotion")
    assert rig.step() is None
    assert rig.heard() == Reception(ReceptionState.ERROR, 1)


def test_an_announcement_with_a_wrong_crc_or_length_ends_no_wait() -> None:
    rig = Rig()
    rig.sync(0)
    rig.absent(0, "VehicleMotion", turned_bit=1)
    can_id, data = CODECS["veh1"].encode("BenchAbsent", {"Identifier": MOTION_ID, "Cycle": 0}, 0)
    rig.far["veh1"].send(can_id, data[:7])
    assert not rig.drained().complete
    rig.motion(0)
    assert rig.step() is not None
    rig.sync(1)
    assert rig.drained().health.e2e_errors == 2


def test_an_announcement_after_the_frame_itself_takes_nothing_away() -> None:
    rig = Rig()
    rig.sync(0)
    rig.motion(0, v_x=12.0)
    rig.absent(0, "VehicleMotion")
    motion = rig.step()
    assert motion is not None
    assert motion["VelocityX"] == pytest.approx(12.0)


def test_an_announcement_of_a_cycle_that_is_over_changes_nothing() -> None:
    rig = Rig()
    rig.sync(0)
    rig.motion(0)
    assert rig.step() is not None
    rig.absent(0, "VehicleMotion")
    assert not rig.drained().complete
    rig.sync(1)
    rig.motion(1)
    assert rig.step() is not None


def test_an_announcement_of_another_message_is_of_no_concern() -> None:
    rig = Rig()
    rig.sync(0)
    rig.absent(0, "WheelSpeedsFront")
    assert not rig.drained().complete
    assert not rig.inbox.excused


def test_a_frame_that_an_announcement_has_ruled_out_comes_too_late() -> None:
    rig = Rig()
    rig.sync(0)
    rig.absent(0, "VehicleMotion")
    rig.motion(0)
    assert rig.step() is None


def test_an_announcement_of_the_nodes_own_frame_excuses_it_from_that_cycle_alone() -> None:
    rig = Rig(own=(REFERENCE,))
    rig.sync(0)
    assert not rig.drained().excused
    rig.absent(0, "Reference")
    assert rig.drained().excused
    rig.inbox.skip()
    assert rig.inbox.cycle == 1
    assert not rig.inbox.excused


def test_a_peers_announcement_is_for_the_step_its_frame_would_have_taken_part_in() -> None:
    rig = Rig(PEER)
    rig.sync(0)
    assert rig.step(PEER) is None
    rig.sync(1)
    rig.absent(0, "V2VPosition_2", "v2v")
    assert rig.step(PEER) is None
    assert rig.heard(PEER) == Reception(ReceptionState.INIT, 2)
    rig.sync(2)
    rig.peer(1, x=8.0)
    heard = rig.step(PEER)
    assert heard is not None
    assert heard["X"] == pytest.approx(8.0, abs=1e-3)


def test_a_skipped_cycle_is_one_more_without_a_frame_where_none_came() -> None:
    rig = Rig()
    rig.sync(0)
    rig.motion(0)
    assert rig.step() is not None
    rig.sync(1)
    rig.drained().skip()
    assert rig.heard() == Reception(ReceptionState.MISSING, 1)
    rig.sync(2)
    rig.motion(2)
    assert rig.step() is not None, "the counter went on by two, for the cycle that brought no frame"


def test_a_step_that_did_not_wait_is_one_more_without_a_frame() -> None:
    rig = Rig()
    rig.sync(0, command=BenchCommand.RUN_REALTIME)
    rig.motion(0)
    assert rig.step() is not None
    rig.sync(1, command=BenchCommand.RUN_REALTIME)
    assert rig.drained().take()[MOTION] is None
    assert rig.heard() == Reception(ReceptionState.MISSING, 1)
    rig.sync(2, command=BenchCommand.RUN_REALTIME)
    rig.motion(2)
    assert rig.step() is not None, "the counter went on by two, for the cycle that brought no frame"


def test_a_skipped_cycle_uses_up_its_frame() -> None:
    rig = Rig()
    rig.sync(0)
    rig.motion(0)
    rig.drained().skip()
    assert rig.heard() == Reception(ReceptionState.OK, 0)
    rig.sync(1)
    assert not rig.drained().complete


def test_a_message_is_lost_from_its_timeout_on() -> None:
    rig = Rig()
    rig.sync(0)
    rig.motion(0)
    rig.step()
    states = []
    for cycle in range(1, TIMEOUT + 2):
        rig.sync(cycle)
        rig.absent(cycle, "VehicleMotion")
        rig.step()
        states.append(rig.heard().state)
    assert states == [ReceptionState.MISSING] * (TIMEOUT - 1) + [ReceptionState.LOST] * 2


def test_a_refusal_is_told_in_the_step_it_belongs_to_only() -> None:
    rig = Rig()
    for cycle, turned_bit in ((0, 0), (1, 1), (2, 0)):
        rig.sync(cycle)
        rig.motion(cycle, turned_bit=turned_bit)
        rig.absent(cycle, "VehicleMotion")
        rig.step()
        assert rig.heard().state is (ReceptionState.ERROR if turned_bit else ReceptionState.OK)


def test_a_step_with_its_frame_lets_the_counter_go_on_by_one_only() -> None:
    rig = Rig()
    for cycle in range(2):
        rig.sync(cycle)
        rig.motion(cycle)
        assert rig.step() is not None
    rig.sync(2)
    rig.motion(3)
    assert not rig.drained().complete
    rig.sync(3)
    rig.absent(2, "VehicleMotion")
    rig.step()
    assert rig.step() is None
    assert rig.heard().state is ReceptionState.MISSING
    assert rig.inbox.health.e2e_errors == 1


def test_after_a_silence_of_all_counters_the_next_frame_is_refused_and_not_waited_for() -> None:
    """Its counter is that of the last one: the profile cannot tell it from the same frame again."""
    rig = Rig()
    rig.sync(0)
    rig.motion(0)
    rig.step()
    for cycle in range(1, 15):
        rig.sync(cycle)
        rig.absent(cycle, "VehicleMotion")
        rig.step()
    rig.sync(15)
    rig.motion(15)
    assert rig.step() is None
    rig.sync(16)
    rig.motion(16)
    assert rig.step() is not None


def test_a_frame_after_a_later_one_is_not_used_but_ends_the_wait() -> None:
    """Anybody may have sent the later one."""
    rig = Rig()
    rig.sync(0)
    rig.motion(1)
    assert not rig.drained().complete
    rig.motion(0)
    assert rig.step() is None
    assert rig.inbox.health.e2e_errors == 0, "it is told with the next"
    rig.sync(1)
    assert rig.drained().health.e2e_errors == 1


def test_a_frame_after_the_announcement_of_a_later_one_is_used() -> None:
    rig = Rig()
    rig.sync(0)
    rig.absent(1, "VehicleMotion")
    rig.motion(0)
    assert rig.step() is not None
    rig.sync(1)
    assert rig.step() is None


def test_a_frame_late_by_thirteen_cycles_is_not_taken_for_one_to_come() -> None:
    rig = Rig()
    for cycle in range(13):
        rig.sync(cycle)
        rig.absent(cycle, "VehicleMotion")
        rig.step()
    rig.sync(13)
    rig.motion(0)
    for cycle in (13, 14, 15):
        rig.absent(cycle, "VehicleMotion")
        rig.sync(cycle + 1)
        assert rig.step() is None


def test_a_frame_of_neither_of_the_first_two_cycles_before_any_bench_sync_is_old() -> None:
    rig = Rig()
    rig.motion(2)
    for cycle in range(3):
        rig.sync(cycle)
        rig.absent(cycle, "VehicleMotion")
        assert rig.step() is None


def test_before_the_bench_sync_of_its_own_bus_that_of_another_tells_a_frames_cycle() -> None:
    rig = Rig(PEER)
    rig.sync(0, "veh1")
    rig.sync(1, "veh1")
    rig.peer(1, x=5.0)
    rig.drained()
    rig.sync(0, "v2v")
    rig.sync(1, "v2v")
    rig.step(PEER)
    rig.absent(0, "V2VPosition_2", "v2v")
    rig.step(PEER)
    rig.sync(2)
    heard = rig.step(PEER)
    assert heard is not None
    assert heard["X"] == pytest.approx(5.0, abs=1e-3)


def test_a_node_that_was_stopped_reads_bus_by_bus_and_numbers_each_by_its_own_bench_syncs() -> None:
    rig = Rig(PEER)
    for cycle in range(20):
        rig.sync(cycle)
        rig.peer(cycle, x=float(cycle))
    assert rig.step(PEER) is None
    for cycle in range(1, 20):
        heard = rig.step(PEER)
        assert heard is not None
        assert heard["X"] == pytest.approx(cycle - 1, abs=1e-3)
    assert rig.inbox.health.e2e_errors == 0


def test_nothing_is_kept_of_cycles_that_are_over() -> None:
    rig = Rig(own=(REFERENCE,))
    for cycle in range(3):
        rig.sync(cycle)
        rig.motion(cycle)
        rig.absent(cycle, "Reference")
        rig.step()
    assert not rig.inbox._arrived
    assert not rig.inbox._excused
    assert not any(slot.waiting for slot in rig.inbox._slots)


def test_a_good_frame_that_is_late_by_cycles_is_out_of_sequence() -> None:
    rig = Rig()
    for cycle in range(3):
        rig.sync(cycle)
        rig.absent(cycle, "VehicleMotion")
        rig.step()
    rig.sync(3)
    rig.motion(1)
    assert not rig.drained().complete
    rig.absent(3, "VehicleMotion")
    assert rig.step() is None
    assert rig.heard().state is ReceptionState.WRONG_SEQUENCE
    rig.sync(4)
    assert rig.drained().health.e2e_errors == 1


@pytest.mark.parametrize("first", [0, 13, 14, 15, 1234])
def test_the_alive_counter_tells_the_cycle_beside_every_wrap(first: int) -> None:
    rig = Rig()
    rig.sync(first)
    rig.motion(first, v_x=1.0)
    assert rig.step() is not None
    # A frame may be here before the BenchSync of its cycle, not earlier.
    rig.motion(first + 1, v_x=2.0)
    rig.sync(first + 1)
    motion = rig.step()
    assert motion is not None
    assert motion["VelocityX"] == pytest.approx(2.0)
    assert rig.inbox.cycle == first + 2


def test_a_node_that_joins_forgets_what_it_could_not_number() -> None:
    rig = Rig(MOTION, PEER)
    rig.motion(1236)
    rig.peer(1236, x=1.0)
    rig.sync(1237)
    rig.motion(1237, v_x=9.0)
    assert rig.drained().cycle == 1237
    assert rig.inbox.complete, "what is sent by radio was sent before it was there, and is not waited for"
    inputs = rig.inbox.take()
    motion = inputs[MOTION]
    assert motion is not None
    assert motion["VelocityX"] == pytest.approx(9.0)
    assert inputs[PEER] is None


def test_stop_is_told_and_opens_no_cycle() -> None:
    rig = Rig()
    rig.sync(0)
    rig.drained()
    assert not rig.inbox.stopped
    rig.sync(1, command=BenchCommand.STOP)
    assert rig.drained().stopped
    assert rig.inbox.opened == 0


FORGED = [
    {"Command": 1, "Cycle": 4_000_000, "Time": 16_777.215},
    {"Command": 2, "Cycle": 4_000_000, "Time": 16_777.215},
    {"Command": 1, "Cycle": 5, "Time": 0.05},
    {"Command": 1, "Cycle": 3, "Time": 0.03},
    {"Command": 1, "Cycle": 2, "Time": 0.02},
    {"Command": 1, "Cycle": 0, "Time": 0.0},
    {"Command": 1, "Cycle": 4, "Time": 1.0},
    {"Command": 2, "Cycle": 4, "Time": 0.04},
    {"Command": 0, "Cycle": 0, "Time": 0.0},
    {"Command": 0, "Cycle": 5, "Time": 0.05},
    {"Command": 0, "Cycle": 1_000, "Time": 10.0},
]
"""BenchSync with a good CRC after that of cycle 3, in virtual time."""


@pytest.mark.parametrize("values", FORGED)
@pytest.mark.parametrize("bus", BUSES)
def test_a_bench_sync_that_does_not_follow_is_refused(bus: str, values: dict[str, float]) -> None:
    rig = Rig()
    for cycle in range(4):
        rig.sync(cycle)
        rig.send(bus, "BenchSync", values, int(values["Cycle"]))
        rig.motion(cycle)
        if cycle < 3:
            rig.step()
    assert not rig.drained().stopped
    assert (rig.inbox.cycle, rig.inbox.opened, rig.inbox.realtime) == (3, 3, False)
    rig.step()
    rig.sync(4)
    rig.motion(4)
    assert rig.step() is not None
    assert rig.inbox.health.e2e_errors >= 4


@pytest.mark.parametrize("length", [0, 1, 2, 7])
def test_a_bench_sync_of_another_length_is_refused(length: int) -> None:
    rig = Rig()
    can_id, data = CODECS["veh1"].encode("BenchSync", {"Command": 1, "Cycle": 0, "Time": 0.0}, 0)
    rig.far["veh1"].send(can_id, data[:length])
    assert rig.drained().opened == -1
    rig.sync(0)
    assert rig.drained().health.e2e_errors == 1


def test_a_bench_sync_whose_counter_is_not_that_of_its_cycle_is_refused() -> None:
    rig = Rig()
    rig.send("veh1", "BenchSync", {"Command": 1, "Cycle": 0, "Time": 0.0}, 1)
    assert rig.drained().opened == -1


@pytest.mark.parametrize(
    ("run", "stopping"), [(BenchCommand.RUN, {5}), (BenchCommand.RUN_REALTIME, {3, 4, 5})], ids=["virtual", "real"]
)
def test_stop_is_obeyed_after_a_cycle_only_and_in_real_time_a_little_late(
    run: BenchCommand, stopping: set[int]
) -> None:
    for cycle in (0, 2, 3, 4, 5, 6, 1_000):
        rig = Rig()
        rig.sync(cycle, command=BenchCommand.STOP)
        assert not rig.drained().stopped
        for number in range(5):
            rig.sync(number, command=run)
        rig.sync(cycle, command=BenchCommand.STOP)
        assert rig.drained().stopped is (cycle in stopping), cycle


def test_a_node_that_is_not_settled_is_not_stopped() -> None:
    rig = Rig()
    rig.sync(40)
    rig.sync(41, command=BenchCommand.STOP)
    assert not rig.drained().stopped


def test_stop_of_cycle_0_is_what_start_values_make_and_stops_nobody() -> None:
    rig = Rig()
    rig.sync(0, command=BenchCommand.RUN_REALTIME)
    rig.send("veh1", "BenchSync", CODECS["veh1"].start_values("BenchSync"), 0)
    assert not rig.drained().stopped


@pytest.mark.parametrize("forged", [2, 777, 1_000_000])
@pytest.mark.parametrize("bus", BUSES)
def test_a_forged_bench_sync_before_the_first_cycle_keeps_nobody_from_it(forged: int, bus: str) -> None:
    rig = Rig(MOTION, PEER)
    rig.sync(forged, bus)
    rig.motion(forged)
    rig.drained()
    rig.sync(0)
    rig.motion(0)
    inputs = rig.drained()
    assert (inputs.cycle, inputs.opened, inputs.settled, inputs.complete) == (0, 0, True, True)
    rig.sync(forged, bus)
    assert rig.drained().opened == 0


def test_a_node_that_joins_is_settled_with_the_second_bench_sync() -> None:
    rig = Rig()
    rig.sync(40)
    assert not rig.drained().settled
    rig.sync(90)
    assert (rig.drained().cycle, rig.inbox.settled) == (90, False)
    rig.sync(91)
    assert rig.drained().settled
    rig.sync(40)
    assert rig.drained().opened == 91


def test_a_node_that_does_not_join_begins_with_cycle_0() -> None:
    address = Address.parse("direct")
    far, near = open_link("veh1", address), open_link("veh1", address)
    inbox = Inbox({"veh1": near}, CODECS, (MOTION,), joins=False)
    for cycle, opened in ((7, -1), (0, 0)):
        values = {"Command": BenchCommand.RUN, "Cycle": cycle, "Time": cycle / 100}
        far.send(*CODECS["veh1"].encode("BenchSync", values, cycle))
        inbox.drain()
        assert inbox.opened == opened


def test_in_real_time_lost_bench_syncs_are_passed_over_but_none_is_far_ahead_of_the_clock() -> None:
    rig = Rig()
    for cycle, opened in ((0, 0), (1, 1), (3, 3), (2, 3), (150, 3), (4, 4)):
        rig.now = cycle / 100 if cycle < 100 else rig.now
        rig.sync(cycle, command=BenchCommand.RUN_REALTIME)
        assert rig.drained().opened == opened
    rig.now = 9.0
    rig.sync(900, command=BenchCommand.RUN_REALTIME)
    assert rig.drained().opened == 900
    rig.sync(901)
    assert rig.drained().opened == 900, "virtual time does not follow the wall clock"


def test_in_real_time_nothing_is_announced() -> None:
    rig = Rig(own=(REFERENCE,))
    rig.sync(0, command=BenchCommand.RUN_REALTIME)
    rig.absent(0, "VehicleMotion")
    rig.absent(0, "Reference")
    rig.motion(0)
    assert not rig.drained().excused
    assert rig.step() is not None
    rig.sync(1, command=BenchCommand.RUN_REALTIME)
    assert rig.drained().health.e2e_errors == 2


def test_announcements_far_ahead_are_refused_and_not_kept() -> None:
    rig = Rig(own=(REFERENCE,))
    rig.sync(0)
    for cycle in range(2, 500):
        rig.absent(cycle, "Reference")
        rig.absent(cycle, "VehicleMotion")
    rig.motion(0)
    assert rig.step() is not None
    assert not rig.inbox._excused
    rig.sync(1)
    assert rig.drained().health.e2e_errors == 996


def test_bench_sync_cannot_be_announced_as_absent() -> None:
    rig = Rig()
    rig.absent(0, "BenchSync")
    rig.motion(0)
    rig.sync(0, "v2v")
    assert not rig.drained().complete
    rig.sync(0, "veh1")
    assert rig.step() is not None


def test_one_announcement_does_not_excuse_a_node_that_sends_more() -> None:
    """Anybody may have sent it; the node would be silent, and all wait for its other frames."""
    own = tuple(Topic("veh1", name) for name in ("Reference", "PlannerStatus", "PlannerBusHealth"))
    rig = Rig(own=own)
    rig.sync(0)
    for name, excused in (("Reference", False), ("PlannerStatus", False), ("PlannerBusHealth", True)):
        rig.absent(0, name)
        assert rig.drained().excused is excused
    rig.inbox.skip()
    rig.sync(1)
    # PlannerBusHealth has a longer cycle time.
    for name, excused in (("PlannerStatus", False), ("Reference", True)):
        rig.absent(1, name)
        assert rig.drained().excused is excused


def test_in_real_time_the_cycles_that_are_over_are_left_out_and_counted() -> None:
    rig = Rig()
    for cycle in range(3):
        rig.sync(cycle, command=BenchCommand.RUN_REALTIME)
    rig.drained().catch_up()
    assert rig.inbox.cycle == 2
    assert rig.inbox.health.late_cycles == 2


def test_in_virtual_time_no_cycle_is_left_out() -> None:
    rig = Rig()
    for cycle in range(3):
        rig.sync(cycle)
    rig.drained().catch_up()
    assert rig.inbox.cycle == 0
    assert rig.inbox.health.late_cycles == 0


def test_a_cycle_opened_at_the_earliest_that_any_bench_sync_tells() -> None:
    """A node that was busy reads a BenchSync late, but not every one."""
    rig = Rig()
    rig.now = 100.0
    rig.sync(0)
    rig.drained()
    assert rig.inbox.opened_at == pytest.approx(100.0)
    rig.now = 100.017  # 7 ms late
    rig.sync(1)
    assert rig.drained().opened_at == pytest.approx(100.01)
    rig.now = 100.015  # 5 ms early: so the first one was read late
    rig.sync(2)
    assert rig.drained().opened_at == pytest.approx(100.015)


@pytest.mark.parametrize(
    ("topic", "said"),
    [
        (
            Topic("veh1", "Nonsense"),
            f"input Nonsense does not exist on bus veh1; its DBC has {', '.join(CODECS['veh1'].names)}",
        ),
        (
            Topic("veh1", "PlannerStatus"),
            "input PlannerStatus on bus veh1 has no alive counter, which determines its cycle; "
            "only messages with an E2EDataId can be inputs",
        ),
        (Topic("veh2", "VehicleMotion"), "input VehicleMotion is on bus veh2; this node has veh1, v2v"),
    ],
)
def test_inputs_that_cannot_be_are_refused(topic: Topic, said: str) -> None:
    with pytest.raises(BadInput, match=said):
        Rig(topic)


def test_frames_that_are_no_input_do_not_matter() -> None:
    rig = Rig()
    rig.sync(0)
    rig.far["veh1"].send(0x7FF, b"")
    rig.send("veh1", "WheelSpeedsFront", CODECS["veh1"].start_values("WheelSpeedsFront"), 0, turned_bit=1)
    assert not rig.drained().complete
    rig.motion(0)
    assert rig.step() is not None
    rig.sync(1)
    assert rig.drained().health.e2e_errors == 0


@pytest.mark.parametrize(
    ("fault", "motion_lost", "peer_lost"),
    [
        (BusOff(at_s=0.01, for_s=0.01, node="veh1.planner"), True, False),
        (V2VOutage(at_s=0.01, for_s=0.01, vehicle=1), False, True),
        (BusOff(at_s=0.01, for_s=0.01, node="veh1.tracker"), False, False),
        (V2VOutage(at_s=0.01, for_s=0.01, vehicle=2), False, False),
    ],
)
def test_a_node_that_is_off_a_bus_gets_nothing_from_it_while_that_lasts(
    fault: Fault, motion_lost: bool, peer_lost: bool
) -> None:
    rig = Rig(MOTION, PEER, faults=(fault,))
    rig.peer(0, x=1.0)
    got = []
    for cycle in range(3):
        rig.sync(cycle)
        rig.motion(cycle)
        assert rig.drained().complete
        got.append(rig.inbox.take())
        rig.peer(cycle + 1, x=1.0)
    assert [inputs[MOTION] is None for inputs in got] == [False, motion_lost, False]
    assert [inputs[PEER] is None for inputs in got[1:]] == [peer_lost, False]


def test_only_a_benchsync_that_the_bench_has_sent_opens_a_cycle_or_ends_the_run() -> None:
    """However whole and consistent it is: another bench on the bus, a log that is replayed, or whoever makes it up."""
    board = FaultBoard(FaultBoard.create())
    rig = Rig(board=board)
    rig.sync(0)
    rig.sync(0, command=BenchCommand.RUN_REALTIME)
    rig.sync(1)
    assert rig.drained().opened == -1
    assert rig.inbox.cycle == 0
    board.open_cycle(0, realtime=False)
    rig.sync(0, command=BenchCommand.RUN_REALTIME)
    rig.sync(1)
    assert rig.drained().opened == -1
    rig.sync(0)
    assert rig.drained().opened == 0
    rig.sync(1)
    rig.sync(1, command=BenchCommand.STOP)
    assert rig.drained().opened == 0
    assert not rig.inbox.stopped
    board.open_cycle(1, realtime=False)
    rig.sync(1)
    assert rig.drained().opened == 1
    board.stop()
    rig.sync(2, command=BenchCommand.STOP)
    assert rig.drained().stopped


def test_no_absence_is_announced_of_a_cycle_that_the_bench_has_not_opened() -> None:
    """The conductor would refuse the announcement, and wait for the frame of a node that believes it."""
    board = FaultBoard(FaultBoard.create())
    rig = Rig(board=board, own=(MOTION,))
    board.open_cycle(0, realtime=False)
    rig.sync(0)
    rig.absent(0, "VehicleMotion")
    rig.absent(1, "VehicleMotion")
    assert rig.drained().excused
    rig.inbox.skip()
    assert not rig.inbox.excused
    board.open_cycle(1, realtime=False)
    rig.absent(1, "VehicleMotion")
    assert rig.drained().excused
