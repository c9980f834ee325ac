"""The report as a person uses it: played, pointed at, zoomed, printed and read on a phone, in a real browser.

The browser's clock is stopped and moved on by hand, so that what is played depends on no wall clock.
"""

import csv
import json
import re
import shutil
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from matplotlib.image import imread
from playwright.sync_api import Page as Tab
from playwright.sync_api import ViewportSize, sync_playwright

from bench.analysis.figures import pool_of
from bench.analysis.page_data import events_of, page_data
from bench.analysis.report import render, render_both, render_live
from bench.analysis.saved_figures import figure_rows, strip_rows
from bench.events import CauseChange, FaultBegins, FaultEnds, RunEnded, StateChange
from bench.record import Run
from bench.scenario.model import LONGEST_DESCRIPTION

from .conftest import Motions

DESK, PHONE = ViewportSize(width=1400, height=900), ViewportSize(width=360, height=740)
# What is played is shown some frames after the key that starts it.
SOON_S = 0.05
# A blob is made in the page itself, to save it.
LOCAL = ("file:", "data:", "blob:")
CANVAS = "document.getElementById('road').toDataURL()"


@pytest.fixture(scope="module")
def browser():
    """A real browser without a screen; ended with this module, as another of its kind cannot be started beside it."""
    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if chromium is None:
        pytest.skip("no Chromium is installed")
    with sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox", "--disable-quic"])
        yield started
        started.close()


@pytest.fixture(scope="module")
def made_up(tmp_path_factory):
    """Pages by name."""
    return tmp_path_factory.mktemp("pages")


@pytest.fixture(scope="module")
def report_page(formation_log, made_up):
    """The report of a real run."""
    path = made_up / "report.html"
    path.write_text(render(Run(formation_log)), encoding="utf-8")
    return path


@pytest.fixture
def faulty(run_of):
    """A run with a fault, changes of mode and many of them at about one time."""
    motions = Motions(2, 200)
    motions.events = [
        (0.0, StateChange("info", "veh1.planner", "init", "run")),
        (0.5, FaultBegins("ecu_crash", {"ecu": "veh1.tracker"}, 1.5)),
        (1.2, StateChange("warning", "veh1.planner", "run", "safe", "TrackerLost")),
        (1.201, StateChange("warning", "veh2.planner", "run", "degraded", "PeerUnsafe")),
        (1.5, FaultEnds("ecu_crash", {"ecu": "veh1.tracker"})),
    ]
    return run_of(motions)


@pytest.fixture
def open_page(browser, tmp_path):
    """`open_page(html or path)`: a tab with it, its clock stopped; in the end nothing may have gone wrong in it."""
    contexts, troubles = [], []

    def opened(page, *, size=DESK, prepare=None, **options) -> Tab:
        context = browser.new_context(viewport=size, **options)
        contexts.append(context)
        tab = context.new_page()
        tab.on("console", lambda message: troubles.append(message.text))
        tab.on("pageerror", lambda error: troubles.append(str(error)))
        tab.on(
            "request",
            lambda asked: troubles.append(asked.url) if not asked.url.startswith(LOCAL) else None,
        )
        path = page
        if isinstance(page, str):
            path = tmp_path / "page.html"
            path.write_text(page, encoding="utf-8")
        tab.clock.install(time=0)
        if prepare is not None:
            prepare(tab)
        tab.goto(path.as_uri())
        tab.clock.pause_at(1000)
        tab.clock.run_for(500)
        return tab

    yield opened
    for context in contexts:
        context.close()
    assert troubles == []


BROKEN_ARROWS = """() => {
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  let [arrows, broken] = [0, 0];
  while (walker.nextNode())
    for (const found of walker.currentNode.data.matchAll(/->/g)) {
      const range = document.createRange();
      range.setStart(walker.currentNode, found.index);
      range.setEnd(walker.currentNode, found.index + 2);
      const lines = new Set([...range.getClientRects()].filter((at) => at.width).map((at) => at.top));
      arrows += lines.size > 0;
      broken += lines.size > 1;
    }
  return [arrows, broken];
}"""


