"""The verdict on a run, and the tables: every failure is found, counted, and named by its number."""

import pytest

from bench.benchmarks.comfort.front import Point, jobs, on_front, svg
from bench.benchmarks.comfort.limits import LIMITS, NAMES, overrides
from bench.benchmarks.comfort.page import page
from bench.benchmarks.comfort.results import Result, read, write
from bench.benchmarks.comfort.tables import (
    SHIPPED,
    failed_sheet,
    front_sheet,
    gave_way_sheet,
    random_sheet,
    shipped_sheets,
)
from bench.control.comfort import ComfortLimits
from bench.scenario import load, shipped

CALM = dict.fromkeys(NAMES, 1.0)


def result(**changes) -> Result:
    """A run in which all is well, but for the changes."""
    well = {"formed_s": 5.0, "clearance_m": 2.0, "clear": True, "distance_m": 8.5, "margin": 0.6, "comfort": CALM}
    return Result("random-7", 3, "3 vehicles", **{**well, **changes})


ROUGH = {**CALM, "lateral_jerk_mps3": 5.5, "longitudinal_acceleration_mps2": 3.25}
BAD = {
    "ended": ({"failure": "veh1.planner is silent"}, "ended early: veh1.planner is silent"),
    "near": ({"clear": False, "clearance_m": 0.7}, "clearance 0.70 m"),
    "outside": ({"margin": -0.1}, "outside the stability boundary, margin -0.10"),
    "on the boundary": ({"margin": 0.0}, "outside the stability boundary, margin 0.00"),
    "not formed": ({"formed_s": None}, "not formed"),
    "late": ({"formed_s": 20.5}, "formed after 20.5 s"),
    "rough": (
        {"comfort": ROUGH},
        "lateral jerk 5.50 m/s³, longitudinal acceleration 3.25 m/s², and no planner said so",
    ),
}


@pytest.mark.parametrize("name", BAD)
def test_each_thing_that_can_be_wrong_is_a_problem(name):
    changes, words = BAD[name]
    assert result(**changes).problems == [words]


@pytest.mark.parametrize(
    "changes", [{}, {"formed_s": 20.0}, {"margin": 0.01}, {"comfort": LIMITS}, {"clearance_m": 0.5, "clear": True}]
)
def test_what_is_within_all_bounds_is_none(changes):
    assert result(**changes).problems == []
    assert result(**changes).exceeded == []


def test_comfort_that_gives_way_is_no_problem_if_a_planner_says_so():
    found = result(comfort=ROUGH, limits={"NONE": 990, "HARD_BRAKING": 10})
    assert found.problems == []
    assert found.exceeded == ["lateral_jerk_mps3", "longitudinal_acceleration_mps2"]
    assert not result(comfort=ROUGH, limits={"NONE": 1000, "HARD_BRAKING": 0}).told
    assert not result(comfort=ROUGH, limits={"FRICTION_CIRCLE": 10}).told


def test_all_random_scenarios_are_counted():
    bad = [result(**changes) for changes, _ in BAD.values()]
    gave_way = result(comfort=ROUGH, limits={"HARD_BRAKING": 3}, formed_s=11.0)
    found = {row[0]: row[2] for row in random_sheet([result(), result(formed_s=7.0), *bad, gave_way]).rows}
    assert found["scenarios"] == "10"
    assert found["runs that ended early"] == "1"
    assert found["clearance below 1 m, or the start's"] == "1"
    assert found["least clearance"] == "0.70 m"
    assert found["outside the stability boundary"] == "2"
    assert found["least margin to it"] == "-0.10"
    assert found["comfort limits kept"] == "7 (70.0 %)"
    assert found["... lateral jerk above 5 m/s³"] == "2, at most 5.50 m/s³"
    assert found["... lateral acceleration above 3 m/s²"] == "0"
    assert found["comfort limits exceeded, and no planner said so"] == "1"
    assert found["formed within 20 s"] == "7 (70.0 %)"
    assert found["formation time, median / 9th decile / longest"] == "5.00 / 20.50 / 20.50 s"


def test_a_run_that_ended_early_has_kept_nothing():
    rows = {row[0]: row[2] for row in random_sheet([result(failure="x", comfort=None)]).rows}
    assert rows["comfort limits kept"] == "0 (0.0 %)"
    assert rows["formed within 20 s"] == "0 (0.0 %)"
    assert rows["least clearance"] == "-"


