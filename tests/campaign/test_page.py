"""The report of a campaign as a person uses it, in a real browser."""

import csv
import io
import re
import shutil

import polars as pl
import pytest
from playwright.sync_api import sync_playwright

from bench.campaign.page import MOST_POINTS, data_of, render, report
from bench.campaign.results import ALL_MET, read
from bench.campaign.statistics import share
from bench.errors import BadInput

from .conftest import ABOVE, BELOW, made_up_rows, with_trouble, write_campaign

LOCAL = ("file:", "data:", "blob:")


@pytest.fixture(scope="module")
def browser():
    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if chromium is None:
        pytest.skip("no Chromium is installed")
    with sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox", "--disable-quic"])
        yield started
        started.close()


@pytest.fixture
def open_page(browser):
    """`open_page(path)`: a tab with it; in the end nothing may have gone wrong in it, and nothing have been loaded."""
    contexts, troubles = [], []

    def opened(path, width=1400):
        context = browser.new_context(viewport={"width": width, "height": 900})
        contexts.append(context)
        tab = context.new_page()
        tab.on("console", lambda message: troubles.append(message.text))
        tab.on("pageerror", lambda error: troubles.append(str(error)))
        tab.on("request", lambda asked: None if asked.url.startswith(LOCAL) else troubles.append(asked.url))
        tab.goto(path.as_uri())
        tab.wait_for_selector("html[data-drawn]")
        return tab

    yield opened
    for context in contexts:
        context.close()
    assert troubles == []


@pytest.fixture(scope="module")
def campaign(tmp_path_factory):
    """A campaign with a hung run and a report of its worst run, whose name needs quoting in a link."""
    rows = with_trouble(made_up_rows(400), 7, "hung", "</script><b>it took longer than 60 s")
    worst = rows.sort("metric.least_clearance_m", nulls_last=True)["number"][0]
    log = pl.when(pl.col("number") == worst).then(pl.lit("logs/run #1.mcap")).otherwise("log").alias("log")
    directory = write_campaign(tmp_path_factory.mktemp("page") / "campaign", rows.with_columns(log))
    (directory / "logs").mkdir()
    (directory / "logs" / "run #1.mcap").touch()
    (directory / "logs" / "run #1.html").write_text("<title>report of the worst</title>", encoding="utf-8")
    report(directory, directory / "report.html")
    return directory


def texts(tab, selector):
    return tab.locator(selector).all_inner_texts()


def test_the_table_shows_the_shares_with_their_bounds(campaign, open_page):
    tab = open_page(campaign / "report.html")
    shown = [row.split("\t") for row in texts(tab, "#requirements tbody tr")]
    expected = read(campaign).shares()
    assert [row[0] for row in shown] == list(expected)
    for name, *cells in shown:
        found = expected[name]
        assert cells == [str(found.failed), str(found.known), found.text, share(found.failed, found.known).bounds]
    assert f"{expected[ALL_MET].failed} of 400 runs failed" in tab.inner_text("#verdicts")


def test_the_worst_run_links_to_its_report(campaign, open_page):
    tab = open_page(campaign / "report.html")
    first = tab.locator("#worst tbody tr").first
    worst = read(campaign).worst(ABOVE).row(0, named=True)
    assert first.inner_text().split("\t")[0] == str(worst["number"])
    assert tab.locator("#worst a").count() == 1
    first.locator("a").click()
    assert tab.title() == "report of the worst"


def test_a_report_elsewhere_links_to_the_same_reports(campaign, tmp_path, open_page):
    tab = open_page(report(campaign, tmp_path / "elsewhere.html"))
    tab.locator("#worst a").click()
    assert tab.title() == "report of the worst"


def test_the_report_of_a_worst_run_is_written_and_linked_wherever_the_folder_is(
    campaign_of, real_log, open_page, tmp_path
):
    rows = made_up_rows(100)
    worst = rows.sort("metric.least_clearance_m")["number"][0]
    log = pl.when(pl.col("number") == worst).then(pl.lit("logs/run-000017.mcap")).alias("log")
    directory = campaign_of(rows.with_columns(log))
    (directory / "logs").mkdir()
    shutil.copy(real_log, directory / "logs" / "run-000017.mcap")
    report(directory, directory / "report.html")
    moved = directory.rename(tmp_path / "moved here")
    tab = open_page(moved / "report.html")
    tab.locator("#worst a").click()
    tab.wait_for_selector("html.alive")
    assert tab.title() == "platoon: formation"
    assert tab.url == (moved / "logs" / "run-000017.html").as_uri()


def test_what_was_said_of_a_run_is_text(campaign, open_page):
    tab = open_page(campaign / "report.html")
    assert "</script><b>it took longer than 60 s" in tab.inner_text("#troubles")


def test_every_figure_has_curves(campaign, open_page):
    tab = open_page(campaign / "report.html")
    for plot in tab.locator("svg.plot").all():
        assert plot.locator(".curve, .influence").count() > 0
    # Two distributions, four of convergence; tornado, scatter, any metric.
    assert tab.evaluate("document.documentElement.dataset.drawn") == "9"
    assert tab.locator("svg.plot").count() == 9


