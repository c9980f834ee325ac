"""The notebook in docs/: its code runs, and what was kept of it is small and of no particular machine."""

import json
import shutil
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import polars as pl

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
    assert names["errors"].height == 99
    assert names["errors"].select(pl.all().is_null().any()).row(0) == (False,) * 4


def test_it_is_small_and_names_no_machine():
    assert NOTEBOOK.stat().st_size < 200_000
    text = NOTEBOOK.read_text()
    assert not any(place in text for place in ("/home/", "/root/", "/tmp/", "/work/", "\\\\Users"))