def test_no_arrow_is_broken_over_two_lines(open_page, faulty):
    tab = open_page(render(faulty))
    for width in range(700, 900, 10):
        tab.set_viewport_size({"width": width, "height": 900})
        arrows, broken = tab.evaluate(BROKEN_ARROWS)
        assert arrows >= 3, width
        assert broken == 0, width


def time_of(tab):
    return float(tab.locator("#scrub").input_value())


def go_to(tab, time_s):
    tab.locator("#scrub").evaluate(
        "(slider, t) => { slider.value = t; slider.dispatchEvent(new Event('input')); }", time_s
    )
    settle(tab)


def settle(tab):
    tab.clock.run_for(500)


def eventually(tab, holds):
    """Wait for what the browser does when it has drawn a frame: it tells what has come into view."""
    for _ in range(100):
        if holds():
            return True
        tab.wait_for_timeout(50)
    return False


def point(tab, figure, x, y=0.5):
    """Move the mouse to a place in a figure, as shares of its size; return where that is."""
    plot = tab.locator(f"#{figure} svg.plot")
    plot.scroll_into_view_if_needed()
    box = plot.bounding_box()
    tab.mouse.move(box["x"] + box["width"] * x, box["y"] + box["height"] * y)
    settle(tab)


@pytest.mark.parametrize("size", [DESK, PHONE], ids=["desk", "phone"])
def test_all_is_drawn_and_nothing_stands_out_of_the_page(open_page, report_page, formation, size):
    tab = open_page(report_page, size=size)
    data = page_data(formation)
    paths = "all => all.map(svg => svg.querySelectorAll('path.curve').length)"
    assert tab.locator("svg.plot").evaluate_all(paths) == [len(figure["curves"]) for figure in data["figures"]]
    assert tab.locator("#tables tbody tr").count() == len(data["metrics"])
    assert tab.evaluate("document.documentElement.scrollWidth") == size["width"]
    assert tab.locator("#vehicles li").all_inner_texts()[0].split() == ["1", "20.0", "m/s"]
    # All cars are in view, in their colours.
    count = """(canvas, colours) => {
      const { data } = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height);
      return colours.map((colour) => {
        const [r, g, b] = [1, 3, 5].map((at) => parseInt(colour.slice(at, at + 2), 16));
        let found = 0;
        for (let i = 0; i < data.length; i += 4) found += data[i] === r && data[i + 1] === g && data[i + 2] === b;
        return found;
      });
    }"""
    assert min(tab.locator("#road").evaluate(count, data["road"]["colours"])) > 200


@pytest.mark.parametrize("size", [DESK, PHONE], ids=["desk", "phone"])
def test_words_of_any_length_stay_on_the_page(open_page, run_of, size):
    word = "x" * 100_000
    motions = Motions(2, 20)
    motions.events = [
        (0.0, StateChange("info", "veh1." + word, word, "run")),
        (0.1, FaultBegins("ecu_crash", {"ecu": word}, 1.5)),
        (0.1, RunEnded("failed", word)),
    ]
    run = run_of(motions, result={"status": word, "reason": word})
    run.metadata |= {"label": word, "big": word * 20, word: "1"}
    long = run.scenario.model_copy(update={"description": word * 20}).toml()
    del run.scenario, run.scenario_text
    run.attachments["scenario.toml"] = long.encode()
    tab = open_page(render(run), size=size)
    assert tab.evaluate("document.documentElement.scrollWidth") == size["width"]
    assert len(tab.locator("#description").inner_text()) == LONGEST_DESCRIPTION


