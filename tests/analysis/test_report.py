"""The report: complete, self-contained, and alive in a real browser."""

import html.parser
import json
import random
import re
import shutil
import warnings

import numpy as np
import pytest
from typer.testing import CliRunner

from bench.analysis.figures import NOTHING_YET, Figures, pool_of
from bench.analysis.metrics import compute
from bench.analysis.page_data import live_data, page_data
from bench.analysis.report import render, render_both, render_live, write
from bench.analysis.series import MAX_POINTS, between, until_due
from bench.cli.main import app
from bench.cycle import CYCLE_S
from bench.errors import BadInput
from bench.record import LogDamaged, Run

from .conftest import Motions

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
    *("ay", "jerky", "ax", "jerkx"),
    *("distances", "clearances", "lateral", "margin", "steering", "torque1", "torque2", "torque3"),
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
    reference = formation.message("veh2", "Reference")
    # For the cycle after the one in which it was sent.
    assert data["pool"]["2.ref.VelocityX"][0] is None
    assert data["pool"]["2.ref.VelocityX"][1:] == pytest.approx(reference["VelocityX"][:-1], rel=1e-5)


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


def drawn(run):
    """The figures of a run by name, and what it says that it does not draw."""
    found = json.loads(Page(render(run)).scripts["data"])
    return {figure["id"]: figure for figure in found["figures"]}, found["not_sent"], found["pool"]


SILENT = {
    "disturbancex": "Disturbance estimate, longitudinal",
    "disturbancey": "Disturbance estimate, lateral",
    "disturbanceyaw": "Disturbance estimate, yaw",
    "flockGa": "Potential: G_a (solid), G_b (dashed)",
    "flockP11": "Position gains: p11 (solid), p12 (dashed)",
    "flockP21": "Velocity gains: p21 (solid), p22 (dashed)",
    "steering": "Steering angle command",
    "torque1": "Wheel torque commands, vehicle 1",
    "trackertimingsolvetime": "Tracker: solve time of the robust MPC",
    "trackertimingsteptime": "Tracker: time of the complete step",
    "plannertimingsteptime": "Planner: time of the complete step",
    "iterations": "Iterations of the solver",
    "tau": "Cost bound τ",
}


@pytest.mark.parametrize("how", ["nothing", "start values"])
def test_what_no_ecu_sends_is_not_drawn_and_that_is_said(run_of, how):
    """Neither of an ECU that does not send, nor of one that sends start values, as external ones and old logs have."""
    motions = Motions(1, 30)
    motions.say(1, "TrackerStatus", State=np.ones(30))
    if how == "nothing":
        messages = ("Status", "Potential", "Gains", "Target", "Timing", "BusHealth", "Disturbance")
        names = [f"{role}{name}" for role in ("Planner", "Tracker") for name in messages]
        commands = ("Reference", "SteeringCommand", "TorqueCommandFront", "TorqueCommandRear")
        motions.silent = {(1, name) for name in (*names, *commands)}
    figures, not_sent, pool = drawn(run_of(motions))
    assert not figures.keys() & SILENT.keys()
    assert set(not_sent) == {*SILENT.values(), *(f"Reference in {figures[f]['title']} (vehicle 1)" for f in REFERRED)}
    for figure in REFERRED:
        assert [curve["dash"] for curve in figures[figure]["curves"]] == [False]
        assert figures[figure]["caption"] == "No reference was sent: vehicle 1."
    # The animation draws no slot at the origin of the road.
    assert "1.target.X" not in pool


REFERRED = ("fig9", "fig10")


def test_of_what_some_send_only_that_is_drawn(run_of):
    motions = Motions(2, 30)
    say = np.full(30, 0.5)
    motions.say(1, "Reference", VelocityX=20.0 + say, ReferenceState=np.ones(30))
    motions.say(1, "TrackerDisturbance", DisturbanceX=say)
    motions.say(1, "PlannerGains", P11=say)
    # Status and times of a tracker whose solver ran in some cycles only.
    ran = np.arange(30) % 3 == 0
    motions.say(1, "TrackerStatus", State=np.ones(30), Iterations=9.0 * ran, Tau=4.0 * ran)
    motions.say(1, "TrackerTiming", SolveTime=1000.0 * ran)
    figures, not_sent, pool = drawn(run_of(motions))
    assert [curve["name"] for curve in figures["fig9"]["curves"]] == ["vehicle 1", "vehicle 2", "vehicle 1"]
    assert figures["fig9"]["caption"].endswith("No reference was sent: vehicle 2.")
    for figure in ("disturbancex", "flockP11", "iterations", "tau", "trackertimingsolvetime"):
        assert [curve["name"] for curve in figures[figure]["curves"]] == ["vehicle 1"]
        assert figures[figure]["caption"].endswith("Not sent: vehicle 2.")
        assert f"{figures[figure]['title']} (vehicle 2)" in not_sent
    assert not figures.keys() & {"disturbancey", "disturbanceyaw", "flockGa", "flockP21", "trackertimingsteptime"}
    for key in ("1.iterations", "1.tau", "1.TrackerTiming.SolveTime"):
        assert [value is not None for value in pool[key]] == ran.tolist()


