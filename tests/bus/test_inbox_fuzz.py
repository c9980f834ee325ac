"""Whatever arrives, the inbox as machine code makes the same of it as its interpreted text, and stays in its memory."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from bench.compiled.finder import INTERPRETED, ROOT, is_wanted
from tests.conftest import Tries

PART = ("absence", "e2e", "inbox", "layout", "link.direct", "sync")
"""The compiled modules of bench.bus that a frame goes through on its way to a step."""


def fuzzed(frames: int, seed: int, root: Path = ROOT, **settings: str) -> str:
    command = [sys.executable, "-P", "-m", "tests.bus.inbox_fuzz", str(frames), str(seed)]
    environment = {**os.environ, "PYTHONPATH": str(root), INTERPRETED: "", **settings}
    done = subprocess.run(command, env=environment, cwd=root, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.skipif(not is_wanted(), reason="compares machine code with the text that it was compiled from")
@pytest.mark.parametrize("seed", [1, 2], ids=["real time", "virtual time"])
def test_machine_code_makes_the_same_of_any_frames_as_the_text(seed: int, tries: Tries) -> None:
    frames = tries(20_000, 1_000_000)
    compiled = fuzzed(frames, seed)
    assert compiled == fuzzed(frames, seed, **{INTERPRETED: "1"})
    steps, refused, _ = compiled.split()
    assert int(steps) > frames // 200
    assert int(refused) > frames // 50


@pytest.mark.nightly
def test_no_frame_makes_machine_code_leave_its_memory(tmp_path: Path) -> None:
    """The same frames with every access to memory checked (AddressSanitizer)."""
    compiler = shutil.which("gcc")
    library = compiler and subprocess.check_output([compiler, "-print-file-name=libasan.so"], text=True).strip()
    if not library or not Path(library).is_file():
        pytest.skip("needs gcc and its libasan")
    for package in ("bench", "platoon_fmu", "dbc", "tests"):
        shutil.copytree(ROOT / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "pyproject.toml").touch()
    names = tuple(f"bench.bus.{name}" for name in PART)
    (tmp_path / "bench" / "compiled" / "modules.py").write_text(f"COMPILED: tuple[str, ...] = {names!r}\n")
    build = (
        "import bench.compiled.build as b; "
        "b.FLAGS = (*b.FLAGS, '-O1', '-g', '-fsanitize=address', '-fno-omit-frame-pointer'); b.compile_modules()"
    )
    environment = {**os.environ, "PYTHONPATH": str(tmp_path), INTERPRETED: ""}
    subprocess.run([sys.executable, "-P", "-c", build], env=environment, check=True)
    # Python keeps what it needs until the end, and its own allocator would hide accesses beyond an object.
    checked = {"LD_PRELOAD": library, "ASAN_OPTIONS": "detect_leaks=0", "PYTHONMALLOC": "malloc"}
    for seed in (1, 2):
        assert fuzzed(1_000_000, seed, tmp_path, **checked) == fuzzed(1_000_000, seed)
