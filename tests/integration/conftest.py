"""Runs in processes of their own, under watch: whatever a test does to them, nothing of them is left behind."""

import json
import os
import signal
import subprocess
import sys
import time
import uuid
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from bench.conductor.fork_server import THREADS

ROOT = Path(__file__).parents[2]
ECUS = ROOT / "tests" / "ecus"
SIMPLE = {"planner": f"{ECUS}/simple.py:CruisePlanner", "tracker": f"{ECUS}/simple.py:SpeedTracker"}

GUARD_S = 60.0
"""Ends a test that hangs; nothing is said of how fast things must be."""

_MARK = "PLATOON_TEST_RUN"


def wait_until(happened: Callable[[], bool], what: str) -> None:
    """Wait for what must happen soon."""
    end = time.monotonic() + GUARD_S
    while not happened():
        if time.monotonic() > end:
            pytest.fail(f"waited {GUARD_S:g} s in vain: {what}")
        time.sleep(0.01)


class Watched:
    """A run in a process group of its own. All its processes carry a mark in their environment."""

    def __init__(self, folder: Path, **given: object) -> None:
        self.out = folder / "run.mcap"
        self.temporary = folder / "tmp"
        self.temporary.mkdir()
        self._mark = uuid.uuid4().hex
        settings = {
            "can": "udp",
            "set": [],
            "ecus": SIMPLE,
            "silence_s": GUARD_S,
            "without": [],
            "without_wait_s": GUARD_S,
            "file_limit": 0,
            "realtime": False,
            "ready_s": GUARD_S,
            "out": str(self.out),
        } | given
        paths = [str(ROOT), os.environ.get("PYTHONPATH", "")]
        self.process = subprocess.Popen(
            [sys.executable, str(Path(__file__).with_name("runner.py")), json.dumps(settings)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
            env=os.environ
            | THREADS
            | {_MARK: self._mark, "TMPDIR": str(self.temporary), "PYTHONPATH": os.pathsep.join(filter(None, paths))},
        )

    def await_time(self, t: float) -> None:
        """Wait until the run has come to the simulated time `t` in s."""
        assert self.process.stdout is not None
        for line in self.process.stdout:
            if line.startswith("at ") and float(line.split()[1]) >= t:
                return
        pytest.fail(f"the run ended before t = {t}: {self.process.communicate(timeout=GUARD_S)}")

    def end(self) -> tuple[int, str, str]:
        """Wait for its end; exit code, standard output and standard error."""
        output, errors = self.process.communicate(timeout=GUARD_S)
        return self.process.returncode, output, errors

    def processes(self) -> dict[str, int]:
        """Name and process number of all that is alive of the run, wherever it hangs in the tree."""
        mark = f"{_MARK}={self._mark}".encode()
        found = {}
        for folder in Path("/proc").iterdir():
            try:
                if folder.name.isdigit() and mark in (folder / "environ").read_bytes().split(b"\0"):
                    found[(folder / "comm").read_text().strip()] = int(folder.name)
            except OSError:
                continue
        return found

    def children(self, word: str) -> list[int]:
        """Process numbers of the run's own children whose name is `word`."""
        try:
            found = Path(f"/proc/{self.process.pid}/task/{self.process.pid}/children").read_text().split()
            return [int(pid) for pid in found if Path(f"/proc/{pid}/comm").read_text().strip() == word]
        except OSError:
            return []

    def pid_of(self, name: str) -> int:
        """Process number of the process of that name."""
        return self.processes()[name]

    def assert_all_gone(self) -> None:
        """Nothing of the run is left: no process, no temporary file."""
        wait_until(lambda: not self.processes(), "all processes of the run to be gone")
        assert list(self.temporary.iterdir()) == []

    def clean_up(self) -> None:
        """Kill by number what is left."""
        for pid in self.processes().values():
            os.kill(pid, signal.SIGKILL)
        self.process.communicate()


Starter = Callable[..., Watched]


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Starter]:
    """Start a run in processes: `start(can=..., set=[...], ecus={...}, silence_s=...)`."""
    runs: list[Watched] = []

    def begin(**given: object) -> Watched:
        folder = tmp_path / f"run{len(runs)}"
        folder.mkdir()
        runs.append(Watched(folder, **given))
        return runs[-1]

    yield begin
    for run in runs:
        run.clean_up()


@pytest.fixture
def unruly() -> Callable[..., dict[str, str]]:
    """The simple ECUs, with unruly ones in the place of some: `unruly(tracker="HangingTracker")`."""

    def choose(**classes: str) -> dict[str, str]:
        return SIMPLE | {role: f"{ECUS}/unruly.py:{name}" for role, name in classes.items()}

    return choose
