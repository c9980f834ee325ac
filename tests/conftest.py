"""What all tests share: how much one of them tries, and what is made once for all workers of pytest-xdist."""

from __future__ import annotations

import fcntl
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from bench.compiled.build import compile_modules
from bench.compiled.finder import install, is_wanted

if is_wanted():
    compile_modules()
    install()

Tries = Callable[[Any, Any], Any]
Once = Callable[[str, Callable[[Path], object]], Path]


@pytest.fixture(
    params=[pytest.param(False, id="sample"), pytest.param(True, id="all", marks=pytest.mark.nightly)],
)
def tries(request: pytest.FixtureRequest) -> Tries:
    """How much to try: `tries(40, 150)` is 40 in `make test` and 150 in `make nightly`."""
    return lambda sample, every: every if request.param else sample


@pytest.fixture(scope="session")
def once(tmp_path_factory: pytest.TempPathFactory) -> Once:
    """A folder made by the first worker that asks for it: `once(name, make)` calls `make(folder)` and returns it."""
    base = tmp_path_factory.getbasetemp()
    shared = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "once"

    def made(name: str, make: Callable[[Path], object]) -> Path:
        folder, done = shared / name, shared / f"{name}.done"
        shared.mkdir(exist_ok=True)
        with (shared / f"{name}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            if not done.exists():
                folder.mkdir(exist_ok=True)
                make(folder)
                done.touch()
        return folder

    return made


@pytest.fixture(scope="session")
def c_tracker(once: Once) -> Path:
    """The tracker in C that ships as an example, built."""

    def build(folder: Path) -> None:
        source = Path(__file__).parents[1] / "bench" / "examples" / "tracker"
        make = ["make", "-C", str(source), f"BUILD={folder}", f"PYTHON={sys.executable}"]
        done = subprocess.run(make, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr

    return once("c-tracker", build) / "tracker"