@pytest.mark.parametrize(("vehicles", "cycles"), [(1, 1), (16, 20)])
def test_any_run_can_be_looked_at(open_page, run_of, vehicles, cycles):
    tab = open_page(render(run_of(Motions(vehicles, cycles))), size=PHONE)
    assert tab.locator("#vehicles li").count() == vehicles
    assert tab.evaluate("document.documentElement.scrollWidth") == PHONE["width"]
    tab.locator("#follow").select_option(str(vehicles))
    tab.keyboard.press("End")
    settle(tab)
    assert tab.locator("#cursor").inner_text() == f"t = {(cycles - 1) / 100:.2f} s"
    assert "NaN" not in tab.locator("#figures").inner_html()


def test_it_plays_and_pauses(open_page, report_page):
    tab = open_page(report_page)
    still = tab.evaluate(CANVAS)
    tab.get_by_role("button", name="Play").click()
    tab.clock.run_for(1000)
    assert time_of(tab) == pytest.approx(1.0, abs=SOON_S)
    assert tab.evaluate(CANVAS) != still
    tab.locator("#speed").select_option("2")
    tab.clock.run_for(500)
    assert time_of(tab) == pytest.approx(2.0, abs=2 * SOON_S)
    tab.get_by_role("button", name="Pause").click()
    settle(tab)
    at, still = time_of(tab), tab.evaluate(CANVAS)
    tab.clock.run_for(500)
    assert (time_of(tab), tab.evaluate(CANVAS)) == (at, still)


def test_playing_ends_with_the_run_and_begins_anew(open_page, report_page):
    tab = open_page(report_page)
    go_to(tab, 5.5)
    tab.get_by_role("button", name="Play").click()
    tab.clock.run_for(1000)
    assert tab.locator("#cursor").inner_text() == "t = 5.99 s"
    tab.get_by_role("button", name="Play").click()
    tab.clock.run_for(300)
    assert 0.2 < time_of(tab) < 0.35


def test_keys_play_step_and_follow(open_page, report_page):
    tab = open_page(report_page)
    tab.keyboard.press("Space")
    tab.clock.run_for(500)
    tab.keyboard.press("Space")
    settle(tab)
    at = time_of(tab)
    assert at == pytest.approx(0.5, abs=SOON_S)
    for key, step in [("ArrowRight", 0.1), ("Shift+ArrowRight", 0.01), ("ArrowLeft", -0.1)]:
        before = time_of(tab)
        tab.keyboard.press(key)
        settle(tab)
        # The time line goes in cycles.
        assert time_of(tab) - before == pytest.approx(step, abs=0.0051)
    tab.keyboard.press("End")
    settle(tab)
    assert time_of(tab) == pytest.approx(5.99)
    platoon = tab.evaluate(CANVAS)
    tab.keyboard.press("3")
    assert tab.locator("#follow").input_value() == "3"
    assert tab.evaluate(CANVAS) != platoon


def test_with_less_motion_asked_for_it_plays_in_steps(open_page, report_page):
    tab = open_page(report_page, reduced_motion="reduce")
    tab.get_by_role("button", name="Play").click()
    times = []
    for _ in range(60):
        tab.clock.run_for(32)
        times.append(time_of(tab))
    assert times[-1] > 1.0
    assert len(set(times)) <= 5


def test_pointing_at_a_figure_moves_the_cursor_everywhere(open_page, report_page, formation):
    tab = open_page(report_page)
    before = tab.evaluate(CANVAS)
    point(tab, "fig9", 0.5)
    at = time_of(tab)
    assert 2.0 < at < 4.0
    tab.evaluate("scrollTo(0, 0)")
    assert eventually(tab, lambda: tab.evaluate(CANVAS) != before)
    lines = tab.locator("svg.plot path.cursor").evaluate_all(
        "all => all.map(line => line.getAttribute('d').split(' ')[0])"
    )
    timed = [figure for figure in page_data(formation)["figures"] if figure["time"]]
    assert len(lines) == len(timed)
    assert all(float(line.removeprefix("M")) > 100 for line in lines)
    # Figures that are not over time have it as a dot on their curves.
    t, speed = formation.signal("veh1", "VehicleMotion", "VelocityX")
    assert tab.locator("#fig11 circle.dot:visible").count() == 1
    shown = [float(text) for text in tab.locator("#fig9 .key b").first.inner_text().split(" | ")]
    assert len(shown) == 2
    assert shown[0] == pytest.approx(speed[t.searchsorted(at - 0.005)], abs=0.1)
    # The other way round: a place on a trail has a time.
    point(tab, "fig7", 0.9)
    assert time_of(tab) > at


