"""Scenarios: what is read, what is refused and in what words."""

import json
import math
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.errors import BadInput
from bench.scenario import Scenario, Sine, Step, from_log, load, shipped
from bench.scenario.errors import key_lines

SMALL = """\
name = "small"

[platoon]
lane_y_m = 7.0

[[vehicles]]
x_m = 0.0
y_m = 0.0
speed_mps = 20.0

[[vehicles]]
x_m = -10.0
y_m = 0.0
speed_mps = 20.0
"""


def refusal(*overrides: str, scenario: str | Path = "formation") -> str:
    """Return the message with which the scenario is refused."""
    with pytest.raises(BadInput) as caught:
        load(scenario, overrides)
    assert caught.value.exit_code == 2
    return str(caught.value)


@pytest.fixture
def write(tmp_path):
    def write(text: str) -> Path:
        path = tmp_path / "given.toml"
        path.write_text(text)
        return path

    return write


def test_the_issues_scenarios_are_shipped():
    assert set(shipped()) >= {
        "formation",
        "formation-soft",
        "formation-stiff",
        "formation-uneven",
        "crosswind",
        "low-grip",
        "five",
        "ten",
    }


@pytest.mark.parametrize("name", shipped())
def test_a_shipped_scenario_says_what_it_shows_and_is_named_like_its_file(name):
    scenario = load(name)
    assert scenario.name == name
    assert scenario.description
    assert scenario.platoon.speed_mps == 20.0
    assert scenario.platoon.gap_m == 10.0
    assert scenario.cycles == 1000


def test_low_grip_is_known_to_the_planner():
    scenario = load("low-grip")
    assert scenario.road.mu.value(0.0) == scenario.planner.adhesion == 0.5


def test_formation_is_the_papers():
    scenario = load("formation")
    starts = [(v.x_m, v.y_m, v.speed_mps) for v in scenario.vehicles]
    assert starts == [(8.0, 0.0, 20.0), (0.0, 3.5, 22.0), (-8.0, 0.0, 18.0)]
    assert scenario.platoon.lane_y_m == 7.0
    assert scenario.road_of(1).lambda_f.value(0.0) == 0.0


@pytest.mark.parametrize(
    ("name", "front", "rear"),
    [("formation-soft", -1, -1), ("formation-stiff", 1, 1), ("formation-uneven", 1, -1)],
)
def test_the_uncertain_formations_differ_from_formation_only_in_their_tyres(name, front, rear):
    scenario = load(name)
    assert (scenario.road.lambda_f.value(5.0), scenario.road.lambda_r.value(5.0)) == (front, rear)
    nominal = load("formation")
    same = {"name": nominal.name, "description": nominal.description, "road": nominal.road}
    assert scenario.model_copy(update=same) == nominal


def test_crosswind_blows_from_two_seconds_on():
    wind = load("crosswind").road.force_y_n
    assert (wind.value(1.99), wind.value(2.0), wind.value(10.0)) == (0.0, 600.0, 600.0)


@pytest.mark.parametrize(("name", "count"), [("five", 5), ("ten", 10)])
def test_more_vehicles_start_in_two_lanes_at_least_eight_metres_apart(name, count):
    vehicles = load(name).vehicles
    assert len(vehicles) == count
    assert {v.y_m for v in vehicles} == {0.0, 3.5}
    assert len({v.speed_mps for v in vehicles}) == 5
    distances = [math.dist((a.x_m, a.y_m), (b.x_m, b.y_m)) for i, a in enumerate(vehicles) for b in vehicles[:i]]
    assert min(distances) >= 8.0


def test_profiles():
    step = Step(kind="step", at_s=1.0, before=2.0, after=3.0)
    assert (step.value(0.999), step.value(1.0)) == (2.0, 3.0)
    sine = Sine(kind="sine", mean=1.0, amplitude=-0.5, frequency_hz=0.25, phase_rad=math.pi / 2)
    assert sine.value(0.0) == pytest.approx(0.5)
    assert sine.value(2.0) == pytest.approx(1.5)
    assert sine.extremes() == (0.5, 1.5)