def test_each_failing_scenario_is_listed_by_number_and_problem():
    found = {3: result(), 8: result(clear=False, clearance_m=0.2, formed_s=None), 9: result(comfort=ROUGH)}
    rows = failed_sheet(found).rows
    assert [row[0] for row in rows] == ["random:8", "random:9"]
    assert rows[0][2] == "clearance 0.20 m; not formed"
    assert "No random scenario failed" in failed_sheet({3: result()})
    told = {4: result(comfort=ROUGH, limits={"HARD_BRAKING": 3})}
    assert gave_way_sheet(told).rows == [("random:4", "3 vehicles", told[4].discomfort)]
    assert "in no random scenario" in gave_way_sheet(found)


def test_what_a_shipped_scenario_misses_is_in_bold():
    sheets = shipped_sheets(
        {
            ("formation", "0"): result(),
            ("formation", "+1"): result(formed_s=6.01, margin=0.49, reversals=6, distance_m=7.9, comfort=ROUGH),
            ("formation-fast", "0"): result(comfort=ROUGH, reversals=6, margin=0.3, formed_s=4.1),
            ("five", "0"): result(failure="a tracker is silent", comfort=None),
        }
    )
    well, bad, fast, ended = ([*one, *other] for one, other in zip(*(sheet.rows for sheet in sheets), strict=True))
    assert not [cell for cell in (*well, *fast) if "**" in cell]
    assert [cell for cell in bad if "**" in cell] == [
        *("**6.01**", "**5.50**", "**3.25**", "**6**", "**0.49**", "**7.90**")
    ]
    assert ended.count("**a tracker is silent**") == 2
    for sheet in sheets:
        assert all(len(row) == len(sheet.headings) for row in sheet.rows)


def test_every_scenario_that_is_judged_is_shipped():
    assert set(SHIPPED) - set(shipped()) <= {"formation-fast"}


def point(acceleration: float, jerk: float, formed_s: float | None) -> Point:
    return Point(acceleration, jerk, result(formed_s=formed_s))


def test_the_front_is_where_no_stricter_limits_are_as_fast():
    slow, quick, no_quicker, never = point(1, 2, 9.0), point(3, 2, 6.0), point(3, 5, 6.0), point(1, 5, None)
    assert on_front([slow, quick, no_quicker, never]) == [slow, quick]
    sheet = front_sheet([slow, quick, no_quicker, never])
    assert [row[2] for row in sheet.rows] == ["**9.00**", "**6.00**", "6.00", "never"]


def test_the_figure_has_a_line_for_each_acceleration_and_a_dot_for_each_point_of_the_front():
    points = [point(a, j, 12.0 / (a + j)) for a in (1, 2, 3) for j in (2, 4)] + [point(1, 8, None)]
    drawn = svg(points)
    assert drawn.count("<polyline") == 3
    assert drawn.count("<circle") == 6
    assert "NaN" not in drawn
    assert svg([point(1, 2, None)]).count("<circle") == 0


def test_other_limits_are_allowed_and_take_effect():
    for limits, job in jobs().items():
        made = load(job.scenario, job.overrides)
        assert made.planner.comfort == ComfortLimits(True, *limits, *limits)
    assert load("formation", overrides(*list(LIMITS.values())[:2])) == load("formation")


def test_a_result_is_kept_as_it_is(tmp_path):
    found = result(limits={"NONE": 3}, events={"state_change": 6}, formed_s=None)
    write(found, tmp_path / "r.json")
    assert read(tmp_path / "r.json") == found
    assert [each.name for each in tmp_path.iterdir()] == ["r.json"]


def test_the_page_is_whole():
    sheets = [random_sheet([result()]), failed_sheet({0: result(margin=-1.0)})]
    points = [point(3, 5, 6.0)]
    text = page(range(300), sheets, [front_sheet(points)], shipped_sheets({("five", "0"): result()}), "front.svg")
    for words in (
        "`random:0` to `random:299`",
        "outside the stability boundary, margin -1.00",
        "](front.svg)",
        "| five |",
    ):
        assert words in text
    assert "`low-grip` formed by 8 s" in text
    assert "{" not in text