def test_a_command_that_is_not_to_be_used_is_a_gap(run_of):
    motions = Motions(1, 30)
    valid = np.arange(30) < 20
    motions.say(1, "SteeringCommand", SteeringAngle=0.1 * valid, CommandState=valid * 1.0)
    _, _, pool = drawn(run_of(motions))
    assert pool["1.command.delta"] == [pytest.approx(0.1)] * 20 + [None] * 10
    assert pool["1.torque.FL"] == [0.0] * 20 + [None] * 10


def test_what_is_told_now_and_then_holds_until_it_is_due_again(data, formation):
    """A planner tells its parameters when it has optimised, which is not in every cycle."""
    told = formation.message("veh1", "PlannerPotential")
    values = data["pool"]["1.flock.Ga"]
    assert len(told["t"]) < len(values) / 2
    first = values.index(next(value for value in values if value is not None))
    assert None not in values[first:-5]
    assert set(values[first:]) - {None} == {float(f"{value:.6g}") for value in told["Ga"]}


def test_what_is_not_told_when_it_is_due_is_a_gap():
    t = np.arange(14) * CYCLE_S
    rows, at = until_due(t[[1, 4, 7, 12]], t)
    assert dict(zip(at.tolist(), rows.tolist(), strict=True)) == {
        **{1: 0, 2: 0, 3: 0, 4: 1, 5: 1, 6: 1},
        **{7: 2, 8: 2, 9: 2, 12: 3, 13: 3},
    }


def test_what_is_sent_every_few_cycles_is_on_a_straight_line_until_it_is_due_again():
    t = np.arange(28) * CYCLE_S
    sent = np.array([3, 8, 8, 13, 23])
    values = np.array([0.0, 10.0, 99.0, 5.0, 7.0])
    found = between(t[sent], values, t, 0.05).tolist()
    assert found[:3] == pytest.approx([np.nan] * 3, nan_ok=True)
    # Of two frames of one time the first counts; after the last one before a gap it goes on until the next was due.
    assert found[3:18] == pytest.approx([*np.linspace(0, 10, 5, endpoint=False), *np.linspace(10, 1, 10)])
    assert found[18:23] == pytest.approx([np.nan] * 5, nan_ok=True)
    # With nothing before it, it stays.
    assert found[23:] == [7.0] * 5


def test_a_target_told_every_few_cycles_is_drawn_in_every_cycle_and_where_the_slot_is(data, formation):
    told = formation.message("veh2", "PlannerTarget")
    x = np.array(data["pool"]["2.target.X"], float)
    assert len(told["t"]) == len(x) / 5
    assert np.isfinite(x).sum() > len(x) - 5
    # A slot drives at the platoon's speed, also in the last cycles, after the last frame.
    assert np.diff(x[-300:]) == pytest.approx(formation.scenario.platoon.speed_mps * CYCLE_S, abs=2e-3)


def test_times_that_are_the_longest_of_several_cycles_say_so(data):
    figures = {figure["id"]: figure for figure in data["figures"]}
    for name in ("trackertimingsolvetime", "trackertimingsteptime", "plannertimingsteptime", "histogram"):
        assert figures[name]["caption"].startswith("Each is the longest in 50 ms.")
    points = [value for value in data["pool"]["1.TrackerTiming.StepTime"] if value is not None]
    assert len(points) == len(data["pool"]["t"]) / 5
    rows = {row[0]: row[1] for row in data["metrics"]}
    assert rows["Planner step, median / p99"].endswith(" ms (longest in 50 ms)")


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
    with pytest.raises(BadInput, match="cannot write"):
        write(formation, tmp_path / "none" / "report.html")


def test_a_report_that_cannot_be_put_in_place_leaves_nothing_behind(formation, tmp_path):
    (tmp_path / "report.html").mkdir()
    with pytest.raises(BadInput, match="cannot write"):
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