def test_a_time_that_comes_every_few_cycles_is_read_between_its_frames_too(open_page, report_page, formation):
    tab = open_page(report_page)
    t, steps = formation.signal("veh1", "TrackerTiming", "StepTime")
    frame = int(t.searchsorted(3.0))
    for cycles in range(5):
        go_to(tab, t[frame] + cycles * 0.01)
        reading = tab.locator("#trackertimingsteptime .key b").first.inner_text()
        assert float(reading) == pytest.approx(steps[frame] / 1000.0, rel=0.01)


def test_dragging_looks_closer(open_page, report_page):
    tab = open_page(report_page)
    point(tab, "fig9", 0.4)
    tab.mouse.down()
    point(tab, "fig9", 0.7)
    tab.mouse.up()
    settle(tab)
    assert tab.locator("#reset").is_visible()
    labels = tab.locator("#fig10 svg.plot text").all_inner_texts()
    assert "0" not in labels
    tab.locator("#reset").click()
    settle(tab)
    assert not tab.locator("#reset").is_visible()


def test_a_key_hides_its_curves(open_page, report_page):
    tab = open_page(report_page)
    tab.locator("#fig8 .key").first.click()
    assert tab.locator("#fig8 path.curve").count() == 2
    assert tab.locator("#fig8 .key").first.get_attribute("aria-pressed") == "false"


def test_what_depends_on_the_machine_is_no_verdict_beside_what_does_not(open_page, run_of):
    """Of a tracker that takes too long: apart from the rest, neither good nor bad, in one run and in two."""
    motions = Motions(2, 100)
    motions.say(1, "TrackerTiming", StepTime=np.full(100, 90_000.0), SolveTime=np.full(100, 80_000.0))
    slow = run_of(motions)
    for page in (render(slow), render_both(slow, slow)):
        tab = open_page(page)
        run, _, machine = tab.locator("#tables > table").all()
        assert machine.locator("thead").inner_text().startswith("On this machine")
        rows = machine.locator("tbody tr").all_inner_texts()
        names = ["Solver, median / p99", "Tracker step, median / p99", "Planner step, median / p99", "Real-time factor"]
        assert [row.split("\t")[0] for row in rows] == names
        assert "○" in rows[1]
        assert "not sent" in rows[2]
        assert machine.locator(".bad, .good").count() == 0
        assert run.locator(".good").count() > 5
        assert tab.locator("#verdicts p.bad").count() == 0


def test_a_limit_of_comfort_that_is_exceeded_is_no_verdict(open_page, run_of):
    motions = Motions(2, 100)
    motions.more["a_y"] = np.array([[1.0], [-3.5]]) * np.ones(100)
    hard = run_of(motions)
    for page in (render(hard), render_both(hard, hard)):
        tab = open_page(page)
        comfort = tab.locator("#tables > table").all()[1]
        head = comfort.locator("thead").inner_text()
        assert head.startswith("Comfort")
        assert "Limit" in head
        lateral = comfort.locator("tbody tr").first.inner_text()
        assert lateral.startswith("Lateral acceleration, largest")
        assert "1.00, 3.50" in lateral
        assert "○" in lateral
        assert comfort.locator(".bad, .good").count() == 0
        assert tab.locator("#verdicts p.bad").count() == 0
        assert tab.locator("#ay path.curve").count() >= 2


def test_what_was_not_sent_is_said(open_page, run_of):
    tab = open_page(render(run_of(Motions(2, 100))))
    said = tab.locator("#not-sent").inner_text()
    assert "Reference in Fig. 9 Longitudinal speed (vehicles 1, 2)" in said
    assert "Cost bound τ" in said
    assert tab.locator("#tau").count() == 0


