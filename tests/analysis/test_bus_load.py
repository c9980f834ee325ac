"""What a real run did to its buses, against the worst case and against the frames themselves."""

import json
from dataclasses import replace

import numpy as np
import pytest

from bench.analysis.bus_load import bus_loads
from bench.analysis.bus_strip import strip
from bench.analysis.figures import Figures
from bench.analysis.report import render
from bench.bus.codec import load_codecs
from bench.bus.wire.frame_length import INTERFRAME_BITS, frame_bits
from bench.bus.wire.timing import BusTimeline
from bench.cycle import CYCLE_NS
from bench.record import Run
from bench.record.drawing import colour
from bench.record.writer import RunWriter

from .conftest import Motions


@pytest.fixture(scope="module")
def loads(formation_log):
    return {bus.bus: bus for bus in bus_loads(Run(formation_log))}


def test_every_bus_and_message_of_the_run_is_there(loads, formation):
    assert list(loads) == formation.buses == ["v2v", "veh1", "veh2", "veh3"]
    for name, bus in loads.items():
        # BenchAbsent is on no wire.
        recorded = {formation.can_id(name, message) for message in formation.messages(name)} - {0x11}
        assert {message.can_id for message in bus.messages} == recorded


def test_no_message_of_a_run_without_faults_takes_longer_than_its_bound(loads):
    messages = [message for bus in loads.values() for message in bus.messages]
    assert len(messages) > 80
    for message in messages:
        assert 0 < message.mean_s <= message.worst_s <= message.bound_s < message.period_s
        assert message.in_bound
        assert message.in_time


def test_the_load_is_that_of_the_bits(loads, formation):
    codecs = load_codecs(3)
    for name, bus in loads.items():
        frames = formation.frame_table(name)
        bits = frame_bits(frames["can_id"], frames["length"], frames["data"]) + INTERFRAME_BITS
        cycle = frames["time"] == 70 * 10_000_000
        assert bus.load[70] == pytest.approx(bits[cycle].sum() / (codecs[name].bit_rate * 0.01))
        assert len(bus.t) == len(bus.load) == 600
        assert 0 < bus.mean <= bus.worst < 1
        assert bus.mean < bus.most


def test_the_log_has_the_order_of_the_wire(formation):
    for name in formation.buses:
        frames = formation.frame_table(name)
        assert (frames["wire"] > frames["time"]).all()
        assert (np.diff(frames["wire"]) > 0).all()
    before = {}
    for frame in formation.frames():
        assert frame.wire_ns >= before.get(frame.time_ns, 0)
        before[frame.time_ns] = frame.wire_ns
        assert 0 < frame.response_ns <= frame.wire_ns - frame.time_ns


def test_the_picture_has_every_frame_of_the_busiest_cycles(loads):
    picture = strip(list(loads.values()))
    assert picture.count("<g>") == sum(len(bus.busiest) for bus in loads.values()) > 60
    assert "VehicleMotion (0x102): " in picture
    assert "not in the DBC" not in picture
    for bus in loads.values():
        starts = [frame.start_s for frame in bus.busiest]
        assert starts == sorted(starts)
        assert all(frame.release_s <= frame.start_s < frame.end_s for frame in bus.busiest)


def test_a_log_without_times_on_the_wire_has_a_report_without_buses(run_of):
    page = render(run_of(Motions(2, 20)))
    data = json.loads(page.split('id="data">')[1].split("</script>")[0])
    assert data["buses"] == []
    assert "busload" not in {figure["id"] for figure in data["figures"]}
    assert 'class="strip"' not in page


def test_cycles_without_frames_are_idle_however_many_they_are(tmp_path):
    """A damaged log may have any time: no memory is taken for the cycles up to there."""
    codecs, cycles = load_codecs(1), [0, 1, 900_000_000_000]
    with RunWriter(
        tmp_path / "run.mcap",
        codecs=codecs,
        truth_names=("X", "Y", "psi", "phi"),
        vehicles=1,
        metadata={"vehicles": "1"},
        attachments={},
        timeline=BusTimeline(codecs, {}),
    ) as writer:
        for cycle in cycles:
            data = codecs["veh1"].encode("ActuatorStatus", codecs["veh1"].start_values("ActuatorStatus"), cycle)
            writer.frame("veh1", cycle * CYCLE_NS, *data, 0)
    (load,) = bus_loads(Run(tmp_path / "run.mcap"))
    assert load.t.tolist() == [cycle / 100 for cycle in cycles]
    assert load.cycles == cycles[-1] + 1
    assert load.mean == pytest.approx(load.load.sum() / load.cycles)
    assert load.worst < 0.1


def test_a_bus_of_any_name_is_drawn(formation, loads):
    """A damaged log may call a bus what it likes."""
    odd = [replace(loads["veh1"], bus="weh1"), loads["veh2"]]
    figure = next(each for each in Figures(formation, odd).figures if each.id == "busload")
    assert [(curve.name, curve.colour) for curve in figure.curves] == [("weh1", "ink"), ("veh2", colour(2))]
