"""A real run's log, and real runs that are watched."""

import json
import re
import subprocess
import sys
import urllib.request
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from bench.bus.link.address import Address
from bench.conductor.options import RunOptions
from bench.conductor.run import run
from bench.scenario import load

ROOT = Path(__file__).parents[2]
SIMPLE = {
    "planner": f"{ROOT}/tests/ecus/simple.py:CruisePlanner",
    "tracker": f"{ROOT}/tests/ecus/simple.py:SpeedTracker",
}


@pytest.fixture(scope="session")
def whole_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The log of a real run of three vehicles, 4 s, all in one process."""
    path = tmp_path_factory.mktemp("live") / "run.mcap"
    run(
        RunOptions(
            load("formation", ["duration_s=4.0"]),
            address=Address.parse("direct"),
            out=path,
            command_line=[],
            ecus=SIMPLE,
        )
    )
    return path


GUARD_S = 120.0
"""Ends a test that hangs; nothing is said of how fast things must be."""

ECUS = [option for role, spec in SIMPLE.items() for option in ("--ecu", f"{role}={spec}")]


@dataclass
class Bench:
    """A run that is watched."""

    process: subprocess.Popen[str]
    out: Path
    page: str
    foxglove_port: int

    def end(self) -> tuple[int, str]:
        """Wait for its end; exit code and standard error."""
        _, errors = self.process.communicate(timeout=GUARD_S)
        return self.process.returncode, errors

    @property
    def server(self) -> int:
        """Process number of the live server."""
        children = Path(f"/proc/{self.process.pid}/task/{self.process.pid}/children").read_text().split()
        (server,) = (pid for pid in children if b"bench.live.process" in Path(f"/proc/{pid}/cmdline").read_bytes())
        return int(server)

    def html(self) -> str:
        """The page, once there is one."""
        while True:
            with urllib.request.urlopen(self.page, timeout=GUARD_S) as answer:
                text = answer.read().decode()
            if "Waiting for the run" not in text:
                return text

    @property
    def feed(self) -> str:
        """Address of the feed."""
        return self.page.replace("http:", "ws:") + "feed"

    def told(self, at_most: int = sys.maxsize) -> Iterator[dict]:
        """What the feed tells a viewer, to its end."""
        with connect(self.feed, max_size=None) as viewer:
            try:
                for _ in range(at_most):
                    yield json.loads(viewer.recv(timeout=GUARD_S))
            except ConnectionClosed:
                return


def served_by(process: subprocess.Popen[str]) -> tuple[str, int]:
    """URL of the page that a process says it serves, and the port for Foxglove."""
    assert process.stdout is not None
    line = process.stdout.readline()
    found = re.fullmatch(r"live: (http://127\.0\.0\.1:\d+/)  foxglove: ws://127\.0\.0\.1:(\d+)\n", line)
    assert found, line
    return found[1], int(found[2])


Start = Callable[..., Bench]


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Start]:
    """`start("--can", "udp", duration=5)`: a run with --live."""
    benches = []

    def begin(*options: str, duration: float = 5.0) -> Bench:
        out = tmp_path / f"run{len(benches)}.mcap"
        command = [sys.executable, "-m", "bench.cli", "run", "formation", "--set", f"duration_s={duration}", *ECUS]
        process = subprocess.Popen(
            [*command, "--no-report", "--out", str(out), "--live", *options],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        benches.append(Bench(process, out, *served_by(process)))
        return benches[-1]

    yield begin
    for bench in benches:
        bench.process.kill()
        bench.process.communicate()