def test_faults_and_modes_are_marked_and_listed(open_page, faulty):
    tab = open_page(render(faulty))
    rows = tab.locator("#event-rows tr").all_inner_texts()
    assert [row.split("\t")[0] for row in rows[:4]] == ["0.50 s", "1.20 s", "1.20 s", "1.50 s"]
    assert rows[4].startswith("and 1 more in the log")
    # The span of the fault is half of the run, and what lies on each other is one mark.
    span, frame = (tab.locator(f"#fig8 rect.{name}").bounding_box()["width"] for name in ("span", "frame"))
    assert span / frame == pytest.approx(1.0 / 1.99, abs=0.02)
    marks = tab.locator("#fig8 .mark .hit")
    assert marks.count() == 3
    tab.locator("#fig8 svg.plot").scroll_into_view_if_needed()
    marks.nth(1).hover()
    assert tab.locator("#tip p").all_inner_texts() == [
        "1.20 s veh1.planner: run -> safe (TrackerLost)",
        "1.20 s veh2.planner: run -> degraded (PeerUnsafe)",
    ]
    marks.nth(1).click()
    settle(tab)
    assert time_of(tab) == pytest.approx(1.2, abs=0.011)
    assert "safe: planner" in tab.locator("#vehicles li").first.inner_text()
    tab.locator("#event-rows button").first.click()
    settle(tab)
    assert time_of(tab) == pytest.approx(0.5, abs=0.011)
    assert "safe" not in tab.locator("#vehicles li").first.inner_text()


def test_a_flapping_cause_is_one_row_and_the_player_shows_state_and_cause_of_every_moment(open_page, run_of):
    motions = Motions(1, 200)
    flapping = [
        (0.3 + 0.02 * number + 0.01 * well, change)
        for number in range(60)
        for well, change in enumerate(
            (
                StateChange("warning", "veh1.planner", "run", "degraded", "SensorMissing", ""),
                StateChange("info", "veh1.planner", "degraded", "run", "", "SensorMissing"),
            )
        )
    ]
    lost = (1.6, StateChange("warning", "veh1.planner", "run", "degraded", "PeerMissing", ""))
    motions.events = [
        *flapping,
        lost,
        (1.7, CauseChange("warning", "veh1.planner", "degraded", "PeerLost", "PeerMissing")),
    ]
    tab = open_page(render(run_of(motions)))
    assert [row.split("\t")[::2] for row in tab.locator("#event-rows tr").all_inner_texts()] == [
        ["0.30 s", "run -> degraded (SensorMissing), 60 times until 1.48 s"],
        ["0.31 s", "degraded -> run (SensorMissing -> no cause), 60 times until 1.49 s"],
        ["1.60 s", "run -> degraded (PeerMissing)"],
        ["1.70 s", "degraded: PeerMissing -> PeerLost"],
    ]
    shown = []
    for time_s in (0.2, 0.7, 0.71, 1.48, 1.5, 1.65, 1.9):
        go_to(tab, time_s)
        shown.append(tab.locator("#vehicles li .state").first.inner_text())
    flap, lost, missing = (f"degraded: planner ({cause})" for cause in ("SensorMissing", "PeerLost", "PeerMissing"))
    assert shown == ["", flap, "", flap, "", missing, lost]


def test_more_events_than_are_listed_still_tell_the_state_at_the_end(open_page, run_of):
    motions = Motions(1, 200)
    motions.events = [(0.1, StateChange("warning", "veh1.planner", "run", "degraded", "Cause0", ""))]
    for number in range(1, 600):
        change = CauseChange("warning", "veh1.planner", "degraded", f"Cause{number}", f"Cause{number - 1}")
        motions.events.append((0.1 + 0.003 * number, change))
    tab = open_page(render(run_of(motions)))
    rows = tab.locator("#event-rows tr")
    assert rows.count() == 501
    assert rows.last.inner_text().startswith("and 100 more in the log")
    go_to(tab, 1.99)
    assert tab.locator("#vehicles li .state").first.inner_text() == "degraded: planner (Cause599)"