def test_a_vehicles_own_road_values_replace_only_those():
    scenario = load("formation-soft", ["vehicles.1.road.mu=0.4"])
    assert scenario.road_of(1).mu.value(0.0) == 0.8
    assert scenario.road_of(2).mu.value(0.0) == 0.4
    assert scenario.road_of(2).lambda_f.value(0.0) == -1.0


# --set and --seed


@pytest.mark.parametrize("key", ["vehicles.1.x_m", "vehicles[1].x_m"])
def test_set_reaches_into_lists(key):
    scenario = load("formation", [f"{key} = -1.5"])
    assert [v.x_m for v in scenario.vehicles] == [8.0, -1.5, -8.0]


def test_set_takes_any_toml_value():
    scenario = load(
        "formation",
        [
            "road.mu={kind='step', at_s=3, before=0.8, after=0.6}",
            "name=renamed",
            "duration_s=5",
            "vehicles=[{x_m=0, y_m=0, speed_mps=20}]",
        ],
    )
    assert scenario.road.mu.value(3.0) == 0.6
    assert (scenario.name, scenario.cycles, len(scenario.vehicles)) == ("renamed", 500, 1)


def test_later_sets_win_and_build_on_earlier_ones():
    scenario = load(
        "crosswind", ["road.force_y_n.after=300.0", "road.force_y_n.at_s=1.0", "road.force_y_n.after=400.0"]
    )
    assert scenario.road.force_y_n == Step(kind="step", at_s=1.0, before=0.0, after=400.0)


def test_seed_replaces_the_scenarios():
    assert load("formation", seed=7).seed == 7
    assert "--seed -1: seed = -1 is not allowed; allowed: a whole number from 0" in refusal_of_seed(-1)


def refusal_of_seed(seed: int) -> str:
    with pytest.raises(BadInput) as caught:
        load("formation", seed=seed)
    return str(caught.value)


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("platoon.gap_m", "KEY=VALUE, e.g. --set platoon.gap_m=12.0"),
        ("vehicles.\u00b2.x_m=1", "KEY=VALUE, e.g. --set platoon.gap_m=12.0"),
        (f"vehicles.{'9' * 5000}.x_m=1", "KEY=VALUE, e.g. --set platoon.gap_m=12.0"),
        ("=3", "KEY=VALUE"),
        ("platoon..gap_m=3", "KEY=VALUE"),
        ("platoon.gap_m=1 2", "'1 2' is not a TOML value"),
        ("vehicles.3.x_m=1", "vehicles has 3 entries; allowed index: 0 to 2"),
        ("vehicles.x_m=1", "vehicles is a list (give an index) and cannot contain 'x_m'"),
        ("platoon.gap_m.x=3", "platoon.gap_m is the value 10.0 and cannot contain 'x'"),
        ("seed=" + "9" * 5000, "is not a TOML value"),
        ("vehicles.\u00b2.x_m=1", "KEY=VALUE"),
        (f"vehicles.{'9' * 5000}.x_m=1", "KEY=VALUE"),
    ],
)
def test_a_set_that_fits_nowhere_is_refused(override, message):
    refused = refusal(override)
    assert f"--set {override}" in refused
    assert message in refused