def test_the_scatter_shows_the_chosen_metric_over_the_chosen_input(campaign, open_page):
    tab = open_page(campaign / "report.html")
    tab.select_option("#scatter-metric", "formation_time_s")
    tab.select_option("#scatter-input", "vehicles.0.speed_mps")
    assert tab.inner_text("#scatter h3") == "formation_time_s over vehicles.0.speed_mps"
    paths = [path.get_attribute("d") for path in tab.locator("#scatter .curve").all()]
    failed = int(read(campaign).verdicts[ALL_MET].sum())
    # The hung run has no metric.
    assert [path.count("M") for path in paths] == [400 - failed, failed - 1]
    rising = [tuple(map(float, point)) for point in re.findall(r"M([\d.]+) ([\d.]+)h0", "".join(paths))]
    left, right = min(rising), max(rising)
    assert left[1] > right[1]
    assert f"Line: required: {BELOW}." in tab.inner_text("#scatter .caption")


def test_inputs_that_are_words_are_not_offered(campaign, open_page):
    options = texts(open_page(campaign / "report.html"), "#scatter-input option")
    assert options == ["road.lambda_f", "vehicles.0.speed_mps", "road.wind_mps"]


def test_the_tornado_shows_the_strongest_input_first(campaign, open_page):
    tab = open_page(campaign / "report.html")
    for metric, driver in (("least_clearance_m", "road.lambda_f"), ("formation_time_s", "vehicles.0.speed_mps")):
        tab.select_option("#tornado-metric", metric)
        widths = [float(bar.get_attribute("width")) for bar in tab.locator("#tornado .influence").all()]
        assert widths == sorted(widths, reverse=True)
        with tab.expect_download() as saved:
            tab.locator("#tornado .save button").nth(2).click()
        rows = list(csv.reader(io.StringIO(saved.value.path().read_text(encoding="utf-8"))))
        assert rows[1][0] == driver
        assert len(rows) == 4


@pytest.mark.parametrize("kind", ["svg", "png"])
def test_the_tornado_is_saved(campaign, open_page, kind):
    tab = open_page(campaign / "report.html")
    with tab.expect_download() as saved:
        tab.locator("#tornado .save button", has_text=kind.upper()).click()
    content = saved.value.path().read_bytes()
    assert content.startswith(b"\x89PNG") if kind == "png" else b"What drives least_clearance_m" in content


def test_any_metric_has_a_distribution(campaign, open_page):
    tab = open_page(campaign / "report.html")
    assert set(texts(tab, "#distribution-metric option")) == set(read(campaign).metrics)
    tab.select_option("#distribution-metric", "least_clearance_m")
    assert tab.locator("#any-distribution-least_clearance_m .curve").count() == 3


@pytest.mark.parametrize("width", [1400, 360])
def test_the_page_is_as_wide_as_the_window(campaign, open_page, width):
    tab = open_page(campaign / "report.html", width=width)
    assert tab.evaluate("document.documentElement.scrollWidth") <= width


def test_folded_sections_are_open_in_print(campaign, open_page, tmp_path):
    tab = open_page(campaign / "report.html")
    opened = "document.querySelectorAll('details.printed[open]').length"
    tab.evaluate(f"addEventListener('beforeprint', () => {{ document.title = String({opened}); }})")
    tab.pdf(path=tmp_path / "report.pdf")
    assert (tab.title(), tab.evaluate(opened)) == ("2", 0)


def test_nothing_is_drawn_twice_by_one_id(campaign, open_page):
    tab = open_page(campaign / "report.html")
    tab.select_option("#distribution-metric", "least_clearance_m")
    ids = tab.evaluate("[...document.querySelectorAll('[id]')].map((each) => each.id)")
    assert len(ids) == len(set(ids))


def test_a_campaign_of_one_run_has_a_page(campaign_of, open_page, tmp_path):
    tab = open_page(report(campaign_of(made_up_rows(1)), tmp_path / "one.html"))
    assert "at least 80 runs" in tab.inner_text("main")


def test_a_campaign_of_crashes_has_a_page(campaign_of, open_page, tmp_path):
    rows = with_trouble(made_up_rows(1), 0, "crashed", "signal 11")
    tab = open_page(report(campaign_of(rows), tmp_path / "crashed.html"))
    assert "1 of 1 runs failed" in tab.inner_text("#verdicts")


def test_of_many_runs_a_part_is_drawn_with_failures_first(campaign_of):
    rows = made_up_rows(2 * MOST_POINTS)
    results = read(campaign_of(rows))
    points = data_of(results, results.directory)["points"]
    assert len(points["failed"]) == len(points["metrics"]["least_clearance_m"]) == MOST_POINTS
    assert sum(points["failed"]) == results.shares()[ALL_MET].failed
    assert "5000 of 10000 runs" in points["caption"]


def test_with_many_metrics_fewer_points_are_drawn(campaign_of, monkeypatch):
    results = read(campaign_of(made_up_rows(200)))
    columns = len(results.inputs) + len(results.metrics)
    monkeypatch.setattr("bench.campaign.page.MOST_VALUES", 50 * columns)
    points = data_of(results, results.directory)["points"]
    assert len(points["failed"]) == len(points["inputs"]["road.lambda_f"]) == 50


def test_the_same_results_have_the_same_page(campaign):
    assert render(read(campaign), campaign) == render(read(campaign), campaign)


def test_a_folder_of_something_else_writes_nothing(tmp_path):
    with pytest.raises(BadInput):
        report(tmp_path, tmp_path / "report.html")
    assert not (tmp_path / "report.html").exists()
