"""The report: complete, self-contained, and alive in a real browser."""

import html.parser
import json
import random
import re
import shutil
import subprocess
import warnings

import numpy as np
import pytest

from bench.analysis.figures import MAX_POINTS, Figures
from bench.analysis.report import render, write
from bench.errors import BadInput
from bench.record import LogDamaged, Run

from .conftest import Motions

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
PAPER = {
    "fig7": "Motion trails",
    "fig8": "Yaw angle",
    "fig9": "Longitudinal speed",
    "fig10": "Yaw rate",
    "fig11": "Yaw rate over speed, vehicle 1",
    "fig12": "Yaw rate over speed, vehicle 2",
    "fig13": "Yaw rate over speed, vehicle 3",
}
MORE = {
    *("distances", "lateral", "margin", "steering", "torque1", "torque2", "torque3"),
    *("disturbancex", "disturbancey", "disturbanceyaw", "flockGa", "flockP11", "flockP21"),
    *(
        "trackertimingsolvetime",
        "trackertimingsteptime",
        "plannertimingsteptime",
        "histogram",
        "iterations",
        "tau",
        "busload",
    ),
}


class Page(html.parser.HTMLParser):
    """Collects what a page loads and the text of its scripts."""

    def __init__(self, text):
        super().__init__()
        self.loads, self.scripts, self._script = [], {}, None
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        values = dict(attrs)
        self.loads += [values[name] for name in ("src", "href", "data", "action", "poster") if name in values]
        if tag == "script":
            self._script = values.get("id", "code")

    def handle_endtag(self, tag):
        if tag == "script":
            self._script = None

    def handle_data(self, data):
        if self._script:
            self.scripts[self._script] = self.scripts.get(self._script, "") + data


@pytest.fixture(scope="module")
def page(formation_log):
    return render(Run(formation_log))


@pytest.fixture(scope="module")
def data(page):
    return json.loads(Page(page).scripts["data"])


def test_the_papers_figures_bear_its_numbers(data):
    figures = {figure["id"]: figure for figure in data["figures"]}
    assert figures.keys() == PAPER.keys() | MORE
    for number, (figure_id, title) in enumerate(PAPER.items(), start=7):
        assert re.sub(" +", " ", figures[figure_id]["title"]) == f"Fig. {number} {title}"


def test_every_axis_has_a_unit_or_is_a_plain_number(data):
    plain = {"value", "solves", "iterations", "τ", "1 − |γ| / γ_max"}
    for figure in data["figures"]:
        for label in (figure["x_label"], figure["y_label"]):
            assert re.search(r"\[.+\]$", label) or label in plain


def test_every_curve_has_its_values(data):
    for figure in data["figures"]:
        assert figure["curves"]
        for curve in figure["curves"]:
            x, y = data["pool"][curve["x"]], data["pool"][curve["y"]]
            assert len(x) == len(y) > 1
            assert any(value is not None for value in y)
            assert not curve["at"] or len(data["pool"][curve["at"]]) == len(x)


def test_vehicles_keep_their_colour_through_all_figures(data):
    colours = {}
    for figure in data["figures"]:
        for curve in figure["curves"]:
            if curve["name"].startswith("vehicle "):
                colours.setdefault(curve["name"], set()).add(curve["colour"])
    assert len(colours) == 3
    assert all(len(found) == 1 for found in colours.values())


def test_values_are_those_of_the_log(data, formation):
    truth = formation.truth(2)
    assert data["pool"]["t"] == pytest.approx(truth["t"], rel=1e-5)
    assert data["pool"]["2.gamma"] == pytest.approx(truth["gamma"], rel=1e-5, abs=1e-12)
    reference = formation.message("veh2", "TrackerReferenceState")
    assert data["pool"]["2.ref.VelocityX"] == pytest.approx(reference["VelocityX"], rel=1e-5)


def test_the_boundary_is_drawn_from_the_papers_formula(data):
    pool = data["pool"]
    wanted = [0.85 * 0.8 * 9.8 / speed for speed in pool["1.limit_v"]]
    assert pool["1.limit_up"] == pytest.approx(wanted, rel=1e-4)
    assert pool["1.limit_down"] == pytest.approx([-limit for limit in wanted], rel=1e-4)


