"""Today's ECUs send what they sent when the reference logs were made: see tests/reference."""

import pytest

from bench.bus.codec import load_codecs
from bench.record.reader import Run
from bench.resim.text import describe
from tests.reference.__main__ import FOLDER, RUNS
from tests.resim.conftest import rerun

MENDED = "if that is meant: make references"


def test_there_is_a_small_log_of_each_run():
    assert sorted(path.stem for path in FOLDER.glob("*.mcap")) == sorted(RUNS)
    assert max(path.stat().st_size for path in FOLDER.glob("*.mcap")) < 300_000


@pytest.mark.parametrize("name", RUNS)
def test_every_ecu_sends_the_same_again(name):
    log = Run(FOLDER / f"{name}.mcap")
    cycles = int(log.result["cycles"])
    codecs = load_codecs(len(log.scenario.vehicles))
    outcomes = rerun(log.path)
    assert len(outcomes) == 2 * len(log.scenario.vehicles)
    for outcome in outcomes:
        assert outcome.same, f"{describe(outcome, codecs)}\n{MENDED}"
        assert outcome.cycles == cycles
        assert outcome.frames > 2 * cycles
    missed = {outcome.name: cycles - outcome.steps for outcome in outcomes if outcome.steps < cycles}
    # Crashed or stopped for as long.
    assert missed == ({"veh2.tracker": 30, "veh3.planner": 20, "veh1.planner": 20} if name == "faults" else {})
