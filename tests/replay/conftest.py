"""A short run with simple ECUs, to be replayed."""

from pathlib import Path

import pytest

from bench.bus.link.address import Address
from bench.conductor.options import RunOptions
from bench.conductor.run import run
from bench.record import Run
from bench.scenario import load

SIMPLE = Path(__file__).parents[1] / "ecus" / "simple.py"
ECUS = {"planner": f"{SIMPLE}:CruisePlanner", "tracker": f"{SIMPLE}:SpeedTracker"}


@pytest.fixture(scope="session")
def recorded(tmp_path_factory):
    path = tmp_path_factory.mktemp("replay") / "run.mcap"
    scenario = load("formation", ["duration_s=0.4"])
    return Run(
        run(RunOptions(scenario, address=Address.parse("direct"), out=path, command_line=["test"], ecus=ECUS)).path
    )
