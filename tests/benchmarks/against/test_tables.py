"""Ratios are of pairs, and compare like with like."""

import math

import numpy as np
import pytest

from bench.benchmarks.against.checkout import Checkout
from bench.benchmarks.against.comparison import BUSES, Costs
from bench.benchmarks.against.profile import OTHER, PARTS
from bench.benchmarks.against.run_cost import Deadlines, NodeCost, RunCost, Steps
from bench.benchmarks.against.tables import Row, deadlines, memory, nodes, parts, times


def cost(simulated_s, cpu_s, cycles=1, factor=1.0, names=("conductor", "veh1.tracker", "veh2.tracker")):
    steps = Steps(factor * np.tile(np.arange(1.0, 11.0), (2, 1))[:, cycles - 1 :: cycles], cycles)
    use = {name: NodeCost(0.1 * factor, 0.2 * factor, 1e6 * (n + 1), 5e5) for n, name in enumerate(names)}
    return RunCost(
        simulated_s=simulated_s,
        cpu_s=cpu_s,
        start_s=2.0,
        lockstep_s=simulated_s * factor,
        recorder_s=math.nan,
        steps={"tracker": steps, "planner": steps},
        nodes=use,
        deadlines=None,
    )


@pytest.fixture
def costs(tmp_path):
    other, this = (Costs(Checkout(name, tmp_path)) for name in ("other", "this"))
    for bus in BUSES:
        other.short[bus] = [cost(0.1, 2.0), cost(0.1, 3.0)]
        other.long[bus] = [cost(10.1, 22.0), cost(10.1, 33.0)]
        this.short[bus] = [cost(0.1, 1.0), cost(0.1, 1.0)]
        this.long[bus] = [cost(10.1, 6.0, 5, 0.5, ("conductor", "veh1.own")) for _ in range(2)]
    return other, this


def rows(sections):
    return {row.title.strip(): row for section in sections for row in section}


def test_ratios_are_of_pairs():
    row = Row("what", np.array([1.0, 2.0, 4.0]), np.array([2.0, math.nan, 2.0]))
    assert row.ratios.tolist() == [2.0, 0.5]
    assert row.cells() == ["what", "2", "2", "1.25", "0.5 .. 2"]
    nothing = np.array([math.nan])
    assert Row("what", nothing, nothing).cells() == ["what", "-", "-", "-", "-"]
    assert Row("what", np.zeros(1), np.ones(1)).cells() == ["what", "0", "1", "-", "-"]


def test_start_and_end_are_separated_from_the_rest(costs):
    found = rows(times(*costs))
    assert found["processor time of a simulated second, udp, s"].other == pytest.approx([22.0 / 10.1, 33.0 / 10.1])
    assert found["without start and end"].other == pytest.approx([2.0, 3.0])
    assert found["without start and end"].this == pytest.approx([0.5, 0.5])
    assert found["of start and end (a run of 0.1 s)"].ratios == pytest.approx([1 / 2, 1 / 3])
    assert found["real-time factor in lockstep, direct"].ratios == pytest.approx([2.0, 2.0])
    assert found["recording, of that, udp"].cells()[1:] == ["-"] * 4


def test_steps_are_compared_with_the_largest_of_as_many_cycles(costs):
    row = rows(times(*costs))["tracker's whole step, largest of 5 cycles, p50, direct, ms"]
    # The largest of 1..5 and of 6..10.
    assert row.other.tolist() == [7.5, 7.5]
    assert row.this.tolist() == [3.75, 3.75]


def test_steps_of_equal_periods_are_compared_as_they_are(costs):
    other, _ = costs
    assert rows(times(other, other))["tracker's whole step, p50, direct, ms"].this.tolist() == [5.5, 5.5]


def test_memory_is_of_the_largest_process_of_a_kind(costs):
    found = rows(memory(*costs))
    assert found["tracker, peak resident"].other.tolist() == [3.0, 3.0]
    assert np.isnan(found["tracker, peak resident"].this).all()
    assert found["own, peak resident"].this.tolist() == [2.0, 2.0]


def test_processor_time_of_nodes_is_of_all_of_a_kind(costs):
    found = rows(nodes(*costs))
    assert found["tracker, user"].other == pytest.approx([2.0, 2.0])
    assert found["tracker, system"].other == pytest.approx([4.0, 4.0])
    assert found["all"].other == pytest.approx([9.0, 9.0])
    assert found["all"].this == pytest.approx([3.0, 3.0])


def test_parts_add_up_to_the_whole(costs):
    share = dict.fromkeys([*(name for name, _ in PARTS), OTHER], 0.0) | {"codec": 0.25, "plant": 0.75}
    found = rows(parts(*costs, [share, share]))
    assert found["codec"].other == pytest.approx([0.25 * 25.0])
    assert found["plant"].this == pytest.approx([0.75 * 5.0])
    assert found["all"].ratios == pytest.approx([0.2])


def test_a_run_in_real_time_that_failed_has_its_reason_in_the_table():
    ran = cost(1.0, 1.0)
    kept = RunCost(**{**vars(ran), "deadlines": Deadlines(0.25, 12.0)})
    table = deadlines("title", {"other": "it failed:\nthe plant met no deadline", "this": kept})
    cells = [list(column.cells) for column in table.columns]
    assert cells[0] == ["other", "this"]
    assert cells[1] == ["the plant met no deadline", "25.0000 %"]
    assert cells[2] == ["-", "12.00 ms"]
