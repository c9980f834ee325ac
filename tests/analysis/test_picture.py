"""The still picture of a run."""

import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest

from bench.analysis.picture import write_svg
from bench.errors import BadInput

from .conftest import Motions

SVG = "{http://www.w3.org/2000/svg}"


def cars(path):
    """Place and angle of each car, by moment."""
    root = ET.parse(path).getroot()
    pattern = re.compile(r"translate\((\S+) (\S+)\) rotate\((\S+)\)")
    moments = root.findall(f"{SVG}g/{SVG}svg")
    return [
        [tuple(float(v) for v in pattern.match(g.get("transform")).groups()) for g in moment.findall(f"{SVG}g")]
        for moment in moments
    ]


def test_cars_stand_where_they_were_to_scale(run_of, tmp_path):
    motions = Motions(2, 200)
    motions.Y[1] = np.linspace(3.5, 7.0, 200)
    motions.psi[1, :50] = 0.1
    write_svg(run_of(motions), tmp_path / "run.svg", moments=3)
    found = cars(tmp_path / "run.svg")
    assert len(found) == 3
    # 9 pixels a metre: 10 m behind and 3.5 m to the right; turned to the left is upwards.
    first, second = found[0]
    assert first[0] - second[0] == pytest.approx(90.0, abs=0.2)
    assert second[1] - first[1] == pytest.approx(31.5, abs=0.2)
    assert second[2] == pytest.approx(-5.73, abs=0.01)
    # The view moves along: who keeps the platoon's speed stays where it is.
    assert found[2][0][0] == pytest.approx(first[0], abs=0.2)


def test_all_cars_are_inside_the_picture(formation, tmp_path):
    write_svg(formation, tmp_path / "run.svg")
    root = ET.parse(tmp_path / "run.svg").getroot()
    size = [(float(s.get("width")), float(s.get("height"))) for s in root.findall(f"{SVG}g/{SVG}svg")]
    for moment, (width, height) in zip(cars(tmp_path / "run.svg"), size, strict=True):
        assert len(moment) == 3
        assert all(0 < x < width and 0 < y < height for x, y, _ in moment)


def test_a_place_that_cannot_be_written_is_named(run_of, tmp_path):
    with pytest.raises(BadInput, match="cannot write"):
        write_svg(run_of(Motions(1, 20)), tmp_path / "none" / "run.svg")
