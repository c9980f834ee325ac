"""Comfort, steering and energy against cases worked out by hand."""

import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from typer.testing import CliRunner

from bench.analysis.comfort import energies, rate_rms, reversals
from bench.analysis.metrics import compute
from bench.analysis.report import data_of
from bench.analysis.requirements import Group, table
from bench.cli.main import app
from bench.control.comfort import ISO_LIMITS
from bench.cycle import CYCLE_S
from bench.errors import BadInput
from bench.record import Run
from platoon_fmu.parameters import VehicleParameters

from .conftest import TRUTH_NAMES, WHEELS, Motions, write

OWN = [
    "planner.comfort.lateral_acceleration_mps2=2.0",
    "planner.comfort.lateral_jerk_mps3=3.5",
    "planner.comfort.longitudinal_acceleration_mps2=2.5",
    "planner.comfort.longitudinal_jerk_mps3=4.0",
]
"""Limits of comfort that are not the standard's."""


def shaped(vehicles=2, cycles=400, **more):
    """Made-up motion with ground truth given for the last vehicle, 0 for the others."""
    motions = Motions(vehicles, cycles)
    for name, values in more.items():
        motions.more[name] = np.zeros((vehicles, cycles))
        motions.more[name][-1] = values
    return motions


def test_limits_are_those_of_iso_11270():
    assert (ISO_LIMITS.lateral_acceleration_mps2, ISO_LIMITS.lateral_jerk_mps3) == (3.0, 5.0)
    assert (ISO_LIMITS.longitudinal_acceleration_mps2, ISO_LIMITS.longitudinal_jerk_mps3) == (3.0, 5.0)


def test_the_largest_accelerations_are_of_either_side(run_of):
    t = np.arange(400) * CYCLE_S
    motions = shaped(a_x=np.where(t < 1.0, 1.5, np.where(t < 2.0, -2.5, 0.0)), a_y=np.where(t < 3.0, 0.5, -0.7))
    found = compute(run_of(motions)).comfort
    assert found.acceleration_max_mps2 == pytest.approx([0.0, 1.5])
    assert found.braking_max_mps2 == pytest.approx([0.0, 2.5])
    assert found.lateral_acceleration_max_mps2 == pytest.approx([0.0, 0.7])


def test_jerk_is_averaged_over_half_a_second(run_of):
    """A step of 2 m/s^2 within one cycle is 4 m/s^3 over 0.5 s; a ramp of 6 m/s^3 is that from 0.5 s on."""
    t = np.arange(400) * CYCLE_S
    motions = shaped(a_x=np.where(t < 1.0, 0.0, -2.0), a_y=np.clip(6.0 * (t - 1.0), 0.0, 6.0))
    run = run_of(motions)
    found = compute(run).comfort
    assert found.longitudinal_jerk_max_mps3 == pytest.approx([0.0, 4.0])
    assert found.lateral_jerk_max_mps3 == pytest.approx([0.0, 6.0])
    felt = run.comfort(2)
    assert np.isnan(felt["jerk_y"][:50]).all()
    # At 1.25 s half of the window is on the ramp.
    assert felt["jerk_y"][[50, 125, 150, 200, 225, 250]] == pytest.approx([0.0, 3.0, 6.0, 6.0, 3.0, 0.0], abs=1e-9)
    assert list(felt) == ["t", "a_x", "a_y", "jerk_x", "jerk_y", "weighted_x", "weighted_y"]


def test_a_run_too_short_for_jerk_has_none(run_of):
    found = compute(run_of(shaped(cycles=50, a_y=1.0))).comfort
    assert found.lateral_jerk_max_mps3 == [None, None]
    assert found.lateral_acceleration_max_mps2 == pytest.approx([0.0, 1.0])


