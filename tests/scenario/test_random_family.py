"""The random scenarios: always the same, always within their ranges, and of every kind."""

import hashlib
import tomllib
from collections import Counter
from itertools import pairwise

import pytest

from bench.errors import BadInput
from bench.faults.profile import Constant, Sine, Step
from bench.scenario import Scenario, load
from bench.scenario.families import MOST
from bench.scenario.random_family import random_scenario
from platoon_fmu.parameters import BODY

SEEDS = range(400)


@pytest.fixture(scope="module")
def family() -> list[Scenario]:
    return [load(f"random:{seed}") for seed in SEEDS]


@pytest.mark.parametrize(
    ("seed", "digest"),
    [
        (0, "7bb688faef97bce8"),
        (1, "2dd34077571ec58b"),
        (7, "941ad516dcc2594a"),
        (299, "3274f83c616c42e4"),
        (MOST, "ac01588a9f49257c"),
    ],
)
def test_a_number_is_the_same_scenario_for_ever(seed, digest):
    """Never mend these hashes: results that name a number would then be of another scenario."""
    assert hashlib.sha256(random_scenario(seed).encode()).hexdigest()[:16] == digest


def test_the_text_is_the_scenario(family, tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text(random_scenario(7))
    assert load(path) == family[7] == load("random:7")
    assert (family[7].name, family[7].seed) == ("random-7", 7)
    assert load("random:7", ["platoon.gap_m=20.0"], seed=3).vehicles == family[7].vehicles


def test_all_numbers_are_rounded_as_people_write_them():
    for seed in SEEDS:
        for vehicle in tomllib.loads(random_scenario(seed))["vehicles"]:
            assert all(len(str(value).partition(".")[2]) <= 2 for value in vehicle.values())


def gaps(scenario: Scenario) -> list[float]:
    """Distances between successive vehicles, or between those of one lane where some are abreast."""
    vehicles = scenario.vehicles
    in_line = abs(vehicles[0].x_m - vehicles[1].x_m) > BODY.length
    lanes = [vehicles] if in_line else [[v for v in vehicles if v.y_m == y] for y in (0.0, 3.5)]
    return [round(ahead.x_m - behind.x_m, 6) for lane in lanes for ahead, behind in pairwise(lane)]


def test_every_value_is_in_its_range(family):
    for each in family:
        assert 2 <= len(each.vehicles) <= 7
        assert 12.0 <= each.platoon.speed_mps <= 28.0
        assert 8.0 <= each.platoon.gap_m <= 15.0
        assert all(9.0 <= gap <= 18.0 for gap in gaps(each)), each.name
        assert all(abs(v.speed_mps - each.platoon.speed_mps) <= 3.0 + 1e-9 for v in each.vehicles)
        assert {v.y_m for v in each.vehicles} <= {0.0, 3.5}
        assert 0.4 <= each.planner.adhesion <= 0.9
        assert each.road.mu.extremes() == (each.planner.adhesion, each.planner.adhesion)
        assert -900.0 <= each.road.force_y_n.extremes()[0] <= each.road.force_y_n.extremes()[1] <= 900.0
        for profile in (each.road.lambda_f, each.road.lambda_r):
            assert not isinstance(profile, Sine) or 0.1 <= profile.frequency_hz <= 3.0
        assert each.duration_s == 20.0


def spread(values: list[float], low: float, high: float) -> bool:
    """Whether the lowest and the highest of many values come near both ends of their range."""
    margin = 0.05 * (high - low)
    return min(values) < low + margin and max(values) > high - margin


def test_the_ranges_are_used_from_end_to_end(family):
    assert Counter(len(each.vehicles) for each in family).keys() == {2, 3, 4, 5, 6, 7}
    assert spread([each.platoon.speed_mps for each in family], 12.0, 28.0)
    assert spread([each.platoon.gap_m for each in family], 8.0, 15.0)
    assert spread([gap for each in family for gap in gaps(each)], 9.0, 18.0)
    assert spread([v.speed_mps - each.platoon.speed_mps for each in family for v in each.vehicles], -3.0, 3.0)
    assert spread([each.planner.adhesion for each in family], 0.4, 0.9)
    assert spread([f for each in family for f in each.road.force_y_n.extremes()], -900.0, 900.0)
    axles = [profile for each in family for profile in (each.road.lambda_f, each.road.lambda_r)]
    assert spread([p.level for p in axles if isinstance(p, Constant)], -1.0, 1.0)
    assert spread([p.frequency_hz for p in axles if isinstance(p, Sine)], 0.1, 3.0)


def test_every_kind_of_start_lane_and_road_occurs(family):
    kinds = (Constant, Step, Sine)
    both = Counter((type(each.road.lambda_f), type(each.road.lambda_r)) for each in family)
    assert both.keys() == {(front, rear) for front in kinds for rear in kinds}
    assert min(both.values()) > 20
    shifts = [each.platoon.lane_y_m - v.y_m for each in family for v in each.vehicles]
    assert sum(shift > 0 for shift in shifts) > len(shifts) / 4
    assert sum(shift < 0 for shift in shifts) > len(shifts) / 4
    starts = Counter(each.description.split(", ")[1] for each in family)
    assert starts.keys() == {"one after another", "side by side", "exactly abreast"}
    assert min(starts.values()) > 100
    assert 150 < sum(isinstance(each.road.force_y_n, Step) for each in family) < 250


def test_the_description_is_true(family):
    for each in family:
        apart = abs(each.vehicles[0].x_m - each.vehicles[1].x_m)
        start = "exactly abreast" if apart == 0.0 else "side by side" if apart < BODY.length else "one after another"
        assert each.description.startswith(f"{len(each.vehicles)} vehicles, {start}, ")


def test_any_number_up_to_the_largest_is_a_scenario():
    assert load(f"random:{MOST}").seed == MOST
    assert load("random:0").seed == 0


@pytest.mark.parametrize("number", ["", "-1", "seven", "1.5", "4294967296", "9" * 5000, "²", " 7"])
def test_what_is_no_number_of_one_is_refused(number):
    with pytest.raises(BadInput, match="allowed: random:0 to random:4294967295"):
        load(f"random:{number}")


def test_an_override_of_one_is_refused_as_of_any_other():
    with pytest.raises(
        BadInput, match=r"Scenario random:7 has 1 error:\n  --set platoon.gap_m=1.0: platoon.gap_m = 1.0"
    ):
        load("random:7", ["platoon.gap_m=1.0"])


def test_a_sine_never_leaves_the_range_by_rounding():
    for hundredths in range(-50, 51):
        mean = hundredths / 100
        assert abs(mean) + round(1.0 - abs(mean), 2) <= 1.0
