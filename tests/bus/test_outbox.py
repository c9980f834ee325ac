"""What a node sends in a cycle; what faults do to that is in tests/faults/."""

import pytest

from bench.bus import e2e
from bench.bus.link.address import Address
from bench.bus.link.opening import open_link
from bench.bus.outbox import Outbox
from bench.errors import BadInput
from bench.faults.frames import FrameCorrupt, FrameLoss
from bench.faults.plan import FaultPlan
from tests.faults.sending import CODEC, CODECS, CYCLES, names, sent


def test_without_faults_every_frame_goes_out_once_and_is_good() -> None:
    came = sent()
    for cycle in range(CYCLES):
        assert names(came, cycle) == ["SteeringCommand", "TorqueCommandFront"]
        for name, values, data in came[cycle]:
            assert e2e.check(data, CODEC.data_id(name))
            assert values["AliveCounter"] == cycle % 15


def test_a_slow_message_goes_out_in_its_cycles_only() -> None:
    address = Address.parse("direct")
    far, near = open_link("veh1", address), open_link("veh1", address)
    outbox = Outbox("veh1.tracker", {"veh1": near}, CODECS)
    period = CODEC.period("TrackerBusHealth")
    assert period > 1
    for cycle in range(3 * period):
        outbox.put("veh1", "TrackerBusHealth", {})
        outbox.send(cycle)
    assert len(far.receive()) == 3


def test_an_absence_names_the_frame_and_its_cycle() -> None:
    address = Address.parse("direct")
    far, near = open_link("veh1", address), open_link("veh1", address)
    can_id = CODEC.can_id("TrackerStatus")
    Outbox("veh1.tracker", {"veh1": near}, CODECS).absent("veh1", can_id, 17)
    (announcement,) = far.receive()
    values = {"Identifier": can_id, "Cycle": 17}
    assert announcement == CODEC.encode("BenchAbsent", values, 17)


@pytest.mark.parametrize("faults", [(), (FrameLoss(at_s=0.0, bus="veh1", message="TrackerStatus"),)])
def test_a_message_of_times_has_the_largest_since_it_was_sent_before(faults: tuple[FrameLoss, ...]) -> None:
    """Any of a message's cycles may be the long one, and each signal has its own; a step may also be left out."""
    address = Address.parse("direct")
    far, near = open_link("veh1", address), open_link("veh1", address)
    outbox = Outbox("veh1.tracker", {"veh1": near}, CODECS, FaultPlan(faults))
    period = CODEC.period("TrackerTiming")
    assert period > 2
    steps = [{"StepTime": 500.0 + cycle % 3, "SolveTime": 90.0} for cycle in range(3 * period + 1)]
    steps[1]["StepTime"], steps[period]["SolveTime"], steps[period + 1]["SolveTime"] = 7000.0, 400.0, 300.0
    for cycle, times in enumerate(steps):
        if cycle != 2 * period:
            outbox.put("veh1", "TrackerTiming", times)
        outbox.put("veh1", "TrackerTarget", {"VelocityX": cycle / 100.0})
        outbox.send(cycle)
    came = [CODEC.decode(can_id, data) for can_id, data in far.receive()]
    told = [(values["StepTime"], values["SolveTime"]) for name, values in came if name == "TrackerTiming"]
    assert told == [(500.0, 90.0), (7000.0, 400.0), (502.0, 300.0)]
    # Everything else is as it was in the cycle.
    targets = [values["VelocityX"] for name, values in came if name == "TrackerTarget"]
    assert targets == pytest.approx([cycle / 100.0 for cycle in range(0, len(steps), period)])


def test_a_bus_that_the_node_is_not_on_is_refused() -> None:
    links = {bus: open_link(bus, Address.parse("direct")) for bus in ("veh1", "v2v")}
    outbox = Outbox("veh1.planner", links, CODECS)
    with pytest.raises(BadInput, match=r"veh1\.planner sends Reference on bus veh2; it is on veh1, v2v$"):
        outbox.put("veh2", "Reference", {})


@pytest.mark.parametrize(("kind", "announced"), [(FrameLoss, True), (FrameCorrupt, False)])
def test_an_unprotected_frame_is_announced_where_it_does_not_come_not_where_it_is_damaged(
    kind: type[FrameLoss | FrameCorrupt], announced: bool
) -> None:
    address = Address.parse("direct")
    far, near = open_link("veh1", address), open_link("veh1", address)
    fault = kind(at_s=0.0, bus="veh1", message="TrackerStatus")
    outbox = Outbox("veh1.tracker", {"veh1": near}, CODECS, FaultPlan([fault]))
    outbox.put("veh1", "TrackerStatus", {})
    outbox.send(16)
    ((can_id, data),) = far.receive()
    assert can_id == CODEC.can_id("BenchAbsent" if announced else "TrackerStatus")
    if announced:
        assert CODEC.decode(can_id, data)[1]["AliveCounter"] == 1