def test_the_weighted_rms_is_that_of_the_standard(run_of):
    """1 Hz to the side is weighted with 1.011, 4 Hz forward with 0.512, and both are added as vectors."""
    t = np.arange(3000) * CYCLE_S
    found = compute(run_of(shaped(1, 3000, a_x=np.sin(8.0 * np.pi * t), a_y=2.0 * np.sin(2.0 * np.pi * t)))).comfort
    assert found.weighted_rms_x_mps2 == pytest.approx([0.512 / math.sqrt(2.0)], rel=0.01)
    assert found.weighted_rms_y_mps2 == pytest.approx([2.0 * 1.011 / math.sqrt(2.0)], rel=0.01)
    assert found.weighted_rms_mps2 == pytest.approx([math.hypot(0.512, 2.022) / math.sqrt(2.0)], rel=0.01)


@pytest.mark.parametrize(
    ("angles_mrad", "expected"),
    [
        ([], 0),
        ([0], 0),
        ([0, 5, 10, 20], 0),
        # There and back; a lane change; one that overshoots.
        ([0, 10, 0], 1),
        ([0, 10, -10, 0], 2),
        ([0, 10, -10, 3, 0], 3),
        # Not more than the gap.
        ([0, 1.9, 0, 1.9, 0], 0),
        ([0, 2.1, 0, 2.1, 0], 3),
        # Dither on a swing is none, and slow drift back is one.
        ([0, 4, 3, 8, 6.5, 12, 10.5, 15], 0),
        ([0, 10, 9, 8, 7, 6], 1),
        # A swing with pauses is one swing.
        ([0, 5, 5, 10, 10, 15, 0], 1),
        # First to one side by less than the gap, then to the other by less, together by more.
        ([0, -1.5, 1.5, -1.5], 1),
        ([1, -0.5, 1, 5, 2], 1),
    ],
)
def test_reversals_are_turning_points_between_swings_of_more_than_the_gap(angles_mrad, expected):
    angles = 1e-3 * np.array(angles_mrad, float)
    assert reversals(angles) == expected
    assert reversals(-angles) == expected
    assert reversals(np.repeat(angles, 3) + 0.1) == expected


@given(st.lists(st.integers(-40, 40), min_size=1, max_size=30), st.integers(1, 30))
def test_reversals_are_those_of_the_longest_chain_of_swings(angles, gap):
    """The most turning points that can be chosen such that each swing between them is larger than the gap."""
    up, down = [0] * len(angles), [0] * len(angles)
    for j, value in enumerate(angles):
        for i in range(j):
            if value - angles[i] > gap:
                up[j] = max(up[j], down[i] + 1)
            if angles[i] - value > gap:
                down[j] = max(down[j], up[i] + 1)
    assert reversals(np.array(angles, float), gap) == max(0, max(up + down) - 1)


def test_the_rate_of_the_steering_is_its_change_over_the_time_it_took():
    t = np.arange(101) * CYCLE_S
    assert rate_rms(t, 0.3 * t) == pytest.approx(0.3)
    # Half of the time 0.4 rad/s; rows that are missing do not matter while the rate is constant.
    angle = np.maximum(0.0, 0.4 * (t - 0.5))
    assert rate_rms(t, angle) == pytest.approx(0.4 / math.sqrt(2.0))
    kept = np.delete(np.arange(101), [10, 11, 70, 71, 72])
    assert rate_rms(t[kept], angle[kept]) == pytest.approx(0.4 / math.sqrt(2.0))
    assert math.isnan(rate_rms(t[:1], angle[:1]))


def test_energy_is_driven_and_braked_wheel_by_wheel():
    t = np.arange(3) * CYCLE_S
    torque = np.array([[0.0, 100.0, -50.0], [9.0, -100.0, -50.0]])
    spin = np.array([[60.0, 62.0, 64.0], [60.0, 62.0, 64.0]])
    driven, braked = energies(t, torque, spin)
    assert driven == pytest.approx(100.0 * 61.0 * CYCLE_S)
    assert braked == pytest.approx((100.0 * 61.0 + 2.0 * 50.0 * 63.0) * CYCLE_S)