def test_spans_of_a_run_that_goes_on_make_up_the_columns_of_the_whole(formation):
    """The page of a run that goes on begins with empty columns, and no value comes twice or is left out."""
    columns = Figures(formation, span=NOTHING_YET).columns
    assert set(map(len, columns.values())) == {0}
    for span in [(0.0, 1.0), (1.0, 2.505), (2.505, 9.0)]:
        grown = pool_of(formation, span)
        assert grown.keys() == columns.keys()
        for key, values in grown.items():
            columns[key] += values
    whole = Figures(formation).pool
    for key in columns:
        assert columns[key] == whole[key], key


def test_spans_of_a_long_run_are_on_one_grid_of_times(run_of):
    run = run_of(Motions(1, 2 * MAX_POINTS + 500))
    whole = Figures(run).pool["t"]
    assert [
        t for start in (0.0, 7.77, 30.0) for t in pool_of(run, (start, {0.0: 7.77, 7.77: 30.0}.get(start, 99.0)))["t"]
    ] == whole


def test_data_of_a_run_that_goes_on_needs_no_more_than_the_beginning_of_its_log(formation):
    data = live_data(formation)
    assert data["live"]
    assert data["pool"]["t"] == []
    whole = page_data(formation)
    figures = {figure["id"] for figure in data["figures"]}
    assert {figure["id"] for figure in whole["figures"]} - figures == {"busload", "histogram", "jerkx", "jerky"}
    assert data.keys() == whole.keys()


def test_only_the_page_of_a_run_that_goes_on_may_ask_for_more(formation):
    page = render_live(formation)
    assert "connect-src 'self'" in page
    assert "new WebSocket" in page


def test_two_runs_lie_over_each_other(formation, run_of):
    """Of five vehicles against three: figures of both, and those that only one has."""
    other = run_of(Motions(5, 100))
    data = json.loads(Page(render_both(formation, other)).scripts["data"])
    figures = {figure["id"]: figure for figure in data["figures"]}
    assert figures.keys() >= PAPER.keys() | MORE | {"fig14", "fig15"}
    speeds = [curve for curve in figures["fig9"]["curves"] if not curve["dash"]]
    assert [(curve["run"], curve["name"]) for curve in speeds] == [
        *(("A", f"vehicle {v}") for v in (1, 2, 3)),
        *(("B", f"vehicle {v}") for v in (1, 2, 3, 4, 5)),
    ]
    assert data["pool"]["1.v_x"] == pytest.approx(formation.truth(1)["v_x"], rel=1e-5)
    assert data["pool"]["B/5.v_x"] == pytest.approx(other.truth(5)["v_x"], rel=1e-5)
    assert {curve["run"] for curve in figures["fig15"]["curves"]} == {"B"}
    for figure in data["figures"]:
        for curve in figure["curves"]:
            assert curve["x"] in data["pool"]
            assert curve["y"] in data["pool"]


def test_differences_of_two_runs_are_b_less_a(formation, run_of):
    motions = Motions(3, 100)
    motions.v_x[2] += 0.05
    other = run_of(motions)
    rows = {row[0]: row for row in json.loads(Page(render_both(formation, other)).scripts["data"])["compared"]}
    a, b = compute(formation), compute(other)
    assert rows["Least distance"][1:4] == [
        f"{a.least_distance_m:.2f} m",
        "10.00 m",
        f"{10.0 - a.least_distance_m:+.2f}\u00a0m".replace("-", "−"),
    ]
    differences = [f"{y - x:+.3f}" for x, y in zip(a.final_speeds_mps, b.final_speeds_mps, strict=True)]
    found = rows["Final speeds"][3].replace("−", "-").removesuffix("\u00a0m/s").split(", ")
    assert found == ["0" if float(text) == 0 else text for text in differences]
    # Everything that is a number in both has a difference.
    numbers = [row for row in rows.values() if re.search(r"\d", row[1]) and re.search(r"\d", row[2])]
    assert len(numbers) > 8
    assert all(row[3] for row in numbers)


def test_the_command_lays_two_runs_over_each_other(run_of, tmp_path):
    a, b = run_of(Motions(2, 20)).path, tmp_path / "other.mcap"
    shutil.copy(a, b)
    done = CliRunner().invoke(app, ["report", str(a), str(b)])
    assert done.exit_code == 0, done.output
    assert (tmp_path / "run-and-other.html").read_text(encoding="utf-8").endswith("</html>\n")
    with pytest.raises(BadInput, match=r"none\.mcap is not there"):
        CliRunner().invoke(app, ["report", str(a), str(tmp_path / "none.mcap")], catch_exceptions=False)
