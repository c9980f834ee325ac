"""The hot modules run as machine code, and only as that of their present sources."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from bench.compiled import build, finder
from bench.compiled.modules import COMPILED
from bench.errors import BadInput

ROOT = finder.ROOT
SHOW = "import bench.control.matrices as m, bench.compiled.finder as f; print(type(m.invert).__name__, m.__file__)"


def run(folder: Path, code: str = SHOW, **settings: str) -> str:
    environment = {**os.environ, "PYTHONPATH": str(folder), finder.INTERPRETED: "", **settings}
    command = [sys.executable, "-P", "-c", code]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    return done.stdout.strip()


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """A copy of the packages with their libraries."""
    finder.current_libraries.cache_clear()
    libraries = finder.current_libraries()
    assert libraries is not None
    for package in ("bench", "platoon_fmu"):
        shutil.copytree(ROOT / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "pyproject.toml").touch()
    shutil.copytree(libraries, tmp_path / "build" / "compiled" / libraries.name)
    return tmp_path


def test_machine_code_of_the_present_sources_is_loaded_and_names_its_source(copy):
    kind, file = run(copy).split()
    assert kind != "function"
    assert file == str(copy / "bench/control/matrices.py")


@pytest.mark.parametrize("changed", ["matrices.py", "matrices.pxd"])
def test_machine_code_of_other_sources_is_not_loaded(copy, changed):
    with (copy / "bench" / "control" / changed).open("a") as file:
        file.write("# changed\n")
    assert run(copy).split()[0] == "function"


def test_the_sources_are_interpreted_on_request(copy):
    assert run(copy, **{finder.INTERPRETED: "1"}).split()[0] == "function"


def test_every_hot_module_has_a_library_under_its_name(copy):
    libraries = {path.name for path in (copy / "build/compiled").glob("*/*")}
    assert libraries == {f"{name}{finder.SUFFIX}" for name in COMPILED}


def test_only_what_has_changed_is_compiled_again(tmp_path, monkeypatch):
    said: list[str] = []
    monkeypatch.setattr(build, "library_folder", lambda: tmp_path)
    monkeypatch.setattr(finder, "library_folder", lambda: tmp_path)
    monkeypatch.setattr(build, "COMPILED", ("bench.control.matrices",))
    finder.current_libraries.cache_clear()
    try:
        folder = build.compile_modules(said.append)
        assert [path.name for path in folder.iterdir()] == [f"bench.control.matrices{finder.SUFFIX}"]
        assert build.compile_modules(said.append) == folder
        shutil.rmtree(folder)
        finder.current_libraries.cache_clear()
        assert build.compile_modules(said.append) == folder
        assert len(said) == 1
    finally:
        finder.current_libraries.cache_clear()


def keys(folder: Path) -> dict[str, str]:
    code = "import bench.compiled.build as b; [print(name, b._key(name)) for name in b.COMPILED]"
    return dict(line.split() for line in run(folder, code).splitlines())


@pytest.mark.parametrize(
    ("changed", "users"),
    [
        ("bus/layout.py", {"bus.layout"}),
        ("bus/outbox.pxd", {"bus.outbox", "ecu.runtime", "plant.plant"}),
        # Their own declarations cimport Layout.
        (
            "bus/layout.pxd",
            {
                *("bus.absence", "bus.inbox", "bus.layout", "bus.outbox", "bus.sync"),
                *("conductor.cycle", "ecu.runtime", "plant.plant"),
            },
        ),
        # layout.py cimports it, but not its declarations, which others use.
        ("bus/e2e.pxd", {"bus.e2e", "bus.inbox", "bus.layout", "ecu.runtime", "plant.plant"}),
    ],
)
def test_a_module_is_compiled_again_only_for_declarations_that_it_uses(copy, changed, users):
    before = keys(copy)
    with (copy / "bench" / changed).open("a") as file:
        file.write("# changed\n")
    after = keys(copy)
    assert {name for name in COMPILED if after[name] != before[name]} == {f"bench.{user}" for user in users}


@pytest.mark.parametrize(
    ("line", "depends"),
    [
        ("from cython.cimports.bench.bus.sync import x", True),
        ("    import cython.cimports.bench.bus.sync as s", True),
        ("from cython.cimports.bench.bus import sync", True),
        ("from cython.cimports import bench", True),
        ("from bench.bus.sync cimport x", True),
        ("from bench.bus cimport sync", True),
        ("from .sync cimport x", True),
        ("cimport libc.math, bench.bus.sync as s  # both", True),
        ("from bench.bus.synchronous cimport x", False),
        ("cimport libc.math as bench", False),
        ("from bench.bus.sync import x", False),
    ],
)
def test_all_forms_of_a_cimport_are_seen(copy, line, depends):
    with (copy / "bench/control/matrices.pxd").open("a") as file:
        file.write(f"{line}\n")
    before = keys(copy)
    with (copy / "bench/bus/sync.pxd").open("a") as file:
        file.write("# changed\n")
    changed = keys(copy)["bench.control.matrices"] != before["bench.control.matrices"]
    assert changed == depends


def test_a_missing_header_is_named_with_its_package(monkeypatch, tmp_path):
    monkeypatch.setattr(build, "library_folder", lambda: tmp_path)
    monkeypatch.setattr(finder, "library_folder", lambda: tmp_path)
    monkeypatch.setattr(build.sysconfig, "get_paths", lambda: {"include": str(tmp_path)})
    finder.current_libraries.cache_clear()
    try:
        with pytest.raises(BadInput, match=r"Python\.h is missing.*apt install python3-dev"):
            build.compile_modules()
    finally:
        finder.current_libraries.cache_clear()


def test_a_file_that_cannot_be_translated_is_named(copy):
    with (copy / "bench/control/matrices.py").open("a") as file:
        file.write("\n@cython.cfunc\ndef broken(x: cython.int) -> cython.int:\n    return nowhere.x(\n")
    code = (
        "import bench.compiled.build as b\nb.COMPILED = ('bench.control.matrices',)\n"
        "try: b.compile_modules()\nexcept Exception as e: print(type(e).__name__, e)"
    )
    told = run(copy, code)
    assert told.startswith("BadInput")
    assert "matrices.py" in told
