"""The figures of a report as files: every one of them, drawn or as data, of one run and of two."""

import csv
import importlib.util
import io
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from matplotlib.image import imread
from typer.testing import CliRunner

from bench.analysis.report import data_of
from bench.analysis.saved_figures import Format, csv_text, figure_rows, save_figures
from bench.cli.main import app
from bench.errors import BadInput
from bench.record import diff

from .conftest import Motions, write

SVG = "{http://www.w3.org/2000/svg}"
SPEEDS = np.linspace(18.0, 20.0, 50)


def motions_with_reference():
    motions = Motions(2, 50)
    motions.v_x[0] = SPEEDS
    motions.say(1, "Reference", VelocityX=SPEEDS, ReferenceState=np.ones(50))
    return motions


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    return write(tmp_path_factory.mktemp("saved") / "run.mcap", motions_with_reference())


def texts_of(path):
    return [element.text for element in ET.parse(path).iter(f"{SVG}text")]


def read_csv(path):
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.reader(file))


def test_every_figure_is_saved_in_each_format(formation, tmp_path):
    data = data_of(formation)
    names = {*(figure["id"] for figure in data["figures"]), "busiest-cycle"}
    files = save_figures(data, tmp_path / "figures", [Format.SVG, Format.PNG, Format.CSV])
    assert {file.name for file in files} == {f"{name}.{kind}" for name in names for kind in ("svg", "png", "csv")}
    assert {file.name for file in (tmp_path / "figures").iterdir()} == {file.name for file in files}
    for file in files:
        if file.suffix == ".svg":
            assert ET.parse(file).getroot().tag == f"{SVG}svg"
        elif file.suffix == ".png":
            picture = imread(file)
            assert picture.shape[0] > 400
            # Not an empty page.
            assert len(np.unique(picture.reshape(-1, picture.shape[2]), axis=0)) > 10
        else:
            rows = read_csv(file)
            assert len(rows) > 2
            assert len(set(map(len, rows))) == 1
    texts = texts_of(tmp_path / "figures" / "fig9.svg")
    assert {"Fig. 9 Longitudinal speed", "v_x [m/s]", "time [s]", "vehicle 2 reference"} <= set(texts)


def test_the_data_of_a_figure_are_its_curves_by_name(log, tmp_path):
    done = CliRunner().invoke(
        app, ["report", str(log), "-o", str(tmp_path / "r.html"), "--save-figures", str(tmp_path), "--format", "csv"]
    )
    assert done.exit_code == 0, done.output
    head, *rows = read_csv(tmp_path / "fig9.csv")
    names = ["vehicle 1: v_x [m/s]", "vehicle 2: v_x [m/s]", "vehicle 1 reference: v_x [m/s]"]
    assert head == ["time [s]", *names]
    assert [float(row[1]) for row in rows] == pytest.approx(SPEEDS, rel=1e-5)
    # The first cycle has no reference yet: empty, not 0.
    assert rows[0][3] == ""
    assert [float(row[3]) for row in rows[1:]] == pytest.approx(SPEEDS[:-1], abs=1e-3)
    trails = read_csv(tmp_path / "fig7.csv")[0]
    assert trails == [
        "time [s]",
        *(f"vehicle {v}: {axis}" for v in (1, 2) for axis in ("X, along the road [m]", "Y [m]")),
    ]
    assert f"{len(list(tmp_path.glob('*.csv')))} figures in {tmp_path}" in done.output
    assert not list(tmp_path.glob("*.svg"))


def test_columns_of_different_lengths_end_with_empty_cells():
    figure = {"x_label": "x", "y_label": "y, in words", "curves": []}
    for name, x in (("a", "long"), ("b", "short")):
        figure["curves"].append({"name": name, "label": "", "at": "", "x": x, "y": f"{x}.y"})
    pool = {"long": [1.0, 2.0], "long.y": [None, 4.0], "short": [5.0], "short.y": [6.0]}
    text = csv_text(figure_rows(figure, pool))
    assert list(csv.reader(io.StringIO(text))) == [
        ["a: x", "a: y, in words", "b: x", "b: y, in words"],
        ["1.0", "", "5.0", "6.0"],
        ["2.0", "4.0", "", ""],
    ]


