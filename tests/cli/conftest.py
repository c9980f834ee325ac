"""The command `platoon` in this process, where it refuses what it is given, and in one of its own."""

import sys
import warnings
from collections.abc import Callable
from pathlib import Path

import pytest

from bench.cli.main import main
from tests.campaign.commands import commands

TERMINAL = {"COLUMNS": "200", "NO_COLOR": "1"}


@pytest.fixture
def refused(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """Call the command in this process.

    It must end with exit code 2, one message and nothing written; returns the message.
    """
    for name, value in {**TERMINAL, "OPENBLAS_NUM_THREADS": "1"}.items():
        monkeypatch.setenv(name, value)
    # Python's bytecode of an ECU's file is nothing that the command writes.
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    # The command sets it for its own process.
    monkeypatch.setattr(warnings, "formatwarning", warnings.formatwarning)

    def call(*arguments: str, cwd: Path) -> str:
        monkeypatch.chdir(cwd)
        monkeypatch.setattr(sys, "argv", ["platoon", *arguments])
        before = sorted(cwd.rglob("*"))
        with pytest.raises(SystemExit) as ended:
            main()
        shown = capsys.readouterr()
        assert ended.value.code == 2, shown.out + shown.err
        assert sorted(cwd.rglob("*")) == before
        return shown.err

    return call


@pytest.fixture
def begin(tmp_path):
    """`begin(words)` starts a command in the test's folder."""
    with commands(tmp_path) as start:
        yield start
