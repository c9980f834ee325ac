"""The same scenario and seed give the same frames, byte for byte, on every bus and run after run."""

from pathlib import Path
from typing import Any

import pytest

from bench.bus.link.address import Address
from bench.conductor.options import RunOptions
from bench.conductor.run import run
from bench.ecu.loading import DEFAULT_ECUS
from bench.record.compare import diff
from bench.record.reader import Run
from bench.scenario import load

SIMPLE_FILE = Path(__file__).parents[1] / "ecus" / "simple.py"
SIMPLE = {"planner": f"{SIMPLE_FILE}:CruisePlanner", "tracker": f"{SIMPLE_FILE}:SpeedTracker"}


def log(out: Path, can: str, ecus: Any, *overrides: str) -> Path:
    scenario = load("formation", list(overrides))
    result = run(RunOptions(scenario, address=Address.parse(can), out=out, command_line=["test"], ecus=ecus))
    assert result.cycles == scenario.cycles
    assert result.frames_lost == 0
    return result.path


ALL = ("direct", "udp", "direct")


@pytest.mark.parametrize(
    ("ecus", "duration", "others"),
    [
        pytest.param(SIMPLE, 1.0, ALL, id="simple"),
        pytest.param(dict(DEFAULT_ECUS), 0.6, ALL[:1], id="paper"),
        pytest.param(dict(DEFAULT_ECUS), 0.6, ALL, id="paper, again and again", marks=pytest.mark.nightly),
    ],
)
def test_frames_are_the_same_on_every_bus_and_run_after_run(
    tmp_path: Path, ecus: dict[str, str], duration: float, others: tuple[str, ...]
) -> None:
    length = f"duration_s={duration}"
    first = log(tmp_path / "udp.mcap", "udp", ecus, length)
    for number, can in enumerate(others):
        difference = diff(first, log(tmp_path / f"{number}-{can}.mcap", can, ecus, length))
        assert difference.same, f"{number}, {can}: {difference}"
        # 3 vehicles, 12 messages each in every cycle and 11 more at times, 3 on V2V, and BenchSync on four buses.
        assert difference.frames[0] >= 50 * round(duration * 100)


def test_truth_is_the_same_too(tmp_path: Path) -> None:
    paths = [log(tmp_path / f"{can}.mcap", can, SIMPLE, "duration_s=0.5") for can in ("udp", "direct")]
    for vehicle in (1, 2, 3):
        a, b = (Run(path).truth(vehicle) for path in paths)
        assert set(a) == set(b)
        assert {"X", "v_x", "gamma", "steering_angle", "wheel_torque_fl", "lambda_f"} <= set(a)
        for name in a:
            assert a[name].tobytes() == b[name].tobytes(), name


def test_another_scenario_gives_other_frames(tmp_path: Path) -> None:
    same = log(tmp_path / "a.mcap", "direct", SIMPLE, "duration_s=0.2")
    other = log(tmp_path / "b.mcap", "direct", SIMPLE, "duration_s=0.2", "road.lambda_f=1.0", "road.force_y_n=500.0")
    assert not diff(same, other).same
