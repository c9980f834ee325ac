"""The notebook in docs/: its code runs, and what was kept of it is small and of no particular machine."""

import json
import shutil
import subprocess
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import polars as pl

from platoon_fmu.interpreter import interpreter

NOTEBOOK = Path(__file__).parents[2] / "docs" / "analysis.ipynb"


def test_every_cell_runs(real_log, tmp_path, monkeypatch):
    mpl.use("Agg")
    monkeypatch.chdir(tmp_path)
    # With a log of this name the notebook makes none.
    shutil.copy(real_log, "formation.mcap")
    names = {}
    for cell in json.loads(NOTEBOOK.read_text())["cells"]:
        if cell["cell_type"] == "code":
            assert cell["outputs"] or "import" in cell["source"][0], "it has not been run"
            exec("".join(cell["source"]), names)
    assert len(plt.get_fignums()) == 2
    plt.close("all")
    assert isinstance(names["table"], pl.DataFrame)
    assert names["errors"].height == 19
    assert names["errors"].select(pl.all().is_null().any()).row(0) == (False,) * 4


RUNNER = """
import json, subprocess, sys
import matplotlib
matplotlib.use("Agg")
start = subprocess.run
def run(command, **options):
    # Another scenario, which needs no more than half a second to end well.
    short = ["crosswind" if word == "formation" else word for word in command]
    return start([*short, "--set", "duration_s=0.5", "--set", "road.force_y_n=0.0"], **options)
subprocess.run = run
names = {}
for cell in json.load(open(sys.argv[1]))["cells"]:
    if cell["cell_type"] == "code":
        exec("".join(cell["source"]), names)
print(names["LOG"].stat().st_size, len(names["errors"]))
"""


def test_it_makes_its_log_where_the_environment_is_not_on_the_path(tmp_path):
    """A kernel of another installation of Jupyter has the notebook's interpreter, but not its PATH."""
    environment = {"PATH": "/usr/bin:/bin", "HOME": str(tmp_path)}
    assert shutil.which("platoon", path=environment["PATH"]) is None
    command = [*interpreter(), "-c", RUNNER, str(NOTEBOOK)]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    size, rows = done.stdout.split()[-2:]
    assert (tmp_path / "formation.mcap").stat().st_size == int(size)
    assert int(rows) == 9


def test_it_is_small_and_names_no_machine():
    assert NOTEBOOK.stat().st_size < 200_000
    text = NOTEBOOK.read_text()
    assert not any(place in text for place in ("/home/", "/root/", "/tmp/", "/work/", "\\\\Users"))
