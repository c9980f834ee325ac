"""What differs between two runs, drawn: both curves of a signal and their difference, on the page of both."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from bench.analysis.differences import MAX_SIGNALS, figures_of
from bench.analysis.report import write as write_report
from bench.cli.main import app
from bench.errors import BadInput
from bench.record import Run, diff

from .conftest import Motions, write

CYCLES = 60


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Two runs; the second steers by a ramp from cycle 20 on."""
    folder = tmp_path_factory.mktemp("differences")
    ramp = np.maximum(0.0, np.arange(CYCLES) - 19) * 0.001
    other = Motions(2, CYCLES)
    other.say(2, "SteeringCommand", SteeringAngle=ramp)
    paths = write(folder / "a.mcap", Motions(2, CYCLES)), write(folder / "b.mcap", other)
    return Run(paths[0]), Run(paths[1])


def test_a_signal_that_differs_is_drawn_twice_and_by_how_much(runs):
    a, b = runs
    (signal,) = diff(a.path, b.path).signals
    figures, pool = figures_of([signal], a, b)
    over, by = figures
    assert over["title"] == "veh2 SteeringCommand.SteeringAngle"
    assert over["y_label"] == "SteeringAngle [rad]"
    assert "0.200 s; 40 values differ, by at most 0.04 rad" in over["caption"]
    assert [(curve["name"], curve["run"]) for curve in over["curves"]] == [("A", "A"), ("B", "B")]
    (curve,) = by["curves"]
    assert pool[curve["x"]] == pytest.approx(np.arange(CYCLES) * 0.01)
    assert pool[curve["y"]] == pytest.approx(np.maximum(0.0, np.arange(CYCLES) - 19) * 0.001, abs=1e-6)


def test_the_difference_is_of_values_of_the_same_time(tmp_path, runs):
    a, _ = runs
    shorter = Motions(2, 30)
    shorter.say(2, "SteeringCommand", SteeringAngle=np.full(30, 0.01))
    b = Run(write(tmp_path / "b.mcap", shorter))
    signal = next(s for s in diff(a.path, b.path).signals if s.signal == "SteeringAngle")
    figures, pool = figures_of([signal], a, b)
    (curve,) = figures[1]["curves"]
    assert pool[curve["x"]] == pytest.approx(np.arange(30) * 0.01)
    assert pool[curve["y"]] == pytest.approx(np.full(30, 0.01), abs=1e-6)


def test_the_page_begins_with_what_differs_and_has_no_more_than_it_can_show(tmp_path, runs):
    a, b = runs
    signals = diff(a.path, b.path).signals * (MAX_SIGNALS + 1)
    write_report(a, tmp_path / "d.html", b, signals)
    text = (tmp_path / "d.html").read_text()
    data = json.loads(text.partition('id="data">')[2].partition("</script>")[0])
    drawn = [figure for figure in data["figures"] if figure["group"] == "What differs"]
    assert data["figures"][: len(drawn)] == drawn
    assert len(drawn) == 2 * MAX_SIGNALS
    assert all(text in drawn[0]["caption"] for text in (f"{MAX_SIGNALS + 1} signals differ", "platoon diff"))
    for figure in data["figures"]:
        for curve in figure["curves"]:
            assert {curve["x"], curve["y"]} <= data["pool"].keys()


def test_the_command_draws_runs_and_refuses_other_logs_before_it_compares(tmp_path, runs):
    a, b = (str(run.path) for run in runs)
    page, runner = str(tmp_path / "d.html"), CliRunner()
    drawn = runner.invoke(app, ["diff", a, b, "--plot", page])
    assert drawn.exit_code == 1
    assert drawn.output.endswith(f"plot:   {page}\n")
    raw = str(tmp_path / "raw.mcap")
    assert runner.invoke(app, ["log", "export", a, "-o", str(tmp_path / "a.log")]).exit_code == 0
    assert runner.invoke(app, ["log", "import", str(tmp_path / "a.log"), "-o", raw]).exit_code == 0
    refused = runner.invoke(app, ["diff", a, raw, "--plot", str(tmp_path / "e.html")])
    assert isinstance(refused.exception, BadInput)
    assert refused.output == ""
    assert not (tmp_path / "e.html").exists()