# What is refused


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("platoon.gapm=3", "platoon.gapm is not a scenario key; did you mean platoon.gap_m?"),
        ("planner.nonsense=3", "planner.nonsense is not a scenario key"),
        ("tracker.nonsense=3", "tracker.nonsense is not a scenario key"),
        ("colour=3", "colour is not a scenario key; allowed: buses, description, duration_s"),
        (
            "platoon.gap_m=-10.0",
            "platoon.gap_m = -10.0 is not allowed; allowed: a finite number from 5 to 100",
        ),
        ('platoon.gap_m="10 m"', 'platoon.gap_m = "10 m" is not allowed; allowed: a finite number from 5'),
        ("platoon.gap_m=true", "platoon.gap_m = true is not allowed"),
        ("platoon.gap_m=nan", "platoon.gap_m = nan is not allowed; allowed: a finite number"),
        ("vehicles.0.x_m=inf", "vehicles.0.x_m = inf is not allowed; allowed: a finite number from -1000"),
        (
            "platoon.speed_mps=0.5",
            "platoon.speed_mps = 0.5 is not allowed; allowed: a finite number from 1 to 40",
        ),
        ("vehicles.2.speed_mps=41", "vehicles.2.speed_mps = 41 is not allowed"),
        ("platoon=3", "platoon = 3 is not allowed; allowed: a table with lane_y_m, speed_mps, gap_m"),
        ("vehicles=[]", "vehicles has 0 entries; allowed: a list of 1 to 16 entries"),
        (
            "vehicles.0={x_m=1, speed_mps=20}",
            "vehicles.0.y_m is missing; allowed: a finite number from -100 to 100",
        ),
        (
            "duration_s=1.005",
            "duration_s = 1.005 is not a whole number of cycles; allowed: multiples of 0.01 s",
        ),
        ("duration_s=0", "duration_s = 0 is not allowed; allowed: a finite number from 0.01 to 300"),
        ("seed=1.5", "seed = 1.5 is not allowed; allowed: a whole number from 0 to 4294967295"),
        ("name=''", 'name = "" is not allowed; allowed: text that matches'),
        ("road.lambda_f=1.2", "road.lambda_f is 1.2; allowed: -1 to 1 at all times"),
        ("road.mu=0", "road.mu is 0; allowed: 0.05 to 1.5 at all times"),
        ("road.mu=low", 'road.mu = "low" is not allowed; allowed: a number from 0.05 to 1.5, or a table'),
        ("road.mu={kind='ramp'}", 'road.mu has the kind "ramp"; allowed: a number'),
        ("road.mu={at_s=1}", "road.mu has no kind; allowed: a number"),
        (
            "road.lambda_r={kind='sine', mean=0.5, amplitude=0.7, frequency_hz=1}",
            "road.lambda_r is -0.2 to 1.2; allowed: -1 to 1 at all times",
        ),
        (
            "planner.near_identity_length_m=0.1",
            "planner.near_identity_length_m is not allowed: near-identity length 0.1 m must lie between v T/2",
        ),
        ("planner.planning_interval_s=0.055", "planner.planning_interval_s is not allowed: planning interval 0.055"),
        ("planner.genetic.ga=[3.0, 0.5]", "planner.genetic.ga = [3.0, 0.5] must be [lower, upper]"),
        (
            "planner.genetic.popultion=9",
            "planner.genetic.popultion is not a scenario key; did you mean planner.genetic.pop",
        ),
        ("vehicles.0.road.mu=9", "vehicles.0.road.mu is 9; allowed: 0.05 to 1.5 at all times"),
    ],
)
def test_nonsense_is_refused_by_key_value_and_range(override, message):
    refused = refusal(override)
    assert f"  --set {override}: {message}" in refused
    assert "formation.toml has 1 error:" in refused


def test_seventeen_vehicles_are_too_many():
    vehicles = ", ".join(f"{{x_m={10 * i}, y_m=0, speed_mps=20}}" for i in range(17))
    assert "vehicles has 17 entries; allowed: a list of 1 to 16" in refusal(f"vehicles=[{vehicles}]")
    sixteen = vehicles.rpartition(", {")[0]
    assert len(load("formation", [f"vehicles=[{sixteen}]"]).vehicles) == 16


def test_the_platoon_must_be_no_slower_than_the_planner_goes():
    refused = refusal("planner.speed_min_mps=21")
    assert "line 10: platoon.speed_mps = 20.0 is outside planner.speed_min_mps" in refused
    assert "allowed: 21 to 45" in refused


@pytest.mark.parametrize(
    ("x_m", "y_m", "words"),
    [
        (-4.7, 0.0, "0.20 m from the body of vehicle 1 (bodies are 4.5 m by 1.8 m); allowed: at least 0.3 m between"),
        (-4.7, 0.0, "between bodies; move it by 0.10 m or more, with x_m or y_m"),
        (-3.9, 0.0, "0.60 m inside the body of vehicle 1"),
        (-3.9, 0.0, "move it by 0.90 m or more"),
        (0.0, 2.05, "0.25 m from the body of vehicle 1"),
        (0.0, 0.0, "1.80 m inside the body of vehicle 1"),
        (1.0, -1.8, "0.00 m inside the body of vehicle 1"),
    ],
)
def test_two_vehicles_in_one_place_are_refused(x_m, y_m, words, write):
    path = write(SMALL.replace("x_m = -10.0\ny_m = 0.0", f"x_m = {x_m}\ny_m = {y_m}"))
    refused = refusal(scenario=path)
    assert f"Scenario {path} has 1 error:" in refused
    assert "line 11: vehicles.1 (vehicle 2) starts " in refused
    assert words in refused