def test_nothing_is_loaded_from_anywhere(page):
    parsed = Page(page)
    assert parsed.loads == ["data:,"]
    assert "default-src 'none'" in page
    code = page.replace(parsed.scripts["data"], "")
    assert set(re.findall(r"https?://[^\"' )]+", code)) == {"http://www.w3.org/2000/svg"}
    assert not re.search(r"@import|url\((?!#)|\bfetch\(|XMLHttpRequest|WebSocket|import\(", code)


def test_it_is_small(page):
    assert len(page.encode()) < 1.5e6


def test_header_events_and_scenario_are_there(data, formation):
    assert data["scenario"] == "formation"
    assert "Formation time" in {row[0] for row in data["metrics"]}
    assert "seed" in dict(data["facts"])
    assert data["toml"] == formation.scenario_text


def test_what_a_log_says_cannot_break_out_of_the_page(run_of):
    run = run_of(Motions(1, 30))
    run.metadata["host"] = "</script><script>alert(1)</script><!--DATA--> a <!-- <script> b"
    page = render(run)
    parsed = Page(page)
    assert "alert" not in parsed.scripts["code"]
    # `<!-- <script>` would have a browser look for one more end of the element that holds the data.
    assert "<!--" not in page[page.index('id="data"') : page.index("</script>", page.index('id="data"'))]
    assert ["host", run.metadata["host"]] in json.loads(parsed.scripts["data"])["facts"]


def test_a_tracker_that_says_nothing_of_itself_is_not_drawn(run_of):
    """One that leaves its diagnostics to their start values has no reference of 0 m/s and no estimate of 0."""
    motions = Motions(2, 30)
    motions.say(1, "TrackerStatus", State=np.ones(30))
    motions.say(1, "TrackerReferenceState", VelocityX=np.full(30, 20.0))
    figures = {figure["id"]: figure for figure in json.loads(Page(render(run_of(motions))).scripts["data"])["figures"]}
    assert [curve["name"] for curve in figures["fig9"]["curves"]] == ["vehicle 1", "vehicle 2", "vehicle 1"]
    assert [curve["name"] for curve in figures["disturbancex"]["curves"]] == ["vehicle 1"]


@pytest.mark.parametrize("vehicles", [1, 5])
def test_any_number_of_vehicles(run_of, vehicles):
    figures = {figure.id: figure for figure in Figures(run_of(Motions(vehicles, 50))).figures}
    assert [f"fig{10 + v}" in figures for v in range(1, vehicles + 2)] == [True] * vehicles + [False]
    assert ("distances" in figures) == (vehicles > 1)
    if vehicles == 5:
        # Neighbours, and the least of all pairs instead of ten curves.
        assert len(figures["distances"].curves) == 5


def test_a_long_run_is_thinned_out_but_keeps_its_longest_times(run_of):
    motions = Motions(1, 2 * MAX_POINTS + 1)
    times = motions.t * 0.0 + 100.0
    times[1001] = 9000.0
    motions.say(1, "TrackerTiming", SolveTime=times)
    pool = Figures(run_of(motions)).pool
    assert len(pool["t"]) <= MAX_POINTS
    assert max(pool["1.TrackerTiming.SolveTime"]) == 9.0


