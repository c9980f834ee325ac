"""Campaigns as a user makes them: the command with real processes, Dask and runs of 0.3 s."""

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import uuid
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import polars as pl
import psutil
import tomli_w

from bench.scenario import load

ROOT = Path(__file__).parents[2]
PLATOON = [sys.executable, "-P", "-c", "from bench.cli.main import main; main()"]
"""As the installed command: it imports nothing from the working directory."""
DASK = [sys.executable, "-P", "-m", "dask"]
GUARD_S = 180.0
MARK = "PLATOON_TEST_MARK"
MACHINES = ["tries", "wall_s", "worker"]
"""Columns that say how a run was made and not what it was."""
WAITING = 2000
"""The first seed of `steered.py` that waits until it may go on."""


class Command:
    """A command in a session of its own. All processes that it starts are known by a variable of their environment."""

    def __init__(self, command: Iterable[str], cwd: Path, **environment: str) -> None:
        self._mark = uuid.uuid4().hex
        # No pipes, which would last as long as any process that has inherited them.
        self._files = ExitStack()
        self._out = self._files.enter_context(tempfile.TemporaryFile("w+"))  # noqa: SIM115 - closed by `end`
        self._said = self._files.enter_context(tempfile.TemporaryFile("w+"))  # noqa: SIM115 - closed by `end`
        # What a command writes is compared; Python's bytecode of an ECU's file is none of it.
        settings = {"COLUMNS": "200", "NO_COLOR": "1", "PYTHONPATH": str(ROOT), "PYTHONDONTWRITEBYTECODE": "1"}
        self.process = subprocess.Popen(
            list(command),
            cwd=cwd,
            env={**os.environ, **settings, MARK: self._mark, **environment},
            stdout=self._out,
            stderr=self._said,
            start_new_session=True,
        )

    @property
    def out(self) -> str:
        return _text_of(self._out)

    @property
    def said(self) -> str:
        return _text_of(self._said)

    def code(self) -> int:
        """Wait for its end, and return its exit code."""
        return self.process.wait(GUARD_S)

    def all(self) -> list[psutil.Process]:
        """Return the processes there are of it."""
        return [each for each in psutil.process_iter() if self._is_of_it(each)]

    def workers(self) -> list[psutil.Process]:
        """Return the processes that are Dask workers, started by the command."""
        words = {each: " ".join(_words_of(each)) for each in self.all()}
        return [each for each, said in words.items() if "spawn_main" in said or said.startswith("dask worker")]

    def _is_of_it(self, process: psutil.Process) -> bool:
        """Dask's workers write their name over their environment, and processes of runs have sessions of their own."""
        try:
            if process.status() == psutil.STATUS_ZOMBIE:
                return False
            return os.getsid(process.pid) == self.process.pid or process.environ().get(MARK) == self._mark
        except (psutil.Error, OSError):
            return False

    def end(self) -> None:
        for each in self.all():
            each.kill()
        self.process.wait(GUARD_S)
        self._files.close()


@contextmanager
def commands(folder: Path) -> Iterator[Callable[..., Command]]:
    """Yield a function that starts a command, by default in this folder; what is left of them at the end is ended."""
    started: list[Command] = []

    def start(words: Iterable[str], cwd: Path = folder, **environment: str) -> Command:
        started.append(Command(words, cwd, **environment))
        return started[-1]

    try:
        yield start
    finally:
        for command in started:
            command.end()


def _text_of(file) -> str:
    return Path(f"/proc/self/fd/{file.fileno()}").read_text(encoding="utf-8")


def _words_of(process: psutil.Process) -> list[str]:
    try:
        return process.cmdline()
    except psutil.Error:
        return []


def until(condition: Callable[[], object], what: str) -> None:
    """Wait for a condition."""
    end = time.monotonic() + GUARD_S
    while not condition():
        assert time.monotonic() < end, f"waited for: {what}"
        time.sleep(0.02)


def write_study(folder: Path, seeds: Iterable[int], **keys: object) -> Path:
    """Write a study of one run for each seed, and what it needs, into a folder; return its file."""
    folder.mkdir(exist_ok=True)
    (folder / "base.toml").write_text(load("formation", ["duration_s=0.3"]).toml(), encoding="utf-8")
    shutil.copy(Path(__file__).with_name("steered.py"), folder)
    study = {
        "base": "base.toml",
        "sampling": "grid",
        "requirements": ["final_speed_error_mps < 3", "frames_lost == 0"],
        "ecus": {"tracker": "steered.py:Steered"},
        "inputs": [{"key": "seed", "distribution": {"kind": "choice", "values": list(seeds)}}],
    }
    file = folder / "study.toml"
    file.write_text(tomli_w.dumps(study | keys), encoding="utf-8")
    return file


def makings(folder: Path) -> dict[int, list[int]]:
    """Return of each seed the processes that began its run, from the notes of `steered.py`."""
    found: dict[int, list[int]] = {}
    notes = folder / "makings"
    for line in notes.read_text().splitlines() if notes.exists() else ():
        seed, pid = map(int, line.split())
        found.setdefault(seed, []).append(pid)
    return found


def parts(folder: Path) -> pl.DataFrame:
    """Return the rows that a campaign has written so far."""
    files = sorted((folder / "parts").glob("[!.]*.parquet"))
    return pl.read_parquet(files).sort("number") if files else pl.DataFrame({"number": []})


def table(folder: Path) -> pl.DataFrame:
    """Return the rows of a finished campaign, without what differs from one time to the next."""
    return pl.read_parquet(folder / "runs.parquet").drop(MACHINES)


def logs(folder: Path) -> set[int]:
    """Return the numbers of the runs whose log is there, each with its scenario and nothing else beside it."""
    names = {path.name for path in (folder / "logs").iterdir()}
    numbers = {int(name[4:10]) for name in names}
    assert names == {f"run-{number:06d}.{suffix}" for number in numbers for suffix in ("mcap", "toml")}
    return numbers


def interrupt(command: Command) -> None:
    """Press Ctrl-C: the terminal sends the signal to all processes of its group."""
    os.killpg(command.process.pid, signal.SIGINT)