@pytest.mark.parametrize(("x_m", "y_m"), [(0.0, 3.5), (-4.8, 0.0), (4.8, 1.0), (0.0, 2.1), (-2.0, -2.1), (2.3, 3.0)])
def test_vehicles_may_start_abreast_and_near(x_m, y_m):
    place = [f"vehicles.1.x_m={x_m}", f"vehicles.1.y_m={y_m}"]
    vehicles = load("formation", ["vehicles.0.x_m=0.0", "vehicles.0.y_m=0.0", *place, "vehicles.2.x_m=50.0"]).vehicles
    assert (vehicles[1].x_m, vehicles[1].y_m) == (x_m, y_m)


def test_sixteen_may_start_abreast():
    vehicles = ", ".join(f"{{x_m=0.0, y_m={3.5 * lane}, speed_mps=20.0}}" for lane in range(16))
    assert len(load("formation", [f"vehicles=[{vehicles}]"]).vehicles) == 16


def test_which_way_vehicles_point_matters():
    """Across the road a car takes 4.5 m of its width."""
    abreast = [*(f"vehicles.{i}.x_m={x}" for i, x in enumerate((0.0, 0.0, 50.0))), "vehicles.1.y_m=3.4"]
    assert load("formation", ["vehicles.0.y_m=0.0", *abreast])
    refused = refusal("vehicles.0.y_m=0.0", *abreast, "vehicles.1.yaw_rad=1.5")
    assert "(vehicle 2) starts 0.19 m from the body of vehicle 1" in refused


def test_every_pair_that_is_too_near_is_told():
    refused = refusal(*(f"vehicles.{i}.x_m=0.0" for i in range(3)), *(f"vehicles.{i}.y_m=0.0" for i in range(3)))
    for vehicle, other in ((2, 1), (3, 1), (3, 2)):
        assert f"(vehicle {vehicle}) starts 1.80 m inside the body of vehicle {other}" in refused


def test_the_log_of_an_earlier_version_whose_vehicles_start_nearer_is_still_read():
    text = load("formation").toml()
    nearer = text.replace(
        f"x_m = {load('formation').vehicles[1].x_m}", f"x_m = {load('formation').vehicles[0].x_m + 4.1}"
    )
    nearer = nearer.replace(f"y_m = {load('formation').vehicles[1].y_m}", f"y_m = {load('formation').vehicles[0].y_m}")
    assert from_log(nearer).vehicles[1].x_m == load("formation").vehicles[0].x_m + 4.1


def test_several_errors_are_told_at_once_each_with_its_line(write):
    text = SMALL.replace("lane_y_m", "lane_ym").replace("speed_mps = 20.0", 'speed_mps = "fast"')
    refused = refusal(scenario=write(text))
    assert "has 4 errors:" in refused
    assert "line 4: platoon.lane_ym is not a scenario key; did you mean platoon.lane_y_m?" in refused
    assert "line 3: platoon.lane_y_m is missing" in refused
    assert 'line 9: vehicles.0.speed_mps = "fast" is not allowed' in refused
    assert 'line 14: vehicles.1.speed_mps = "fast" is not allowed' in refused


def test_lines_are_found_in_every_way_to_write_a_scenario():
    text = """\
seed = 1
platoon.gap_m = 10.0
vehicles = [
    { x_m = 0.0 },  # the leader
    { x_m = 1.0 },
]
[road]   # of all
mu = 0.5
[ "planner" ]
"""
    assert key_lines(text) == {
        ("seed",): 1,
        ("platoon", "gap_m"): 2,
        ("vehicles",): 3,
        ("vehicles", 0): 4,
        ("vehicles", 1): 5,
        ("road",): 7,
        ("road", "mu"): 8,
        ("planner",): 9,
    }
    assert key_lines("[[vehicles]]\n[[vehicles]]\n[vehicles.road]\nmu = 1.0") == {
        ("vehicles", 0): 1,
        ("vehicles", 1): 2,
        ("vehicles", 1, "road"): 3,
        ("vehicles", 1, "road", "mu"): 4,
    }


