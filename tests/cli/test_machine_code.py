"""Commands that run the bench compile it first, say so, and tell what is missing where they cannot."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from bench.compiled.finder import INTERPRETED, ROOT, SUFFIX
from bench.record.reader import Run

ECUS = ("--ecu", "planner=tests/ecus/simple.py:CruisePlanner", "--ecu", "tracker=tests/ecus/simple.py:SpeedTracker")
RUN = ("run", "formation", "--can", "direct", "--set", "duration_s=0.1", "--no-report", "--out", "run.mcap", *ECUS)


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """A checkout with a single hot module, which has not been compiled."""
    for package in ("bench", "platoon_fmu", "dbc", "tests/ecus"):
        shutil.copytree(ROOT / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "bench/compiled/modules.py").write_text('COMPILED = ("bench.control.matrices",)\n')
    (tmp_path / "pyproject.toml").touch()
    (tmp_path / "build").mkdir()
    for file in (ROOT / "build").glob("Vehicle.fmu*"):
        shutil.copy(file, tmp_path / "build")
    return tmp_path


def command(copy: Path, *arguments: str, **settings: str) -> "subprocess.CompletedProcess[str]":
    environment = os.environ | {"PYTHONPATH": str(copy), INTERPRETED: "", **settings}
    line = [sys.executable, "-P", "-m", "bench.cli", *arguments]
    return subprocess.run(line, cwd=copy, env=environment, capture_output=True, text=True, check=False)


def test_a_run_compiles_what_is_not_and_then_runs_compiled(copy):
    first = command(copy, *RUN)
    assert "platoon: first use: compiling 1 module (one to three minutes) ..." in first.stderr
    assert Run(copy / "run.mcap").metadata["code"] == "compiled"
    assert list((copy / "build/compiled").glob(f"*/bench.control.matrices{SUFFIX}"))
    (copy / "run.mcap").unlink()
    assert "compiling" not in command(copy, *RUN).stderr


@pytest.mark.parametrize(
    "arguments", [RUN, ("ecu", "tracker", "--vehicle", "1", "--can", "udp:45999")], ids=["run", "ecu"]
)
def test_without_a_compiler_it_is_refused_with_the_remedy(copy, arguments):
    refused = command(copy, *arguments, PATH=str(copy))
    assert refused.returncode == 2
    assert "C compiler" in refused.stderr
    assert f"{INTERPRETED}=1" in refused.stderr
    assert not (copy / "run.mcap").exists()


def test_resim_is_refused_without_a_compiler_too(copy):
    command(copy, *RUN, **{INTERPRETED: "1"})
    classes = [each.replace("--ecu", "--class") for each in ECUS]
    refused = command(copy, "resim", "run.mcap", "--all", *classes, PATH=str(copy))
    assert refused.returncode == 2
    assert f"{INTERPRETED}=1" in refused.stderr


def test_a_place_that_cannot_be_written_is_one_message(copy):
    (copy / "build/compiled").write_text("")
    refused = command(copy, *RUN)
    assert refused.returncode == 2
    assert f"{copy}/build/compiled cannot be written" in refused.stderr
    assert "Traceback" not in refused.stderr


def test_an_installed_package_is_told_of_the_cache_folder(copy):
    (copy / "pyproject.toml").unlink()
    (copy / "cache").write_text("")
    refused = command(
        copy, "ecu", "tracker", "--vehicle", "1", "--can", "udp:45999", XDG_CACHE_HOME=str(copy / "cache")
    )
    assert refused.returncode == 2
    assert "set XDG_CACHE_HOME" in refused.stderr


def test_on_request_it_runs_interpreted_and_says_so(copy):
    done = command(copy, *RUN, **{INTERPRETED: "1"})
    assert f"platoon: {INTERPRETED} is set: the bench is interpreted" in done.stderr
    assert Run(copy / "run.mcap").metadata["code"] == "interpreted"
    assert not (copy / "build/compiled").exists()


@pytest.mark.parametrize(
    ("settings", "told"),
    [
        ({}, "the bench is not compiled"),
        ({INTERPRETED: "1"}, "the bench is interpreted"),
        ({"PATH": "/"}, "C compiler"),
    ],
    ids=["not yet", "on request", "never"],
)
def test_doctor_tells_how_the_bench_runs(copy, settings, told):
    lines = command(copy, "doctor", **settings).stdout.splitlines()
    (line,) = (line for line in lines if "machine code" in line)
    assert told in line
