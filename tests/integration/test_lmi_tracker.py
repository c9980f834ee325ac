"""A second of the formation with the robust MPC as the paper writes it, in cvxpy, beside the built-in one."""

from pathlib import Path

import numpy as np
import pytest

from bench.bus.link.address import Address
from bench.bus.states import EcuState
from bench.conductor.options import RunOptions
from bench.conductor.run import run
from bench.control.outcome import GainSource, SolverStatus
from bench.ecu.loading import DEFAULT_ECUS
from bench.record.compare import diff
from bench.record.reader import Run
from bench.scenario import load

EXAMPLE = Path(__file__).parents[2] / "bench" / "examples" / "lmi_tracker.py"
LMI = {**DEFAULT_ECUS, "tracker": f"{EXAMPLE}:LmiTracker"}


def log(out: Path, ecus: dict[str, str], *overrides: str, can: str = "direct") -> Path:
    scenario = load("formation", ["duration_s=1.0", *overrides])
    return run(RunOptions(scenario, address=Address.parse(can), out=out, command_line=["test"], ecus=ecus)).path


@pytest.fixture(scope="module")
def direct(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return log(tmp_path_factory.mktemp("direct") / "run.mcap", LMI)


def test_it_sends_the_same_bytes_over_udp(direct: Path, tmp_path: Path) -> None:
    difference = diff(direct, log(tmp_path / "run.mcap", LMI, can="udp"))
    assert difference.same, str(difference)


def test_its_diagnostics_are_those_of_a_tracker_whose_every_step_is_solved(direct: Path, tmp_path: Path) -> None:
    accurate = log(tmp_path / "run.mcap", dict(DEFAULT_ECUS), "tracker.solver_tolerance=1e-7")
    recorded, built_in = Run(direct), Run(accurate)
    assert recorded.messages("veh1") == built_in.messages("veh1")
    for bus in ("veh1", "veh2", "veh3"):
        for signal, value in (("SolverStatus", SolverStatus.SOLVED), ("GainSource", GainSource.SDP)):
            assert set(recorded.signal(bus, "TrackerStatus", signal)[1][1:]) == {value}
        assert set(recorded.signal(bus, "TrackerStatus", "State")[1][1:]) == {EcuState.RUN}
        assert recorded.signal(bus, "TrackerStatus", "Iterations")[1][1:].min() > 5
        # The same optimum at each step, and so the same drive.
        tau, other = (each.signal(bus, "TrackerStatus", "Tau")[1][1:] for each in (recorded, built_in))
        ratio = other / tau
        assert np.median(ratio) == pytest.approx(1.0, abs=2e-3)
        assert np.quantile(ratio, [0.1, 0.9]) == pytest.approx([1.0, 1.0], abs=0.01)
        steering = [each.signal(bus, "SteeringCommand", "SteeringAngle")[1] for each in (recorded, built_in)]
        np.testing.assert_allclose(*steering, atol=5e-3)


MINE = """
from bench.examples.lmi_tracker import LmiTracker, RobustMpc

class Mine(RobustMpc):
    def matrix_inequalities(self):
        return [*super().matrix_inequalities(), self.tau <= 0.0]

class Tracker(LmiTracker):
    @classmethod
    def solvers(cls, settings):
        return [Mine(settings.input_weight, independent=settings.independent_axles)]
"""


def test_an_inequality_of_ones_own_that_cannot_be_met_is_on_the_bus_and_the_run_goes_on(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(MINE)
    ecus = {**DEFAULT_ECUS, "tracker": f"{tmp_path}/mine.py:Tracker"}
    recorded = Run(log(tmp_path / "run.mcap", ecus, "duration_s=0.2"))
    told = set(recorded.signal("veh1", "TrackerStatus", "SolverStatus")[1][2:])
    # Near the edge of what it can tell, the solver gives up in a few steps.
    assert SolverStatus.INFEASIBLE in told
    assert told <= {SolverStatus.INFEASIBLE, SolverStatus.NUMERICAL_ERROR}
    assert set(recorded.signal("veh1", "TrackerStatus", "GainSource")[1][2:]) == {GainSource.LQR}
    assert set(recorded.signal("veh1", "TrackerStatus", "State")[1][2:]) == {EcuState.DEGRADED}
