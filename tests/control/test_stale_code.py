"""Compiled code never outlives the sources that it was made of."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from bench.control.stale_code import drop_stale

CALLER = """
from numba import njit
from called import value

@njit(cache=True)
def twice():
    return 2 * value()
"""

CALLED = """
from numba import njit

@njit(cache=True)
def value():
    return {}
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "__pycache__").mkdir()
    for number, name in enumerate(("a.py", "__pycache__/a.f.nbi", "__pycache__/a.f.1.nbc", "__pycache__/a.pyc")):
        (tmp_path / name).touch()
        os.utime(tmp_path / name, (100 + number, 100 + number))
    return tmp_path


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.glob("__pycache__/*")}


def test_newer_code_stays(folder: Path) -> None:
    drop_stale(folder)
    assert names(folder) == {"a.f.nbi", "a.f.1.nbc", "a.pyc"}


def test_code_older_than_any_source_goes(folder: Path) -> None:
    (folder / "b.py").touch()
    drop_stale(folder)
    assert names(folder) == {"a.pyc"}


def test_without_compiled_code_nothing_happens(tmp_path: Path) -> None:
    drop_stale(tmp_path)
    assert not list(tmp_path.iterdir())


def test_a_caller_follows_what_it_calls(tmp_path: Path) -> None:
    """Without it numba would go on with what the called function was."""
    (tmp_path / "caller.py").write_text(CALLER)
    program = "from pathlib import Path\nfrom bench.control.stale_code import drop_stale\n"
    program += "drop_stale(Path('.'))\nfrom caller import twice\nprint(twice())"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])}
    for number in (1, 2):
        (tmp_path / "called.py").write_text(CALLED.format(number))
        done = subprocess.run(
            [sys.executable, "-c", program], cwd=tmp_path, env=environment, capture_output=True, text=True, check=True
        )
        assert done.stdout.strip() == str(2 * number)
