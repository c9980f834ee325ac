"""The command `platoon resim`, as a person calls it."""

import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import pytest

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
    assert "490 frames in 100 cycles" in same.stdout
    changed = resim(FIVE, "--ecu", "veh2.tracker", "--class", f"{CONTROLLERS}:Nudged", "-o", "new.mcap", cwd=tmp_path)
    assert changed.returncode == 1
    assert f"veh2.tracker ran as bench.ecu.tracker:TrackerEcu, and is {CONTROLLERS}:Nudged here" in changed.stderr
    # Another signal may differ too, by the rounding of the processor.
    assert re.search(r"veh2 SteeringCommand\.SteeringAngle +from 0\.300 s", changed.stdout)
    assert "log: new.mcap" in changed.stdout
    assert (tmp_path / "new.mcap").is_file()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_no_process_is_left_when_it_is_ended(number):
    arguments = [FIVE, "--ecu", "veh1.tracker", "--class", f"{CONTROLLERS}:Hanging"]
    command = [sys.executable, "-m", "bench.cli", "resim", *arguments]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=Path(__file__).parents[2]) as process:
        assert process.stdout is not None
        hanging = process.stdout.readline()
        assert hanging.startswith("hangs in "), hanging
        process.send_signal(number)
        # Its output ends with the last process that has it.
        assert process.communicate(timeout=20)[0] == ""
    assert process.returncode == -number


def test_it_ends_with_1_where_the_ecu_never_ran_or_failed_and_with_2_where_there_is_no_log(tmp_path):
    never = resim(FIVE, "--ecu", "veh9.tracker", cwd=tmp_path)
    assert (never.returncode, never.stdout) == (1, "")
    assert never.stderr.startswith("platoon: veh9.tracker never ran in ")
    failing = resim(FIVE, "--ecu", "veh1.tracker", "--class", f"{CONTROLLERS}:Raising", "-o", "new.mcap", cwd=tmp_path)
    assert failing.returncode == 1
    assert "platoon: new.mcap is not written, as veh1.tracker failed" in failing.stderr
    assert not (tmp_path / "new.mcap").exists()
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
