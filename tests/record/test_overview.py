"""The summary of a log: what processes wrote, and which causes ECUs reported."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import pytest

from bench import events
from bench.bus.codec import Codec
from bench.record.event import Event
from bench.record.overview import Noticed, Output, Overview, overview
from bench.record.reader import Run

from .conftest import open_writer

TRACEBACK = """Traceback (most recent call last):
  File "my_ecu.py", line 3, in control
    gain = 1.0 / gap
           ~~~~^~~~~
ZeroDivisionError: the gap was zero
"""


def summary(folder: Path, codecs: Mapping[str, Codec], told: Sequence[events.Event]) -> Overview:
    with open_writer(folder / "run.mcap", codecs) as writer:
        for number, event in enumerate(told):
            writer.event(number * 500_000_000, event)
    return overview(Run(folder / "run.mcap"))


@pytest.mark.parametrize(
    ("pieces", "shown"),
    [
        ([TRACEBACK], Output("ZeroDivisionError: the gap was zero", 5)),
        (["begun\n", TRACEBACK[:70], TRACEBACK[70:]], Output("ZeroDivisionError: the gap was zero", 6)),
        ([f"{TRACEBACK}\n\n"], Output("ZeroDivisionError: the gap was zero", 5)),
        (
            ["veh1.tracker failed: ValueError: no\n  called in my_ecu.py, line 4\n"],
            Output("veh1.tracker failed: ValueError: no", 2),
        ),
        (["  1\n  2\n"], Output("2", 2)),
        (["one"], Output("one", 1)),
    ],
)
def test_of_a_traceback_the_last_line_is_shown(
    tmp_path: Path, codecs: Mapping[str, Codec], pieces: Sequence[str], shown: Output
) -> None:
    told = [events.ProcessOutput("veh1.tracker", piece) for piece in pieces]
    assert summary(tmp_path, codecs, told).outputs == {"veh1.tracker": shown}


def test_processes_that_wrote_nothing_are_not_listed(tmp_path: Path, codecs: Mapping[str, Codec]) -> None:
    told = [events.ProcessOutput("plant", "\n \n"), events.StrayFrame("veh1", 3)]
    assert summary(tmp_path, codecs, told).outputs == {}


def test_causes_are_listed_with_first_time_and_number_but_for_those_of_the_start(
    tmp_path: Path, codecs: Mapping[str, Codec]
) -> None:
    planner = "veh1.planner"
    told = [
        events.CauseChange("info", planner, "init", "PeerMissing", ""),
        events.StateChange("info", planner, "init", "run", "", "PeerMissing"),
        events.StateChange("warning", planner, "run", "degraded", "SensorLost", ""),
        events.CauseChange("warning", planner, "degraded", "PeerLost", "SensorLost"),
        events.StateChange("warning", planner, "degraded", "safe", "PeerLost", "PeerLost"),
        events.CauseChange("warning", planner, "safe", "SensorLost", "PeerLost"),
        events.StateChange("info", planner, "safe", "run", "", "SensorLost"),
        # A log of an older version does not say what the cause was before.
        events.StateChange("warning", "veh1.tracker", "run", "safe", "ReferenceLost"),
        Event(0.0, "warning", "veh2.planner", "?", "cause_change", {"cause": {"of": "another"}}),
    ]
    assert summary(tmp_path, codecs, told).causes == {
        planner: [Noticed("SensorLost", 1.0, 2), Noticed("PeerLost", 1.5, 1)],
        "veh1.tracker": [Noticed("ReferenceLost", 3.5, 1)],
    }
