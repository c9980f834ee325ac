"""Logs of earlier versions, in whose scenarios and events faults have other names, open as any log does."""

from pathlib import Path
from types import SimpleNamespace

import pytest

from bench.analysis.metrics import compute
from bench.analysis.report import render
from bench.bus.link.address import Address
from bench.conductor.options import RunOptions
from bench.conductor.run import run
from bench.events import FaultRequested
from bench.faults.former import renewed
from bench.faults.vehicles import AxleSoftening
from bench.record.event import Event
from bench.record.reader import Run
from bench.resim.history import read_history
from bench.scenario import Scenario, load
from tests.resim.conftest import rerun

SIMPLE_FILE = Path(__file__).parents[1] / "ecus" / "simple.py"
SIMPLE = {"planner": f"{SIMPLE_FILE}:CruisePlanner", "tracker": f"{SIMPLE_FILE}:SpeedTracker"}
FORMER = {"kind": "tyre_blowout", "at_s": 0.02, "vehicle": 1, "axle": "rear", "lambda_level": -0.5}
SOFTENING = AxleSoftening(at_s=0.02, vehicle=1, axle="rear", lambda_level=-0.5)


@pytest.fixture
def former_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Run:
    """A log whose attached scenario has the fault as an earlier version wrote it."""
    soft = '{kind = "axle_softening", at_s = 0.02, vehicle = 1, axle = "rear", lambda_level = -0.5}'
    scenario = load("formation", ["duration_s=0.1", f"faults=[{soft}]"])
    text = scenario.toml().replace("axle_softening", "tyre_blowout")
    monkeypatch.setattr(Scenario, "toml", lambda _: text)
    out = tmp_path / "former.mcap"
    return Run(run(RunOptions(scenario, Address.parse("direct"), out, ["test"], SIMPLE)).path)


def test_what_an_earlier_version_called_a_blowout_of_an_axle_is_its_softening(former_log: Run) -> None:
    assert 'kind = "tyre_blowout"' in former_log.scenario_text
    assert former_log.scenario.faults == (SOFTENING,)
    assert compute(former_log).least_distance_m > 4.0
    assert render(former_log)
    (outcome,) = rerun(former_log.path, "veh1.planner", tolerances=(), classes=[f"planner={SIMPLE['planner']}"])
    assert outcome.same, outcome.error


def test_so_it_is_where_it_was_typed_into_a_running_bench() -> None:
    asked = FaultRequested(FORMER)
    event = Event(0.02, asked.level, asked.source, asked.text, asked.kind, asked.fields)
    log = SimpleNamespace(scenario=load("formation"), events=[event])
    assert read_history(log).faults == (SOFTENING,)  # type: ignore[arg-type] - it is asked for no more than this


@pytest.mark.parametrize("fault", [{"kind": "tyre_blowout", "wheel": "fl"}, {"kind": "ice_patch"}, {}])
def test_what_has_kept_its_name_stays_as_it_is(fault: dict[str, str]) -> None:
    assert renewed(fault) == fault
