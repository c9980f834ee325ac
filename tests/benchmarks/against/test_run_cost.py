"""What a run takes is measured from outside; step times of logs with other cycle times are made comparable."""

import math

import numpy as np
import pytest

from bench.benchmarks.against.checkout import Checkout, this_checkout
from bench.benchmarks.against.run_cost import STEPS, Steps, measure
from bench.errors import RunFailed
from bench.scenario import SCENARIO_DIR

FORMATION = SCENARIO_DIR / "formation.toml"


@pytest.fixture(scope="module")
def this():
    return this_checkout(print)


def test_the_largest_step_of_several_cycles_counts_once():
    steps = Steps(np.array([[0.0, 0.0, 5.0, 1.0, 2.0, 9.0], [0.0, 3.0, 1.0, 1.0, 8.0, 1.0]]), cycles=1)
    assert steps.largest_of(1).size == 9
    assert steps.largest_of(2).tolist() == [5.0, 9.0, 3.0, 1.0, 8.0]
    assert steps.largest_of(5).tolist() == [5.0, 8.0]
    assert Steps(np.array([[4.0, 2.0]]), cycles=5).largest_of(5).tolist() == [4.0, 2.0]


@pytest.mark.parametrize("can", ["direct", "udp"])
def test_a_runs_cost_is_whole(can, this, tmp_path):
    # Long enough for samples of the processes on a quick machine, too.
    cost = measure(this, FORMATION, can, 4.0, tmp_path)
    assert cost.simulated_s == 4.0
    assert cost.cpu_s > 0.0
    assert cost.start_s > 0.0
    assert cost.lockstep_s > 0.0
    assert cost.deadlines is None
    for role in STEPS:
        assert (cost.steps[role].largest_of(1) > 0.0).all()
        assert cost.steps[role].times_ms.shape[0] == 3
    kinds = {"conductor", "plant", "veh1.tracker", "veh3.planner"} if can == "udp" else {"conductor"}
    assert kinds <= set(cost.nodes)
    for node in (cost.nodes[kind] for kind in kinds):
        assert node.peak_bytes > 1e6
        assert math.isnan(node.user) or node.user >= 0.0
    # What all processes used while the cycles ran is part of what they used.
    used = sum(node.user + node.system for node in cost.nodes.values() if math.isfinite(node.user))
    assert 0.0 < used * cost.simulated_s < cost.cpu_s
    assert not list(tmp_path.glob("*.mcap"))


def test_a_run_in_real_time_counts_its_deadlines(this, tmp_path):
    deadlines = measure(this, FORMATION, "udp", 0.3, tmp_path, "--clock", "realtime").deadlines
    assert deadlines is not None
    assert 0.0 <= deadlines.missed <= 1.0
    assert deadlines.largest_ms > 0.0


def test_a_run_that_fails_says_why(this, tmp_path):
    with pytest.raises(RunFailed, match=r"of this did not complete(.|\n)*nonsense"):
        measure(this, tmp_path / "nonsense.toml", "direct", 0.2, tmp_path)
    silent = Checkout("other", tmp_path / "python")
    silent.platoon.symlink_to("/bin/true")
    with pytest.raises(RunFailed, match="of other did not complete"):
        measure(silent, FORMATION, "direct", 0.2, tmp_path)
