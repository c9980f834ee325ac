"""No process of the bench imports anything from the working directory, except an ECU file that the user names."""

import os
import re
import shutil
import subprocess
import sys
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

from bench.bus.link.address import Address
from bench.conductor.options import RunOptions
from bench.conductor.run import run as conduct
from bench.scenario import load
from platoon_fmu.interpreter import search_path

ROOT = Path(__file__).parents[2]
PLATOON = Path(sys.executable).with_name("platoon")
GUARD_S = 240.0

OURS = ("bench", "platoon_fmu", "tests", "ziglang", "helper", "sitecustomize", "usercustomize", "__main__")

MARKER = """
import os, sys
with open({markers!r} + "/" + __name__, "a") as marker:
    marker.write(" ".join([sys.executable, *sys.argv]) + "\\n")
"""


SHORT = ("--can", "udp", "--set", "duration_s=0.1", "--no-report")


class Hostile:
    """A working directory full of modules that leave a marker when somebody imports them."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder / "hostile"
        self.markers = folder / "markers"
        self.folder.mkdir()
        self.markers.mkdir()
        code = MARKER.format(markers=str(self.markers))
        names = {*sys.stdlib_module_names, *packages_distributions(), *OURS} - {"sys", "builtins"}
        for name in names:
            if not name.isidentifier():
                continue
            (self.folder / f"{name}.py").write_text(code)
            package = self.folder / name
            # Packages come before modules; half of the names are those.
            if len(name) % 2 or name in OURS:
                package.mkdir()
                (package / "__init__.py").write_text(code)
        plugin = self.folder / "hostile-1.0.dist-info"
        plugin.mkdir()
        (plugin / "METADATA").write_text("Metadata-Version: 2.1\nName: hostile\nVersion: 1.0\n")
        groups = ("can.interface", "can.io.message_reader", "pydantic", "typer", "pytest11")
        (plugin / "entry_points.txt").write_text("".join(f"[{group}]\nudp = hostile_plugin:x\n" for group in groups))
        (self.folder / "hostile_plugin.py").write_text(code)

    def call(self, *arguments: str, **environment: str) -> subprocess.CompletedProcess[str]:
        """Call the installed command there; nothing of what lies there may run."""
        clean = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
        done = subprocess.run(
            [PLATOON, *arguments],
            cwd=self.folder,
            env=clean | {"COLUMNS": "200"} | environment,
            capture_output=True,
            text=True,
            check=False,
            stdin=subprocess.DEVNULL,
            timeout=GUARD_S,
        )
        ran = {marker.name: marker.read_text() for marker in self.markers.iterdir()}
        assert ran == {}, done.stdout + done.stderr
        assert "Traceback" not in done.stderr, done.stderr
        return done


@pytest.fixture
def hostile(tmp_path: Path) -> Hostile:
    return Hostile(tmp_path)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The log of a short run with the built-in ECUs."""
    path = tmp_path_factory.mktemp("log") / "run.mcap"
    conduct(
        RunOptions(load("formation", ["duration_s=0.2"]), address=Address.parse("direct"), out=path, command_line=[])
    )
    return str(path)


def test_these_modules_would_leave_markers(hostile: Hostile) -> None:
    code = "import select, bench, numpy, importlib.metadata as m; [e.load for e in m.entry_points(group='pydantic')]"
    subprocess.run([sys.executable, "-c", code], cwd=hostile.folder, check=False)
    assert {"select", "bench", "numpy"} <= {marker.name for marker in hostile.markers.iterdir()}


@pytest.mark.parametrize(
    "options",
    [
        ("--can", "udp"),
        ("--can", "direct"),
        ("--can", "udp", "--live"),
        ("--can", "udp", "--clock", "realtime"),
        ("--can", "socketcan:vcan{}"),
    ],
    ids=" ".join,
)
def test_a_run(hostile: Hostile, options: tuple[str, ...]) -> None:
    done = hostile.call("run", "formation", "--set", "duration_s=0.1", "--out", "run.mcap", *options)
    if "socketcan:vcan{}" in options:
        assert done.returncode in (1, 2)
        return
    # A tenth of a second forms no platoon.
    assert done.returncode == 1, done.stderr
    assert "did not form a platoon" in done.stderr
    assert (hostile.folder / "run.mcap").exists()
    assert (hostile.folder / "run.html").exists()
    assert ("live: http://" in done.stdout) == ("--live" in options)


def test_an_ecu_file_that_the_user_names_is_loaded_and_nothing_else(hostile: Hostile) -> None:
    shutil.copy(ROOT / "tests" / "ecus" / "simple.py", hostile.folder / "my_ecus.py")
    own = ("--ecu", "tracker=my_ecus.py:SpeedTracker", "--ecu", "planner=./my_ecus.py:CruisePlanner")
    done = hostile.call("run", "formation", *SHORT, *own, "--out", "run.mcap")
    assert done.returncode == 1, done.stderr
    assert "did not form a platoon" in done.stderr
    done = hostile.call("resim", "run.mcap", "--ecu", "veh2.tracker", "--class", "my_ecus.py:SpeedTracker")
    assert done.returncode == 0, done.stdout + done.stderr


