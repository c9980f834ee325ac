"""Reports of several processes through one pipe of the control channel."""

import os
import select
import threading
from array import array

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.bus.control_channel import ControlChannel, Kind, ReportReader, Truth, read_truth
from bench.bus.topic import Topic


@settings(deadline=None)
@given(
    st.lists(st.lists(st.floats(allow_nan=False), max_size=80), min_size=1, max_size=8),
    st.integers(min_value=1, max_value=50),
)
def test_truth_rows_come_out_as_they_went_in_however_the_pipe_cuts_them(rows: list[list[float]], cut: int) -> None:
    reader, writer = os.pipe()
    try:
        channel = ControlChannel(lifeline=-1, reports=writer)
        for cycle, row in enumerate(rows):
            channel.truth(3, cycle, row)
        reports, got = ReportReader(), []
        for _ in range(sum(len(row) * 8 + 12 for row in rows)):
            if not select.select([reader], [], [], 0)[0]:
                break
            got += [read_truth(payload) for kind, payload in reports.feed(os.read(reader, cut)) if kind is Kind.TRUTH]
    finally:
        os.close(reader)
        os.close(writer)
    assert got == [Truth(3, cycle, array("d", row)) for cycle, row in enumerate(rows)]


def test_reports_of_many_do_not_mix() -> None:
    reader, writer = os.pipe()
    channel = ControlChannel(lifeline=-1, reports=writer)

    def write(vehicle: int) -> None:
        for cycle in range(200):
            channel.truth(vehicle, cycle, [float(vehicle)] * 60)

    writers = [threading.Thread(target=write, args=(vehicle,)) for vehicle in (1, 2, 3)]
    for thread in writers:
        thread.start()
    reports, rows = ReportReader(), []
    while len(rows) < 600:
        rows += [read_truth(payload) for _, payload in reports.feed(os.read(reader, 4096))]
    for thread in writers:
        thread.join()
    os.close(reader)
    os.close(writer)
    for vehicle in (1, 2, 3):
        mine = [row for row in rows if row.vehicle == vehicle]
        assert [row.cycle for row in mine] == list(range(200))
        assert {tuple(row.values) for row in mine} == {(float(vehicle),) * 60}


def test_the_inputs_of_sixteen_vehicles_fit() -> None:
    reader, writer = os.pipe()
    inputs = [Topic("v2v", f"{name}_{i}") for i in range(1, 17) for name in ("V2VPosition", "V2VMotion")]
    ControlChannel(lifeline=-1, reports=writer).ready("veh16.planner", inputs)
    os.close(writer)
    ((kind, payload),) = ReportReader().feed(os.read(reader, 65536))
    os.close(reader)
    assert kind is Kind.READY
    assert b"V2VMotion_16" in payload


def test_a_report_that_could_mix_with_others_is_refused() -> None:
    with pytest.raises(ValueError, match="in one piece"):
        ControlChannel(lifeline=-1, reports=-1).truth(1, 0, [0.0] * 1000)