def test_a_finger_reads_figures_and_marks(open_page, faulty):
    tab = open_page(render(faulty), size=PHONE, has_touch=True, is_mobile=True)
    tab.locator("#fig8 svg.plot").tap(position={"x": 200, "y": 90})
    settle(tab)
    assert time_of(tab) > 0.8
    tab.locator("#fig8 .mark .hit").first.tap()
    assert "ecu_crash" in tab.locator("#tip").inner_text()


def test_colours_are_those_the_viewer_likes(open_page, report_page):
    light, dark = (open_page(report_page, color_scheme=scheme) for scheme in ("light", "dark"))
    grounds = [tab.evaluate("getComputedStyle(document.body).backgroundColor") for tab in (light, dark)]
    assert grounds[0] != grounds[1]
    assert light.evaluate(CANVAS) != dark.evaluate(CANVAS)


def test_on_paper_is_a_still_picture_and_all_that_is_folded(open_page, report_page, tmp_path):
    tab = open_page(report_page)
    assert not tab.locator("#pictures").is_visible()
    tab.emulate_media(media="print")
    assert not tab.locator("#road").is_visible()
    assert not tab.locator("#toolbar").is_visible()
    assert tab.locator("#pictures g.car").count() == 3 * 6
    assert tab.locator("#pictures figure").is_visible()
    count = "document.querySelectorAll('details.printed[open]').length"
    tab.evaluate(f"addEventListener('beforeprint', () => {{ document.title = String({count}); }})")
    assert tab.pdf(path=tmp_path / "report.pdf").startswith(b"%PDF")
    assert tab.title() == "2"
    assert tab.locator("details.printed[open]").count() == 0


def saved(tab, figure, kind, folder):
    """Save a figure by its button, as a user does; the file."""
    # Chromium drops the eleventh download of a second.
    tab.wait_for_timeout(150)
    with tab.expect_download() as download:
        tab.locator(f"#{figure} .save button", has_text=kind).click()
        # A picture is drawn meanwhile.
        tab.clock.run_for(500)
    path = folder / download.value.suggested_filename
    download.value.save_as(path)
    return path


def csv_rows(path):
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.reader(file))


def test_every_figure_can_be_saved_as_it_is_shown(open_page, report_page, formation, tmp_path):
    tab = open_page(report_page, color_scheme="dark")
    figures = page_data(formation)["figures"]
    cards = [*(figure["id"] for figure in figures), "strip"]
    assert tab.locator(".save").count() == len(cards)
    for card in cards:
        assert tab.locator(f"#{card} .save button").all_inner_texts() == ["SVG", "PNG", "CSV"]
        root = ET.parse(saved(tab, card, "SVG", tmp_path)).getroot()
        assert root.tag == "{http://www.w3.org/2000/svg}svg"
        # It does not depend on the page: no class, no variable, no pointer.
        text = ET.tostring(root, encoding="unicode")
        assert not re.search(r"class=|var\(--|cursor", text)
    path = saved(tab, "fig9", "SVG", tmp_path)
    assert path.name == "formation-fig9.svg"
    texts = [element.text for element in ET.parse(path).iter("{http://www.w3.org/2000/svg}text")]
    assert texts[0] == "Fig. 9 Longitudinal speed"
    assert {"vehicle 1", "v_x [m/s]", "time [s]"} <= set(texts)
    curves = [e for e in ET.parse(path).iter("{http://www.w3.org/2000/svg}path") if "C" not in e.get("d", "")]
    assert sum(len(element.get("d", "")) > 1000 for element in curves) == 6