def test_a_module_from_the_working_directory_is_no_ecu(hostile: Hostile) -> None:
    shutil.copy(ROOT / "tests" / "ecus" / "simple.py", hostile.folder / "my_ecus.py")
    done = hostile.call("run", "formation", *SHORT, "--ecu", "tracker=my_ecus:SpeedTracker", "--out", "run.mcap")
    assert done.returncode == 2
    assert "No module named 'my_ecus'" in done.stderr


@pytest.mark.parametrize(
    "arguments",
    [
        ("--version",),
        ("--help",),
        ("scenarios",),
        ("doctor",),
        ("fault",),
        ("fault", "v2v_outage", "vehicle=1", "--run", "no such bench"),
        ("metrics", "LOG"),
        ("report", "LOG", "-o", "report.html"),
        ("report", "LOG", "LOG", "-o", "report.html"),
        ("diff", "LOG", "LOG", "--plot", "plot.html"),
        ("resim", "LOG", "--all"),
        ("replay", "LOG", "--can", "udp", "--speed", "max"),
        ("log", "info", "LOG"),
        ("log", "signals", "LOG", "--ranges"),
        ("log", "layout", "LOG"),
        ("log", "recover", "LOG", "-o", "recovered.mcap"),
        *(("log", "export", "LOG", "--format", kind, "-o", f"out.{kind}") for kind in ("asc", "blf", "mf4", "csv")),
        ("log", "export", "LOG", "--format", "parquet", "-o", "out.parquet"),
        ("fmu", "info"),
        ("fmu", "build", "-o", "built"),
        ("fmu", "validate"),
    ],
    ids=" ".join,
)
def test_a_command(hostile: Hostile, log: str, arguments: tuple[str, ...]) -> None:
    done = hostile.call(*(log if argument == "LOG" else argument for argument in arguments))
    no_such_bench = "no such bench" in arguments
    assert done.returncode == (2 if no_such_bench else 0), done.stdout + done.stderr


def test_an_import_of_another_tools_log(hostile: Hostile, log: str) -> None:
    assert hostile.call("log", "export", log, "--format", "candump", "-o", "out.log").returncode == 0
    assert hostile.call("log", "import", "out.log", "-o", "again.mcap").returncode == 0


def test_a_live_page_of_a_log(hostile: Hostile, log: str) -> None:
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    process = subprocess.Popen(
        [PLATOON, "live", log], cwd=hostile.folder, env=environment, stdout=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout is not None
        assert re.match(r"live: http://", process.stdout.readline())
    finally:
        process.terminate()
        process.communicate()
    assert list(hostile.markers.iterdir()) == []


def test_an_ecu_alone(hostile: Hostile) -> None:
    shutil.copy(ROOT / "tests" / "ecus" / "simple.py", hostile.folder / "my_ecus.py")
    bus = f"udp:{61000 + os.getpid() % 400 * 8}"
    own = ("--class", "my_ecus.py:SpeedTracker")
    process = subprocess.Popen(
        [PLATOON, "ecu", "tracker", "--vehicle", "1", "--can", bus, *own],
        cwd=hostile.folder,
        env={name: value for name, value in os.environ.items() if not name.startswith("PYTHON")},
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stderr is not None
        assert "veh1.tracker listens on veh1" in process.stderr.readline()
    finally:
        process.terminate()
        process.communicate()
    assert list(hostile.markers.iterdir()) == []


def test_children_do_not_inherit_a_working_directory_on_the_path(hostile: Hostile) -> None:
    """Python puts it there for `python -m`, and for an empty entry in PYTHONPATH."""
    code = (
        "import os, sys; from platoon_fmu.interpreter import python, search_path; sys.path.insert(0, os.getcwd()); "
        "child = python('bench.cli.main', 'scenarios', stdout=-3); "
        "sys.exit(child.wait() or os.getcwd() in search_path())"
    )
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    done = subprocess.run(
        [sys.executable, "-P", "-c", code],
        cwd=hostile.folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
        timeout=GUARD_S,
    )
    assert done.returncode == 0, done.stderr
    assert list(hostile.markers.iterdir()) == []


def test_a_folder_that_pythonpath_names_stays_on_the_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", ["", str(tmp_path), *sys.path])
    monkeypatch.setenv("PYTHONPATH", f":{ROOT}")
    assert not {"", str(tmp_path)} & set(search_path())
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    assert str(tmp_path) in search_path()


@pytest.mark.skipif(shutil.which("linux.uml") is None, reason="user-mode Linux is not installed")
def test_a_command_in_a_small_kernel(hostile: Hostile) -> None:
    done = hostile.call("vcan", "--", "true")
    assert done.returncode == 0, done.stderr