def test_energy_of_a_run_is_over_all_wheels(run_of):
    more = {f"omega_{wheel}": 60.0 for wheel in WHEELS} | {f"wheel_torque_{wheel}": 50.0 for wheel in WHEELS}
    found = compute(run_of(shaped(2, 101, **more))).comfort
    assert found.driven_energy_j == pytest.approx([0.0, 4.0 * 50.0 * 60.0 * 1.0])
    assert found.braked_energy_j == [0.0, 0.0]


def test_the_energy_of_the_real_run_is_what_wheels_and_road_took(formation):
    """A wheel's spin changes by torque less tyre force: what is driven less what is braked is in these two."""
    car, found = VehicleParameters(), compute(formation).comfort
    for vehicle, net in enumerate(np.subtract(found.driven_energy_j, found.braked_energy_j), start=1):
        truth = formation.truth(vehicle)
        taken = 0.0
        for wheel in WHEELS:
            spin, force = truth[f"omega_{wheel}"], truth[f"F_x_{wheel}"]
            taken += 0.5 * car.I_w * (spin[-1] ** 2 - spin[0] ** 2)
            taken += car.R_w * float(np.trapezoid(force * spin, truth["t"]))
        assert abs(net) > 1e3
        assert net == pytest.approx(taken, rel=0.01)


def test_the_accelerations_of_the_real_run_are_the_derivatives_of_its_speeds(formation):
    for vehicle in (1, 2, 3):
        truth, felt = formation.truth(vehicle), formation.comfort(vehicle)
        a_y = np.gradient(truth["v_y"], truth["t"]) + truth["gamma"] * truth["v_x"]
        a_x = np.gradient(truth["v_x"], truth["t"]) - truth["gamma"] * truth["v_y"]
        assert felt["a_y"][2:-2] == pytest.approx(a_y[2:-2], abs=0.15)
        assert felt["a_x"][2:-2] == pytest.approx(a_x[2:-2], abs=0.15)


def test_comfort_is_shown_against_its_limits_and_is_no_verdict(run_of):
    run = run_of(shaped(2, 400, a_y=3.01, a_x=3.0))
    rows = {row.name: row for row in table(compute(run), run.scenario) if row.group is Group.COMFORT}
    assert rows["Lateral acceleration, largest"].value == "0.00, 3.01\u00a0m/s²"
    assert rows["Lateral acceleration, largest"].requirement == "at most 3\u00a0m/s²"
    assert rows["Lateral acceleration, largest"].met is False
    assert rows["Acceleration, largest"].met is True
    assert rows["Steering reversals over 2 mrad"].value == "0, 0"
    assert len(rows) == 12


def test_a_run_is_shown_against_the_limits_of_its_scenario(run_of):
    run = run_of(shaped(2, 400, a_y=2.1, a_x=2.4), overrides=OWN)
    rows = {row.name: row for row in table(compute(run), run.scenario)}
    shown = {
        "Lateral acceleration, largest": ("at most 2\u00a0m/s²", False),
        "Lateral jerk, largest 0.5 s mean": ("at most 3.5\u00a0m/s³", True),
        "Acceleration, largest": ("at most 2.5\u00a0m/s²", True),
        "Braking, largest": ("at most 2.5\u00a0m/s²", True),
        "Longitudinal jerk, largest 0.5 s mean": ("at most 4\u00a0m/s³", True),
    }
    assert {name: (rows[name].requirement, rows[name].met) for name in shown} == shown
    lines = {each["id"]: each["lines"] for each in data_of(run)["figures"] if each["group"] == "Comfort"}
    assert {name: [line["y"] for line in each] for name, each in lines.items()} == {
        **{"ay": [2.0, -2.0], "ax": [2.5, -2.5], "jerky": [3.5, -3.5], "jerkx": [4.0, -4.0]}
    }
    text = " ".join(CliRunner().invoke(app, ["metrics", str(run.path)]).stdout.split())
    assert "2.10 !" in text
    assert "2.40 !" not in text
    assert "│ limit │ 2 │ 3.5 │ 2.5 │ 2.5 │ 4 │" in text