def test_a_picture_is_on_white_whatever_the_viewer_likes(open_page, report_page, tmp_path):
    pictures = []
    for scheme in ("light", "dark"):
        tab = open_page(report_page, color_scheme=scheme)
        path = saved(tab, "fig8", "PNG", tmp_path)
        assert path.name == "formation-fig8.png"
        pictures.append(imread(path))
        shown = tab.locator("#fig8 svg.plot").bounding_box()
        assert pictures[-1].shape[1] >= 2 * shown["width"]
    light, dark = pictures
    assert (light[:4, :, :3] == 1.0).all()
    assert (light == dark).all()
    # Of three vehicles, in their colours.
    colours = {tuple(round(255 * part) for part in colour) for colour in np.unique(light.reshape(-1, 4), axis=0)[:, :3]}
    assert {(0, 114, 178), (213, 94, 0), (0, 158, 115)} <= colours


def test_the_data_that_a_button_saves_are_those_that_the_command_saves(open_page, report_page, formation, tmp_path):
    tab = open_page(report_page)
    data = page_data(formation)
    for figure in data["figures"]:
        head, *rows = figure_rows(figure, data["pool"])
        told_head, *told = csv_rows(saved(tab, figure["id"], "CSV", tmp_path))
        assert told_head == head
        assert [[float(cell) if cell else None for cell in row] for row in told] == rows
    head, *rows = strip_rows(data)
    told_head, *told = csv_rows(saved(tab, "strip", "CSV", tmp_path))
    assert told_head == list(head)
    assert [[*row[:4], *map(float, row[4:])] for row in told] == [list(row) for row in rows]


def test_figures_of_two_runs_can_be_saved(open_page, formation, run_of, tmp_path):
    tab = open_page(render_both(formation, run_of(Motions(5, 300))))
    path = saved(tab, "fig9", "SVG", tmp_path)
    assert path.name == "formation-and-made-up-fig9.svg"
    texts = {element.text for element in ET.parse(path).iter("{http://www.w3.org/2000/svg}text")}
    assert {"A vehicle 1", "B vehicle 5"} <= texts
    head, *rows = csv_rows(saved(tab, "fig9", "CSV", tmp_path))
    assert {"A time [s]", "A vehicle 1 reference: v_x [m/s]", "B time [s]", "B vehicle 5: v_x [m/s]"} <= set(head)
    assert len(rows) == 600
    assert rows[-1][head.index("B time [s]")] == ""
    assert imread(saved(tab, "fig15", "PNG", tmp_path)).shape[0] > 300


def test_two_runs_are_drawn_over_each_other(open_page, formation, run_of):
    """A solid and to its end, B, of five vehicles, dashed; B's end is earlier, and both can be hidden."""
    tab = open_page(render_both(formation, run_of(Motions(5, 300))))
    assert tab.locator("#fig8 path.curve").count() == 8
    assert tab.locator("#fig8 path.curve.dash.b").count() == 5
    assert tab.locator("#fig9 path.curve.dots").count() == 0
    tab.locator("#layer-second").check()
    settle(tab)
    tab.locator("#fig9 svg.plot").scroll_into_view_if_needed()
    assert eventually(tab, lambda: tab.locator("#fig9 path.curve.dots").count() == 3)
    assert tab.locator("#vehicles li").count() == 8
    assert tab.locator("#tables tbody tr").first.inner_text().startswith("Formation time	")
    go_to(tab, 5.0)
    # B has no value there any more, but where its vehicles were last is still shown.
    tab.evaluate("scrollTo(0, 0)")
    first = tab.evaluate(CANVAS)
    tab.locator("#layer-b").uncheck()
    assert eventually(tab, lambda: tab.evaluate(CANVAS) != first)
    tab.locator("#fig8 svg.plot").scroll_into_view_if_needed()
    assert eventually(tab, lambda: tab.locator("#fig8 path.curve").count() == 3)
    assert tab.evaluate("document.documentElement.scrollWidth") == DESK["width"]


