"""The page inside the FMU: complete, self-contained, and true where it states figures."""

from __future__ import annotations

import html
import re
import zipfile
from html.parser import HTMLParser
from pathlib import Path

import fmpy
import numpy as np
import pytest

from platoon_fmu import codegen, documentation, interface
from platoon_fmu.parameters import VehicleParameters

VOID = {"meta", "link", "br", "img", "hr", "input"}


class Page(HTMLParser):
    """What the tests ask of a page: its rows' cells, its links and targets, and whether its tags are balanced."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.rows: list[list[str]] = []
        self.ids: set[str] = set()
        self.addresses: list[str] = []
        self.curves: list[np.ndarray] = []
        self._open: list[str] = []
        self.feed(text)
        self.close()
        assert self._open == []

    def handle_starttag(self, tag, attributes):
        given = dict(attributes)
        if tag not in VOID:
            self._open.append(tag)
        if "id" in given:
            self.ids.add(given["id"])
        self.addresses += [value for name, value in attributes if name in ("href", "src")]
        if tag == "polyline":
            self.curves.append(np.array([point.split(",") for point in given["points"].split()], float))
        if tag == "tr":
            self.rows.append([])
        if tag in ("th", "td"):
            self.rows[-1].append("")

    def handle_startendtag(self, tag, attributes):
        self.handle_starttag(tag, attributes)
        if tag not in VOID:
            self._open.pop()

    def handle_endtag(self, tag):
        assert self._open.pop() == tag

    def handle_data(self, data):
        if {"th", "td"} & set(self._open):
            self.rows[-1][-1] += data


@pytest.fixture(scope="module")
def text(fmu_path: Path) -> str:
    with zipfile.ZipFile(fmu_path) as archive:
        return archive.read("documentation/index.html").decode()


@pytest.fixture(scope="module")
def page(text: str) -> Page:
    return Page(text)


def test_the_page_refers_to_nothing_outside_the_fmu(page, fmu_path):
    assert page.addresses
    with zipfile.ZipFile(fmu_path) as archive:
        names = archive.namelist()
    for address in page.addresses:
        if address.startswith("#"):
            assert address[1:] in page.ids
        else:
            assert f"documentation/{address}" in names


def test_every_variable_is_in_the_table_with_its_figures(page):
    rows = {row[0]: row for row in page.rows if len(row) == 8}
    assert list(rows)[1:] == [
        v.name
        for group in (
            *(interface.STATES, interface.DERIVATIVES, interface.OUTPUTS, interface.INPUTS, interface.STARTS),
            *((interface.TIME,), interface.SOLVER_SETTINGS, (interface.SOLVER,), interface.PARAMETERS),
        )
        for v in group
    ]
    assert set(rows) - {"name"} == {v.name for v in interface.VARIABLES}
    assert rows["M"][1:6] == ["parameter", "tunable", "kg", "1723", "1"]
    assert rows["lambda_f"][1:7] == ["input", "continuous", "1", "0", "−1", "1"]
    for variable in interface.VARIABLES:
        assert variable.description in rows[variable.name][7]
    assert "dormand_prince_5" in rows["solver"][7]


def test_every_parameter_has_its_source(page):
    rows = {row[0]: row for row in page.rows if len(row) == 7}
    metadata = {f.name: f.metadata for f in VehicleParameters.__dataclass_fields__.values()}
    assert set(rows) - {"name"} == {v.name for v in interface.PARAMETERS} == set(metadata) - {"mu_a"}
    for variable in interface.PARAMETERS:
        assert rows[variable.name][5:] == [metadata[variable.name]["description"], metadata[variable.name]["source"]]


def test_every_parameter_is_explained_by_its_equation(text):
    """As a symbol, with its index, or by its name."""
    equations = text[text.index('id="axes"') : text.index('id="solver"')]
    written = re.sub(r"<[^>]+>|\s", "", html.unescape(equations))
    greek = {"phi": "φ", "mu": "μ", "rho": "\N{GREEK SMALL LETTER RHO}"}
    for variable in interface.PARAMETERS:
        symbol = "".join(greek.get(part, part) for part in variable.name.split("_"))
        assert symbol in written or variable.name in written, variable.name


def test_the_example_is_what_the_fmu_does(text, page, fmu_path):
    steer, at, speed = 0.03, 0.5, 20.0
    assert f"at {speed:g} m/s (72 km/h)" in text
    assert f"turned by {steer:g} rad" in text
    inputs = np.array([(0.0, 0.0), (at, 0.0), (at, steer), (4.0, steer)], [("time", float), ("steering_angle", float)])
    result = fmpy.simulate_fmu(
        str(fmu_path),
        start_values={"v_x_start": speed},
        input=inputs,
        output=["gamma", "a_y"],
        fmi_type="CoSimulation",
        stop_time=4.0,
        output_interval=0.01,
    )
    yaw_rate, acceleration = np.degrees(result["gamma"]), result["a_y"]
    assert f"rises to {yaw_rate.max():.1f} degrees" in text
    assert f"with {yaw_rate[-1]:.1f} degrees per second at {acceleration[-1]:.2f} m/s" in text
    # Drawn to a tenth of a pixel, on an axis that is linear in the value.
    for curve, values in zip(page.curves, (yaw_rate, acceleration), strict=True):
        heights = curve[:, 1]
        assert np.ptp(heights) > 100
        after = np.arange(len(values)) != round(at / 0.01)  # where the angle jumps both of its values are right
        scale = np.polyfit(values[after], heights[after], 1)
        assert scale[0] < 0
        np.testing.assert_allclose(np.polyval(scale, values[after]), heights[after], atol=0.15)


def test_the_page_is_made_of_the_model_alone():
    model = codegen.symbolic_model()
    page = documentation.page(model)
    assert page == documentation.page(model)
    assert b"$" not in page