def test_a_run_whose_limits_are_switched_off_is_shown_against_none(run_of):
    run = run_of(shaped(2, 400, a_y=9.0), overrides=["planner.comfort.enabled=false"])
    metrics = compute(run)
    assert metrics.comfort.limits == {}
    rows = {row.name: row for row in table(metrics, run.scenario) if row.group is Group.COMFORT}
    assert rows["Lateral acceleration, largest"].value == "0.00, 9.00\u00a0m/s²"
    assert {(row.requirement, row.met) for row in rows.values()} == {("", None)}
    figures = [figure for figure in data_of(run)["figures"] if figure["group"] == "Comfort"]
    assert [figure["lines"] for figure in figures] == [[]] * 4
    done = CliRunner().invoke(app, ["metrics", str(run.path)])
    assert "9.00" in done.stdout
    assert "!" not in done.stdout
    assert "limit of comfort" not in " ".join(done.stdout.split())
    told = json.loads(CliRunner().invoke(app, ["metrics", str(run.path), "--json"]).stdout)["comfort"]
    assert told["limits"] == {}


def test_metrics_prints_comfort_and_does_not_fail(run_of):
    run = run_of(shaped(2, 400, a_y=3.01))
    done = CliRunner().invoke(app, ["metrics", str(run.path)])
    assert done.exit_code == 0
    assert "3.01 !" in done.stdout
    assert "above the limit of comfort" in " ".join(done.stdout.split())
    told = json.loads(CliRunner().invoke(app, ["metrics", str(run.path), "--json"]).stdout)["comfort"]
    assert told["lateral_acceleration_max_mps2"] == pytest.approx([0.0, 3.01])
    assert told["steering_reversals"] == [0, 0]


def test_what_the_ground_truth_lacks_is_not_shown(tmp_path):
    names = tuple(name for name in TRUTH_NAMES if name != "a_y")
    run = Run(write(tmp_path / "old.mcap", shaped(2, 100), truth_names=names))
    metrics = compute(run)
    assert metrics.comfort is None
    assert not [row for row in table(metrics, run.scenario) if row.group is Group.COMFORT]
    assert not [figure for figure in data_of(run)["figures"] if figure["group"] == "Comfort"]
    assert CliRunner().invoke(app, ["metrics", str(run.path)]).exit_code == 0
    with pytest.raises(BadInput, match="a_y"):
        run.comfort(1)


def test_ground_truth_that_is_no_number_counts_as_none(run_of):
    """A log can be of anybody."""
    values = np.ones(400)
    values[30] = math.inf
    metrics = compute(run_of(shaped(1, 400, a_y=values, steering_angle=np.where(values > 1, np.nan, 0.0))))
    assert metrics.comfort.lateral_acceleration_max_mps2 == [None]
    assert metrics.comfort.weighted_rms_y_mps2 == [None]
    json.dumps(metrics.as_dict(), allow_nan=False)


def test_figures_of_comfort_have_the_limits_and_each_vehicle(run_of):
    data = data_of(run_of(shaped(2, 400, a_x=-4.0)))
    figures = {figure["id"]: figure for figure in data["figures"] if figure["group"] == "Comfort"}
    assert {name: [line["y"] for line in figure["lines"]] for name, figure in figures.items()} == {
        **{"ay": [3.0, -3.0], "ax": [3.0, -3.0], "jerky": [5.0, -5.0], "jerkx": [5.0, -5.0]}
    }
    for figure in figures.values():
        assert all(line["limit"] for line in figure["lines"])
        assert [curve["name"] for curve in figure["curves"]] == ["vehicle 1", "vehicle 2"]
    assert data["pool"]["2.a_x"] == [-4.0] * 400
    assert data["pool"]["2.jerk_x"][:51] == [*([None] * 50), 0.0]