def test_a_cut_off_run_has_a_report_that_says_so(formation_log, tmp_path):
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(formation_log.read_bytes()[: formation_log.stat().st_size // 3])
    with pytest.warns(UserWarning, match="ends before its summary"):
        found = json.loads(Page(render(Run(cut))).scripts["data"])
    assert not found["complete"]
    assert "ends before its summary" in found["damage"]


def test_a_place_that_cannot_be_written_is_named(formation, tmp_path):
    with pytest.raises(BadInput, match="cannot write the report"):
        write(formation, tmp_path / "none" / "report.html")


def test_a_report_that_cannot_be_put_in_place_leaves_nothing_behind(formation, tmp_path):
    (tmp_path / "report.html").mkdir()
    with pytest.raises(BadInput, match="cannot write the report"):
        write(formation, tmp_path / "report.html")
    assert [path.name for path in tmp_path.iterdir()] == ["report.html"]


def test_a_damaged_log_gives_a_report_or_a_clear_error(run_of, tmp_path):
    whole = run_of(Motions(2, 40)).path.read_bytes()
    generator = random.Random(3)
    path = tmp_path / "damaged.mcap"
    refused = 0
    for _ in range(80):
        damaged = bytearray(whole)
        # The head of the file holds the schemas and names, which no checksum covers.
        for _ in range(generator.choice([1, 5, 50])):
            damaged[generator.randrange(generator.choice([50_000, len(whole)]))] ^= 1 << generator.randrange(8)
        path.write_bytes(damaged)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", LogDamaged)
            try:
                assert render(Run(path)).endswith("</html>\n")
            except BadInput:
                refused += 1
    assert 0 < refused < 80


# What a person would do, done in the page itself; what came of it is left in the page's title.
PROBE = """
// A browser without a screen need not draw frames.
window.requestAnimationFrame = (draw) => setTimeout(draw, 0);
addEventListener("error", (event) => { document.title = "ERROR " + event.message; });
addEventListener("load", () => setTimeout(() => {
  const plot = document.querySelector("#fig9 svg.plot");
  const box = plot.getBoundingClientRect();
  const point = (type, x, more) => plot.dispatchEvent(new PointerEvent(type, {
    clientX: box.left + box.width * x, clientY: box.top + box.height / 2, pointerType: "mouse", ...more }));
  const found = {
    drawn: Number(document.documentElement.dataset.drawn),
    paths: Array.from(document.querySelectorAll("svg.plot"), (svg) => svg.querySelectorAll("path.curve").length),
    rows: document.querySelectorAll("#tables tbody tr").length,
    cars: document.querySelectorAll("#picture g.car").length,
    width: document.documentElement.scrollWidth - document.documentElement.clientWidth,
  };
  point("pointermove", 0.5);
  setTimeout(() => {
    found.cursor = document.getElementById("cursor").textContent;
    found.dots = document.querySelectorAll("#fig7 circle.dot").length;
    found.reading = document.querySelector("#fig9 .key b").textContent;
    document.querySelector("#fig8 .key").click();
    found.hidden = document.querySelectorAll("#fig8 path.curve").length;
    plot.setPointerCapture = () => {};
    point("pointerdown", 0.3, { button: 0 });
    point("pointermove", 0.6);
    point("pointerup", 0.6);
    const labels = Array.from(document.querySelectorAll("#fig10 svg.plot text"), (text) => text.textContent);
    found.zoomed = !labels.includes("0") || !document.getElementById("reset").hidden;
    document.getElementById("reset").click();
    found.reset = document.getElementById("reset").hidden;
    if (!document.title.startsWith("ERROR")) document.title = "FOUND " + JSON.stringify(found);
  }, 300);
}, 50));
"""


def browse(path, profile, *options):
    command = [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"]
    command += ["--disable-background-networking", "--disable-component-update", "--disable-sync"]
    command += ["--enable-logging=stderr", f"--user-data-dir={profile}", *options, f"file://{path}"]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=180)


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium is installed")
@pytest.mark.parametrize("width", [1400, 500])
def test_it_lives_in_a_real_browser(page, data, tmp_path, width):
    path = tmp_path / "report.html"
    path.write_text(page.replace("</body>", f"<script>{PROBE}</script></body>"), encoding="utf-8")
    done = browse(path, tmp_path / "profile", "--dump-dom", "--virtual-time-budget=20000", f"--window-size={width},900")
    assert "CONSOLE" not in done.stderr, done.stderr
    title = re.search(r"<title>(.*?)</title>", done.stdout, re.S)[1]
    assert title.startswith("FOUND "), title
    found = json.loads(title.removeprefix("FOUND "))
    assert found["drawn"] == len(data["figures"])
    assert found["paths"] == [len(figure["curves"]) for figure in data["figures"]]
    assert found["rows"] == len(data["metrics"])
    assert found["cars"] == 3 * 6
    assert found["width"] == 0
    assert re.fullmatch(r"t = [23]\.\d\d s", found["cursor"])
    assert found["dots"] == 3
    assert re.fullmatch(r"[\d.]+ \| [\d.]+", found["reading"])
    assert found["hidden"] == 2
    assert found["zoomed"]
    assert found["reset"]