def test_what_differs_between_two_runs_is_on_top_of_their_report(open_page, formation, run_of):
    formation.metadata["label"] = "soft <b>gains"
    other = run_of(Motions(5, 30))
    tab = open_page(render_both(formation, other))
    assert tab.title() == f"platoon: soft <b>gains (formation) and {other.scenario.name}"
    assert tab.locator("h1").inner_text() == f"soft <b>gains (formation) and {other.scenario.name}"
    assert tab.locator("#verdicts .file").all_inner_texts() == ["A: soft <b>gains: ", "B: run.mcap: "]
    assert tab.locator("#layers label").nth(0).inner_text().strip() == "A: soft <b>gains"
    assert tab.locator("#layers label").nth(1).inner_text().strip() == "B: run.mcap, dashed"
    rows = [row.split("\t") for row in tab.locator("#settings tbody tr").all_inner_texts()]
    assert ["scenario", "duration_s", "6.0", "0.3"] in rows
    assert "vehicles.3" in [row[1] for row in rows]
    assert tab.locator("#settings").bounding_box()["y"] < tab.locator("#road").bounding_box()["y"]
    assert "Not recorded in B: " in tab.locator("#settings .caption").inner_text()
    assert tab.evaluate("document.documentElement.scrollWidth") == DESK["width"]


def test_two_runs_of_one_setting_say_that_nothing_differs(open_page, formation):
    tab = open_page(render_both(formation, formation))
    assert tab.locator("#settings tr").count() == 0
    assert tab.locator("#settings .caption").first.inner_text().startswith("Nothing differs in scenario, seed, ")


def test_a_run_alone_has_its_label_as_its_title(open_page, run_of):
    run = run_of(Motions(2, 30))
    run.metadata["label"] = "soft gains"
    tab = open_page(render(run))
    assert tab.locator("h1").inner_text() == f"soft gains ({run.scenario.name})"
    assert tab.title() == f"platoon: soft gains ({run.scenario.name})"
    assert not tab.locator("#settings").is_visible()


def test_a_run_that_goes_on_grows_and_is_followed_until_the_viewer_takes_the_time(open_page, formation):
    sockets = []
    tab = open_page(
        render_live(formation),
        prepare=lambda tab: tab.route_web_socket("**/feed", lambda socket: sockets.append(socket)),
    )

    def tell(**message):
        sockets[0].send(json.dumps(message))
        tab.wait_for_timeout(50)
        tab.clock.run_for(1500)

    tab.locator("#fig8 svg.plot").scroll_into_view_if_needed()
    assert eventually(tab, lambda: len(sockets) == 1)
    span = (0.0, 2.0)
    assert tab.locator("#status").inner_text() in ("connecting ...", "live")
    tell(append={"pool": pool_of(formation, span), "events": events_of(formation.events, span)})
    assert 1.0 < time_of(tab) < 2.0
    drawn = tab.locator("#fig8 path.curve").first
    assert eventually(tab, lambda: drawn.get_attribute("d"))
    once = drawn.get_attribute("d")
    followed = time_of(tab)
    tell(append={"pool": pool_of(formation, (2.0, 4.0)), "events": []})
    assert time_of(tab) > followed
    assert len(drawn.get_attribute("d")) > 1.5 * len(once)
    tell(status="4 of 6 s")
    assert tab.locator("#status").inner_text() == "4 of 6 s"
    # The viewer takes the time, and what comes leaves it where it is.
    go_to(tab, 1.0)
    tell(append={"pool": pool_of(formation, (4.0, 5.0)), "events": []})
    assert time_of(tab) == 1.0
    tab.locator("#newest").click()
    tab.clock.run_for(1000)
    assert time_of(tab) > 4.0
    tell(replace=page_data(formation))
    assert tab.locator("#tables tbody tr").count() > 10
    assert tab.locator("#status").inner_text() == "the run has ended"
    assert not tab.locator("#newest").is_visible()
    go_to(tab, 9.0)
    assert tab.locator("#cursor").inner_text() == "t = 5.99 s"