def test_the_same_run_gives_the_same_svg(log, tmp_path):
    from bench.record import Run

    for folder in ("a", "b"):
        save_figures(data_of(Run(log)), tmp_path / folder, [Format.SVG])
    files = sorted((tmp_path / "a").iterdir())
    assert files
    for file in files:
        assert file.read_bytes() == (tmp_path / "b" / file.name).read_bytes()


def test_figures_of_two_runs_have_the_curves_of_both(log, tmp_path):
    other = write(tmp_path / "other.mcap", Motions(2, 40))
    arguments = ["-o", str(tmp_path / "r.html"), "--save-figures", str(tmp_path / "f"), "--format", "csv"]
    done = CliRunner().invoke(app, ["report", str(log), str(other), *arguments, "--format", "svg"])
    assert done.exit_code == 0, done.output
    head, *rows = read_csv(tmp_path / "f" / "fig9.csv")
    assert head == [
        *("A time [s]", "A vehicle 1: v_x [m/s]", "A vehicle 2: v_x [m/s]", "A vehicle 1 reference: v_x [m/s]"),
        *("B time [s]", "B vehicle 1: v_x [m/s]", "B vehicle 2: v_x [m/s]"),
    ]
    # B is shorter.
    assert [row[4] != "" for row in rows] == [True] * 40 + [False] * 10
    assert {"A vehicle 1", "B vehicle 1"} <= set(texts_of(tmp_path / "f" / "fig9.svg"))


def test_signals_that_differ_are_figures_with_names_that_are_file_names(log, tmp_path):
    from bench.record import Run

    motions = motions_with_reference()
    motions.say(2, "SteeringCommand", SteeringAngle=np.full(50, 0.01))
    other = write(tmp_path / "other.mcap", motions)
    signals = diff(log, other).signals
    files = save_figures(data_of(Run(log), Run(other), signals), tmp_path / "f", [Format.CSV])
    assert "differs-veh2-SteeringCommand-SteeringAngle.csv" in {file.name for file in files}


def test_text_with_dollars_is_no_formula(log, tmp_path):
    from bench.record import Run

    data = data_of(Run(log))
    data["figures"][0]["title"] = r"costs $\frac{1}$ and $x"
    save_figures({**data, "figures": data["figures"][:1]}, tmp_path, [Format.SVG])
    assert r"costs $\frac{1}$ and $x" in texts_of(tmp_path / "fig7.svg")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--format", "svg"], "--format is of --save-figures DIR"),
        (
            ["--save-figures", "{}/f", "--format", "pdf"],
            "--format pdf: no such format of figures; allowed: svg, png, csv",
        ),
        (["--save-figures", "{}/none/f"], "there is no directory"),
        (["--save-figures", "{}/file"], "is a file; give a directory"),
    ],
)
def test_what_cannot_be_saved_is_refused_before_anything_is_written(log, tmp_path, arguments, message):
    (tmp_path / "file").touch()
    given = [argument.format(tmp_path) for argument in arguments]
    done = CliRunner().invoke(app, ["report", str(log), "-o", str(tmp_path / "r.html"), *given])
    assert isinstance(done.exception, BadInput)
    assert message in str(done.exception)
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_without_matplotlib_only_data_can_be_saved(log, tmp_path, monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)  # noqa: ARG005 - as the original
    begin = ["report", str(log), "-o", str(tmp_path / "r.html"), "--save-figures", str(tmp_path / "f")]
    refused = CliRunner().invoke(app, begin)
    assert isinstance(refused.exception, BadInput)
    assert "SVG and PNG need the package matplotlib; install it with: pip install matplotlib" in str(refused.exception)
    assert list(tmp_path.iterdir()) == []
    assert CliRunner().invoke(app, [*begin, "--format", "csv"]).exit_code == 0
