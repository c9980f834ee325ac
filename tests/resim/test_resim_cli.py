"""The command `platoon resim`, as a person calls it."""

import os
import subprocess
import sys
from pathlib import Path

from tests.reference.__main__ import FOLDER
from tests.resim.conftest import CONTROLLERS, TOLERANCE

FIVE = str(FOLDER / "five.mcap")
STEPS = [text for each in TOLERANCE for text in ("--tolerance", each)]


def resim(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    environment = {**os.environ, "COLUMNS": "200", "NO_COLOR": "1", "PYTHONPATH": str(Path(__file__).parents[2])}
    command = [sys.executable, "-m", "bench.cli", "resim", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False, cwd=cwd, env=environment, timeout=300)


def test_it_ends_with_0_where_all_is_the_same_and_with_1_where_it_is_not(tmp_path):
    same = resim(FIVE, "--ecu", "veh2.tracker", *STEPS, cwd=tmp_path)
    assert same.returncode == 0, same.stdout + same.stderr
    assert "810 frames in 100 cycles" in same.stdout
    changed = resim(FIVE, "--ecu", "veh2.tracker", "--class", f"{CONTROLLERS}:Nudged", "-o", "new.mcap", cwd=tmp_path)
    assert changed.returncode == 1
    assert f"veh2.tracker ran as bench.ecu.tracker:TrackerEcu, and is {CONTROLLERS}:Nudged here" in changed.stderr
    assert "veh2 SteeringCommand.SteeringAngle  from 0.300 s" in changed.stdout
    assert "log: new.mcap" in changed.stdout
    assert (tmp_path / "new.mcap").is_file()


def test_it_ends_with_1_where_the_ecu_never_ran_and_with_2_where_there_is_no_log(tmp_path):
    never = resim(FIVE, "--ecu", "veh9.tracker", cwd=tmp_path)
    assert (never.returncode, never.stdout) == (1, "")
    assert never.stderr.startswith("platoon: veh9.tracker never ran in ")
    (tmp_path / "there.mcap").touch()
    for arguments in (
        ["nowhere.mcap", "--all"],
        [FIVE, "--all", "-o", "there.mcap"],
        [FIVE, "--all", "-o", "new.txt"],
        ["there.mcap", "--all"],
        [FIVE],
    ):
        refused = resim(*arguments, cwd=tmp_path)
        assert (refused.returncode, refused.stdout) == (2, ""), refused.stderr
        assert refused.stderr.count("\n") == 1