def test_a_file_that_is_no_toml_is_refused_by_line(write):
    path = write("seed = 1\nseed = \n")
    assert f"{path} is not TOML: Invalid value (at line 2, column 8)" in refusal(scenario=path)
    path.write_bytes(b'name = "\xff"')
    assert f"{path} is not TOML: not UTF-8 text (byte 8)." in refusal(scenario=path)


def test_an_unknown_scenario_is_refused_with_the_shipped_ones(tmp_path):
    refused = refusal(scenario="formtion")
    assert "No scenario 'formtion'" in refused
    assert "Did you mean formation?" in refused
    assert "crosswind" in refused
    assert "is a directory" in refusal(scenario=tmp_path)


def test_a_file_without_a_name_is_named_after_itself(write, tmp_path):
    assert load(write(SMALL.replace('name = "small"', ""))).name == "given"
    odd = tmp_path / "my own (2).toml"
    odd.write_text(SMALL.replace('name = "small"', ""))
    assert load(odd).name == "my-own--2-"


# The canonical text


@pytest.mark.parametrize("name", shipped())
def test_the_canonical_text_of_a_shipped_scenario_gives_it_back(name, write):
    scenario = load(name)
    path = write(scenario.toml())
    assert load(path) == scenario
    assert load(path).toml() == scenario.toml()


def number(low: float, high: float) -> st.SearchStrategy[float]:
    return st.floats(low, high, allow_subnormal=False)


def profile(low: float, high: float) -> st.SearchStrategy[object]:
    values = number(low, high)
    step = st.fixed_dictionaries({"kind": st.just("step"), "at_s": number(0, 300), "before": values, "after": values})
    quarter = (high - low) / 4
    sine = st.fixed_dictionaries(
        {
            "kind": st.just("sine"),
            "mean": number(low + quarter, high - quarter),
            "amplitude": number(-quarter / 2, quarter / 2),
            "frequency_hz": number(0.01, 50),
        },
        optional={"phase_rad": number(-6, 6)},
    )
    return values | step | sine


def road() -> st.SearchStrategy[object]:
    force = profile(-20_000, 20_000)
    return st.fixed_dictionaries(
        {},
        optional={
            "lambda_f": profile(-1, 1),
            "lambda_r": profile(-1, 1),
            "mu": profile(0.05, 1.5),
            "force_x_n": force,
            "force_y_n": force,
            "moment_z_nm": force,
            "slope_rad": profile(-0.3, 0.3),
        },
    )


@st.composite
def documents(draw):
    vehicles = [
        {"x_m": 5.0 * place, "y_m": draw(number(-100, 100)), "speed_mps": draw(number(1, 40)), **own}
        for place, own in enumerate(
            draw(st.lists(st.fixed_dictionaries({}, optional={"road": road()}), min_size=1, max_size=16))
        )
    ]
    return {
        "name": draw(st.from_regex(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}", fullmatch=True)),
        "description": draw(st.text(st.characters(exclude_categories=["Cs"]), max_size=40)),
        "duration_s": draw(st.integers(1, 30_000)) / 100,
        "seed": draw(st.integers(0, 2**32 - 1)),
        "platoon": {
            "speed_mps": draw(number(5, 40)),
            "lane_y_m": draw(number(-100, 100)),
            "gap_m": draw(number(20, 100)),
        },
        "vehicles": vehicles,
        "road": draw(road()),
    }


def test_the_canonical_text_of_any_scenario_gives_it_back(tmp_path_factory, tries):
    @settings(max_examples=tries(15, 50), deadline=None)
    @given(document=documents())
    def comes_back(document):
        scenario = Scenario.model_validate_json(json.dumps(document))
        path = tmp_path_factory.mktemp("scenario") / "any.toml"
        path.write_text(scenario.toml(), encoding="utf-8")
        assert load(path) == scenario

    comes_back()
