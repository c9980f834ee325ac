"""Response times, jitter and missed deadlines of a made-up real-time log whose times are known."""

from pathlib import Path

import pytest

from bench.analysis.timing import LONGEST_MS, histograms, timing
from bench.bus.codec import load_codecs
from bench.bus.states import BenchCommand
from bench.bus.sync import BENCH_SYNC
from bench.cycle import CYCLE_NS
from bench.errors import BadInput
from bench.record import LogDamaged, Run, RunWriter
from tests.record.damage import with_bad_dbc

CODECS = load_codecs(1)
START_NS = 1_700_000_000_000_000_000
CYCLES = 8
CLOCK_LATE_NS = {3: 400_000}
"""BenchSync of this cycle came late by as much."""

COMMANDS_MS = {0: 4.0, 1: 5.0, 2: 10.2, 3: 4.5, 4: None, 5: None, 6: 4.0, 7: 25.0}
"""When the tracker's last command of each cycle came, from the cycle's nominal begin."""


@pytest.fixture
def log(tmp_path: Path) -> Run:
    return write(tmp_path / "run.mcap", "realtime")


def write(path: Path, clock: str, stop_cycle: int = CYCLES) -> Run:
    codec = CODECS["veh1"]
    writer = RunWriter(
        path,
        codecs=CODECS,
        truth_names=("X", "Y", "psi", "phi"),
        vehicles=1,
        metadata={"clock": clock, "vehicles": "1"},
        attachments={},
    )

    def frame(message: str, cycle: int, at_ns: int, **values: float) -> None:
        can_id, data = codec.encode(message, codec.start_values(message) | values, cycle)
        writer.frame("veh1", cycle * CYCLE_NS, can_id, data, START_NS + cycle * CYCLE_NS + at_ns)

    for cycle in range(CYCLES):
        frame(BENCH_SYNC, cycle, CLOCK_LATE_NS.get(cycle, 0), Command=BenchCommand.RUN_REALTIME, Cycle=cycle)
        at_ms = COMMANDS_MS[cycle]
        if at_ms is not None:
            frame("SteeringCommand", cycle, round((at_ms - 0.5) * 1e6))
            frame("TorqueCommandFront", cycle, round((at_ms - 0.2) * 1e6))
            frame("TorqueCommandRear", cycle, round(at_ms * 1e6))
            # What has no alive counter drives nothing, so it has no deadline.
            frame("TrackerTiming", cycle, round((at_ms + 3.0) * 1e6))
    frame(BENCH_SYNC, stop_cycle, 20_000_000, Command=BenchCommand.STOP, Cycle=CYCLES)
    writer.close({"status": "completed"})
    return Run(path)


def test_response_times_and_misses(log: Run) -> None:
    times = timing(log)
    assert times is not None
    assert times.cycles == CYCLES
    tracker = next(node for node in times.nodes if node.name == "veh1.tracker")
    # Cycle 2 is later than its nominal end, but not than the BenchSync that ended it; cycle 7 has a nominal end only.
    assert (tracker.cycles, tracker.late, tracker.missing, tracker.longest_miss) == (CYCLES, 1, 2, 2)
    assert tracker.response_ms == pytest.approx([4.0, 5.0, 10.2, 4.5 - 0.4, 4.0, 25.0])
    assert tracker.jitter_ms == pytest.approx(21.0)
    assert tracker.miss_rate == pytest.approx(3 / 8)


def test_who_sends_nothing_misses_all(log: Run) -> None:
    times = timing(log)
    assert times is not None
    for name in ("veh1.plant", "veh1.planner"):
        node = next(node for node in times.nodes if node.name == name)
        assert (node.cycles, node.missing, node.longest_miss, node.jitter_ms) == (CYCLES, CYCLES, CYCLES, 0.0)
    # The share is of the ECUs' deadlines: the plant is no ECU.
    assert times.miss_rate == pytest.approx((3 + CYCLES) / (2 * CYCLES))


def test_how_late_the_clock_was(log: Run) -> None:
    times = timing(log)
    assert times is not None
    assert times.clock_late_ms == pytest.approx([CLOCK_LATE_NS.get(cycle, 0) / 1e6 for cycle in range(CYCLES)])


def test_histograms_hold_every_response_and_the_longest_in_their_last_bin(log: Run) -> None:
    times = timing(log)
    assert times is not None
    page = histograms(times)
    assert page["edges_ms"][-1] == LONGEST_MS
    assert sum(page["clock"]["counts"]) == CYCLES
    assert page["clock"]["max_ms"] == pytest.approx(0.4)
    tracker = next(node for node in page["nodes"] if node["name"] == "veh1.tracker")
    assert len(tracker["counts"]) == len(page["edges_ms"]) - 1
    assert sum(tracker["counts"]) == 6
    assert tracker["counts"][-1] == 1
    assert tracker["response_ms"]["max"] == pytest.approx(25.0)
    assert next(node for node in page["nodes"] if node["name"] == "veh1.planner")["response_ms"] == {}


def test_in_lockstep_the_wall_clock_means_nothing(tmp_path: Path) -> None:
    assert timing(write(tmp_path / "lockstep.mcap", "lockstep")) is None


def test_times_that_cannot_be_are_refused(tmp_path: Path) -> None:
    """Of a damaged log: there is no table as long as its last time says."""
    with pytest.raises(BadInput, match="impossible times"):
        timing(write(tmp_path / "run.mcap", "realtime", stop_cycle=700_000_000_000))


def test_without_a_dbc_file_that_can_be_read_there_are_no_times(log: Run, tmp_path: Path) -> None:
    bad = Run(with_bad_dbc(log.path, tmp_path / "bad.mcap"))
    with pytest.warns(LogDamaged, match=r"bad\.mcap.*vehicle\.dbc"):
        assert timing(bad) is None
