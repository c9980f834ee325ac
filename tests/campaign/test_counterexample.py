"""A counterexample made small: nothing in it can be left out or moved nearer to the base, and its file fails."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from bench.analysis.metrics import compute
from bench.bus.link.address import Address
from bench.campaign.counterexample import base_value, made_small, scenario_text, write_scenario
from bench.campaign.evaluating import Outcome
from bench.campaign.requirements import Requirement, flat_metrics
from bench.campaign.statuses import OK, REFUSED
from bench.conductor.options import RunOptions
from bench.conductor.run import run
from bench.errors import BadInput, RunFailed
from bench.record import Run
from bench.record.compare import diff
from bench.scenario import load
from tests.campaign.evaluations import ABOVE_0, METRIC, Evaluated, choice, integers, study_of, uniform

BASE = load("formation")
KEYS = ("road.lambda_f", "road.lambda_r", "road.force_y_n", "platoon.gap_m", "vehicles.0.x_m", "vehicles[1].y_m")
RANGES = (uniform(-1, 1), uniform(-1, 1), uniform(-600, 600), uniform(5, 20), uniform(0, 20), uniform(3, 4))
STUDY = study_of(*RANGES, keys=KEYS)
OF_BASE = {key: base_value(BASE, key) for key in KEYS}


def with_base(values):
    """The values with those of the base for keys that are left out."""
    return {**OF_BASE, **values}


def small(values, clearance, *, study=STUDY, workers=1):
    """The counterexample of a function of the values, and what it evaluated."""
    evaluated = Evaluated(lambda v: clearance(with_base(v)))
    return made_small(study, ABOVE_0, values, evaluated, workers=workers), evaluated


VALUES = {
    "road.lambda_f": 0.8765432,
    "road.lambda_r": -0.1234567,
    "road.force_y_n": 517.2637,
    "platoon.gap_m": 14.25413,
    "vehicles.0.x_m": 9.3712345,
    "vehicles[1].y_m": 3.2345678,
}


@pytest.mark.parametrize("workers", [1, 2, 7])
def test_what_does_not_matter_is_left_out_and_what_does_is_moved_to_its_limit(workers):
    found, evaluated = small(VALUES, lambda v: 314.159 - v["road.force_y_n"], workers=workers)
    assert found.values == {"road.force_y_n": 315.0}
    (change,) = found.changes
    assert (change.key, change.base, change.value) == ("road.force_y_n", 0.0, 315.0)
    assert found.outcome.metrics[METRIC] == pytest.approx(-0.841)
    assert found.evaluations == len(evaluated.values) < 60


def test_values_that_matter_only_together_stay_both():
    found, _ = small(VALUES, lambda v: 1.0 - v["road.lambda_f"] - v["road.force_y_n"] / 1000.0)
    assert set(found.values) == {"road.lambda_f", "road.force_y_n"}
    assert 1.0 <= found.values["road.lambda_f"] + found.values["road.force_y_n"] / 1000.0 < 1.01


def test_all_that_can_be_left_out_together_is_even_if_each_needs_another():
    def clearance(v):
        """Fails with a force, or with both of the others: two small counterexamples."""
        return 1.0 - 2.0 * (v["road.force_y_n"] > 0 or (v["road.lambda_f"] > 0 and v["road.lambda_r"] < 0))

    found, _ = small(VALUES, clearance)
    assert set(found.values) in ({"road.force_y_n"}, {"road.lambda_f", "road.lambda_r"})


def test_a_value_can_lie_on_either_side_of_the_base():
    found, _ = small({**VALUES, "platoon.gap_m": 5.4321}, lambda v: v["platoon.gap_m"] - 6.789)
    assert found.values == {"platoon.gap_m": 6.78}


def test_a_value_at_its_limit_still_gets_few_digits():
    # Of 9.3712345 the first three digits from the base, 8, pass.
    found, _ = small(VALUES, lambda v: 9.37115 - v["vehicles.0.x_m"])
    assert found.values == {"vehicles.0.x_m": 9.3712}


def test_a_value_that_fails_only_by_all_its_digits_keeps_them():
    found, _ = small(VALUES, lambda v: abs(v["vehicles.0.x_m"] - 9.3712345) - 1e-12)
    assert found.values == {"vehicles.0.x_m": 9.3712345}


def test_failures_between_values_that_pass_are_kept():
    def clearance(v):
        return -1.0 if 300 < v["road.force_y_n"] < 400 or v["road.force_y_n"] > 500 else 1.0

    found, _ = small(VALUES, clearance)
    assert clearance(with_base(found.values)) < 0.0
    assert found.values["road.force_y_n"] in (301.0, 501.0)


def test_integers_stay_integers_and_choices_what_they_are():
    study = study_of(integers(1, 1000), choice(0.5, 0.7), uniform(0, 1), keys=("seed", "road.lambda_f", "road.mu"))

    def clearance(v):
        return -1.0 if v.get("seed", 1) >= 37 and v.get("road.lambda_f", 0.0) > 0.1 else 1.0

    values = {"seed": 773, "road.lambda_f": 0.7, "road.mu": 0.4}
    found = made_small(study, ABOVE_0, values, Evaluated(clearance))
    assert found.values == {"seed": 37, "road.lambda_f": 0.7}
    assert isinstance(found.values["seed"], int)


def test_a_table_is_left_out_as_a_whole_if_its_values_need_each_other():
    keys = ("road.lambda_f.kind", "road.lambda_f.mean", "road.lambda_f.amplitude", "road.mu")
    study = study_of(choice("sine"), uniform(), uniform(), uniform(), keys=keys)

    def clearance(v):
        table = [key for key in v if key.startswith("road.lambda_f.")]
        if len(table) not in (0, 3):
            return REFUSED
        return v.get("road.mu", 1.0) - 0.4567

    values = dict(zip(keys, ("sine", 0.1, 0.2, 0.3123), strict=True))
    assert made_small(study, ABOVE_0, values, Evaluated(clearance)).values == {"road.mu": 0.456}


def test_a_base_that_fails_is_its_own_counterexample():
    found, _ = small(VALUES, lambda _: -1.0)
    assert found.changes == ()
    assert "nothing: it fails itself" in scenario_text(STUDY, found)


def test_the_failure_stays_of_its_kind():
    """A crash is not made small to a missed limit, nor that to a crash."""

    def clearance(v):
        if v["road.force_y_n"] > 300.0:
            return "crashed" if v["platoon.gap_m"] > 12.0 else -1.0
        return 1.0

    crash, _ = small(VALUES, clearance)
    assert crash.outcome.status == "crashed"
    assert crash.values == {"road.force_y_n": 301.0, "platoon.gap_m": 12.01}
    missed, _ = small({**VALUES, "platoon.gap_m": 11.0}, clearance)
    assert missed.outcome.status == OK
    assert missed.values == {"road.force_y_n": 301.0}


def test_equalities_can_be_failed_too():
    limit = Requirement("formed", "==", 1.0)

    def evaluate(batch):
        return [Outcome(0, {"formed": v.get("road.lambda_r", 0.0) > -0.1}, OK, "") for v in batch]

    assert made_small(STUDY, limit, VALUES, evaluate).values == {"road.lambda_r": -0.1}


def test_values_that_do_not_fail_are_no_counterexample():
    with pytest.raises(RunFailed, match="run 0 does not miss least_clearance_m > 0"):
        small(VALUES, lambda _: 1.0)
    with pytest.raises(RunFailed, match="does not miss"):
        small(VALUES, lambda _: REFUSED)
    with pytest.raises(BadInput, match="another scenario in each run"):
        small(VALUES, lambda _: -1.0, study=study_of(uniform(), base="random"))


@given(
    st.lists(st.floats(0.0, 1.0), min_size=6, max_size=6),
    st.floats(0.05, 0.95),
    st.integers(1, 4),
)
@settings(max_examples=60, deadline=None)
def test_no_value_can_be_left_out_or_moved_by_a_hundredth(weights, share, workers):
    """Of a failure by the weighted sum of all distances from the base."""

    def distance(v):
        whole = with_base(v)
        return sum(
            weight * abs((whole[key] - OF_BASE[key]) / (VALUES[key] - OF_BASE[key]))
            for weight, key in zip(weights, KEYS, strict=True)
        )

    most = share * sum(weights) - 1e-9
    found, evaluated = small(VALUES, lambda v: most - distance(v), workers=workers)
    assert distance(found.values) >= most
    for change in found.changes:
        less = {key: value for key, value in found.values.items() if key != change.key}
        assert distance(less) < most
        moved = change.value - 0.01 * (VALUES[change.key] - change.base)
        assert distance({**less, change.key: moved}) < most or math.isclose(moved, change.base, rel_tol=0.01)
    texts = [repr(sorted(values.items())) for values in evaluated.values]
    assert len(set(texts)) == len(texts) == found.evaluations


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("vehicles.0.x_m", 8.0),
        ("vehicles[2].x_m", -8.0),
        ("road.lambda_f", 0.0),
        ("vehicles.0.road.mu", 0.5),
        ("vehicles.1.road.mu", 0.4),
        ("platoon.gap_m", 10.0),
        ("on_ecu_failure", "end"),
        ("road.lambda_f.amplitude", None),
        ("vehicles.7.x_m", None),
        ("platoon", None),
    ],
)
def test_the_value_of_the_base(key, value):
    scenario = load("formation", ["road.mu=0.4", "vehicles.0.road={mu=0.5}"])
    assert base_value(scenario, key) == value


def test_the_file_is_the_scenario_of_the_values_and_says_what_differs(tmp_path):
    found, _ = small(VALUES, lambda v: 314.159 - v["road.force_y_n"])
    write_scenario(STUDY, found, tmp_path / "small.toml")
    assert load(tmp_path / "small.toml") == load("formation", ["road.force_y_n=315.0"])
    text = (tmp_path / "small.toml").read_text(encoding="utf-8")
    assert text.startswith("# Counterexample to least_clearance_m > 0: least_clearance_m = -0.84")
    assert "#   road.force_y_n = 315.0 instead of 0.0\n" in text


def test_what_a_crash_said_is_a_comment_whatever_its_lines(tmp_path):
    evaluated = [Outcome(3, None, "crashed", "first\nsecond = 2")]
    found = made_small(STUDY, ABOVE_0, {"road.mu": 0.5}, lambda batch: evaluated * len(batch))
    write_scenario(STUDY, found, tmp_path / "small.toml")
    assert load(tmp_path / "small.toml") == BASE
    assert "# second = 2\n" in (tmp_path / "small.toml").read_text(encoding="utf-8")


class RealRuns:
    """Runs of a study, each with its log."""

    def __init__(self, study, folder):
        self.study, self.folder, self.count = study, folder, 0

    def log_of(self, scenario):
        self.count += 1
        log = self.folder / f"{self.count}.mcap"
        run(RunOptions(scenario, Address.parse("direct"), log, ["test"]))
        return log

    def __call__(self, batch):
        return [self.outcome(values) for values in batch]

    def outcome(self, values):
        try:
            scenario = self.study.scenario(0, values)
        except BadInput as error:
            return Outcome(self.count, None, REFUSED, str(error))
        log = self.log_of(scenario)
        return Outcome(self.count, flat_metrics(compute(Run(log)), scenario), OK, "")


def test_a_counterexample_of_real_runs_fails_by_itself_with_the_same_bytes(tmp_path):
    base = tmp_path / "short.toml"
    base.write_text(load("formation", ["duration_s=1.0"]).toml(), encoding="utf-8")
    keys = ("vehicles.0.x_m", "vehicles.2.x_m", "road.slope_rad", "vehicles.1.speed_mps")
    study = study_of(uniform(4, 12), uniform(-9, -2), uniform(-0.02, 0.02), uniform(21, 23), base=str(base), keys=keys)
    limit = Requirement("least_clearance_m", ">", 2.0)
    runs = RealRuns(study, tmp_path)
    values = {"vehicles.0.x_m": 7.7123, "vehicles.2.x_m": -2.7182, "road.slope_rad": 0.01, "vehicles.1.speed_mps": 22.5}
    found = made_small(study, limit, values, runs)
    assert set(found.values) == {"vehicles.2.x_m"}
    assert -8.0 < found.values["vehicles.2.x_m"] < -2.7182
    write_scenario(study, found, tmp_path / "small.toml")
    again = runs.log_of(load(tmp_path / "small.toml"))
    metrics = flat_metrics(compute(Run(again)), load(tmp_path / "small.toml"))
    assert limit.met(metrics) is False
    assert diff(again, tmp_path / f"{found.outcome.number}.mcap").same
    # A hundredth of the distance nearer to the base, it is met.
    nearer = found.values["vehicles.2.x_m"] - 0.01
    assert limit.met(runs.outcome({"vehicles.2.x_m": nearer}).metrics)
