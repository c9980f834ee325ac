"""Files that several processes write at once: each is whole, and one that was to be new is written once."""

import multiprocessing
import os
import subprocess
import sys
import time
from multiprocessing.synchronize import Barrier
from pathlib import Path

import pytest

from bench.errors import BadInput
from bench.files import write_text, written_aside
from bench.record.reader import Run

ROOT = Path(__file__).parents[1]
REFERENCE = ROOT / "tests" / "reference" / "formation.mcap"
WRITERS = 8
SCRIPT = "from bench.cli.main import main; main()"


def _write(target: Path, number: int, barrier: Barrier, *, new: bool) -> None:
    barrier.wait()
    try:
        write_text(target, f"{number}\n" * 20_000, new=new)
    except BadInput:
        os._exit(2)


@pytest.mark.parametrize("new", [True, False], ids=["new", "replaced"])
def test_of_several_at_once_the_file_is_of_one(new: bool, tmp_path: Path) -> None:
    context = multiprocessing.get_context("fork")
    for attempt in range(5):
        target, barrier = tmp_path / f"{attempt}.txt", context.Barrier(WRITERS)
        processes = [
            context.Process(target=_write, args=(target, number, barrier), kwargs={"new": new})
            for number in range(WRITERS)
        ]
        for process in processes:
            process.start()
        for process in processes:
            process.join()
        codes = [process.exitcode for process in processes]
        assert sorted(codes) == [0, *[2 if new else 0] * (WRITERS - 1)]
        lines = target.read_text().splitlines()
        assert len(lines) == 20_000
        (number,) = set(lines)
        assert not new or codes.index(0) == int(number)
    assert len(list(tmp_path.iterdir())) == 5


def test_a_file_that_appeared_meanwhile_is_kept(tmp_path: Path) -> None:
    target = tmp_path / "log.mcap"
    writing = written_aside(target, new=True, option="--out")
    writing.__enter__().write_text("mine")
    target.write_text("theirs")
    with pytest.raises(BadInput, match=r"log\.mcap already exists; give another --out, or remove it"):
        writing.__exit__(None, None, None)
    assert target.read_text() == "theirs"
    assert list(tmp_path.iterdir()) == [target]


def platoon(*arguments: str, cwd: Path) -> subprocess.Popen[str]:
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    return subprocess.Popen([sys.executable, "-P", "-c", SCRIPT, *arguments], cwd=cwd, text=True, **pipes)


def both(*arguments: str, cwd: Path) -> list[tuple[int, str]]:
    """Run a command twice at once; exit code and standard error of both, the successful one first."""
    started = [platoon(*arguments, cwd=cwd) for _ in range(2)]
    ended = [(process.communicate(timeout=300)[1], process.returncode) for process in started]
    return sorted((code, errors) for errors, code in ended)


@pytest.mark.parametrize(
    "arguments",
    [
        f"log export {REFERENCE} --format candump -o new.log",
        f"log export {REFERENCE} --events -o new.csv",
        f"log export {REFERENCE} --events -o new.parquet",
        f"log export {REFERENCE} --events -o new.json",
        f"log recover {REFERENCE} -o new.mcap",
        "log import frames.log -o new.mcap",
    ],
)
def test_a_command_that_is_started_twice_writes_its_file_once(arguments: str, tmp_path: Path) -> None:
    (tmp_path / "frames.log").write_text("(0.010000) veh1 010#0011223344556677\n" * 2000)
    (code, errors), (other, refused) = both(*arguments.split(), cwd=tmp_path)
    assert (code, other) == (0, 2), errors + refused
    assert "already exists; give another -o, or remove it" in refused
    assert len(list(tmp_path.iterdir())) == 2


def test_two_runs_on_the_same_log_end_well(tmp_path: Path) -> None:
    for number, can in enumerate(("direct", "udp")):
        out = f"{number}.mcap"
        run = ["run", "formation", "--can", can, "--set", "duration_s=0.3", "--out", out]
        (code, errors), (other, refused) = both(*run, cwd=tmp_path)
        assert (code, other) == (1, 2), errors + refused
        assert "formation did not form a platoon in 0.3 s" in errors
        assert f"{out} already exists; give another --out, or remove it" in refused
        assert "Traceback" not in refused
        recorded = Run(tmp_path / out)
        assert recorded.metadata["status"] == "completed"
        assert len(recorded.signal("veh1", "BenchSync", "Cycle")[1]) >= 30
        assert "</html>" in (tmp_path / f"{number}.html").read_text()[-20:]
    assert len(list(tmp_path.iterdir())) == 4


def test_a_run_finds_its_log_created_while_it_started(tmp_path: Path) -> None:
    slow = "import pathlib, time\nfrom bench.ecu import *\npathlib.Path('loading').touch()\ntime.sleep(1)\n"
    slow += "class Mine(TrackerBase):\n    def control(self, motion, reference): return Command()\n"
    (tmp_path / "slow.py").write_text(slow)
    run = ["run", "--can", "udp", "--ecu=tracker=slow.py:Mine", "--out", "x.mcap", "--set", "duration_s=0.1"]
    process = platoon(*run, cwd=tmp_path)
    # Its first check is over once it loads the ECU.
    while not (tmp_path / "loading").exists():
        assert process.poll() is None
        time.sleep(0.01)
    (tmp_path / "x.mcap").write_text("theirs")
    errors = process.communicate(timeout=300)[1]
    assert process.returncode == 2
    assert "x.mcap already exists; give another" in errors
    assert (tmp_path / "x.mcap").read_text() == "theirs"
    assert not (tmp_path / "x.html").exists()
