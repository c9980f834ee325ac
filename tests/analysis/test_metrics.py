"""The figures of a run against cases worked out by hand."""

import json
import warnings

import numpy as np
import pytest

from bench.analysis.boundary import margin
from bench.analysis.metrics import compute
from bench.analysis.requirements import table
from bench.errors import BadInput
from bench.record import Run

from .conftest import GAP, SPEED, Motions, write

ISSUE_KEYS = {
    *("formation_time_s", "least_distance_m", "final_gaps_m", "final_speeds_mps", "final_lateral_errors_m"),
    *("final_yaws_rad", "boundary_margin_min", "speed_rmse_mps", "yaw_rate_rmse_radps", "solver_ms", "planner_ms"),
    *("fallback_steps", "frames_lost", "real_time_factor"),
}


def test_a_platoon_in_formation_all_the_way(run_of):
    figures = compute(run_of(Motions(3, 100)))
    assert figures.as_dict().keys() >= ISSUE_KEYS
    assert json.loads(json.dumps(figures.as_dict())) == figures.as_dict()
    assert (figures.scenario, figures.vehicles, figures.duration_s) == ("made-up", 3, 1.0)
    assert figures.complete
    assert figures.formed
    assert figures.formation_time_s == 0.0
    assert figures.least_distance_m == pytest.approx(GAP)
    assert figures.final_gaps_m == pytest.approx([GAP, GAP])
    assert figures.final_speeds_mps == [SPEED] * 3
    assert figures.final_lateral_errors_m == [0.0] * 3
    assert figures.final_yaws_rad == [0.0] * 3
    assert figures.boundary_margin_min == 1.0
    assert figures.real_time_factor == pytest.approx(2.0)
    assert (figures.fallback_steps, figures.frames_lost, figures.e2e_errors) == (0, 0, 0)


# Each band's edge, as the issue defines it: gap and speed within, lateral error and yaw below.
@pytest.mark.parametrize(
    ("name", "inside", "outside"),
    [("X", 0.499, 0.501), ("v_x", -0.199, 0.201), ("Y", 0.1999, -0.2001), ("psi", -0.00999, 0.01001)],
)
def test_formed_is_from_when_on_the_last_band_is_kept(run_of, name, inside, outside):
    motions = Motions(2, 100)
    values = getattr(motions, name)
    values[0] += inside
    values[0, :37] += outside - inside
    assert compute(run_of(motions)).formation_time_s == 0.37


def test_leaving_the_band_again_starts_anew(run_of):
    motions = Motions(2, 100)
    motions.v_x[1, :20] = 18.0
    motions.psi[0, 80] = 0.02
    assert compute(run_of(motions)).formation_time_s == 0.81


def test_out_of_the_band_at_the_end_is_not_formed(run_of):
    motions = Motions(2, 100)
    motions.Y[1, -1] += 0.25
    figures = compute(run_of(motions))
    assert figures.formation_time_s is None
    assert not figures.formed
    assert figures.final_lateral_errors_m == pytest.approx([0.0, 0.25])


def test_gaps_follow_the_slots_and_not_the_vehicles_numbers(run_of):
    motions = Motions(3, 10)
    motions.X[[0, 1, 2]] = motions.X[[1, 2, 0]]
    motions.X[0] += 0.3
    for vehicle, slot in ((1, 2), (2, 3), (3, 1)):
        motions.say(vehicle, "PlannerStatus", Slot=np.full(10, slot))
    assert compute(run_of(motions)).final_gaps_m == pytest.approx([GAP - 0.3, GAP + 0.3])


def test_without_slots_the_order_is_that_of_the_start(run_of):
    motions = Motions(3, 10)
    motions.X[[0, 1, 2]] = motions.X[[1, 2, 0]]
    for vehicle in (1, 2, 3):
        motions.say(vehicle, "PlannerStatus", Slot=np.zeros(10))
    assert compute(run_of(motions)).final_gaps_m == pytest.approx([GAP, GAP])


def test_least_distance_is_across_the_road_too_and_over_all_pairs(run_of):
    motions = Motions(3, 50)
    # Vehicles 1 and 3 side by side for a moment: 3 m along, 4 m across.
    motions.X[2, 20], motions.Y[2, 20] = motions.X[0, 20] - 3.0, 7.0 + 4.0
    assert compute(run_of(motions)).least_distance_m == pytest.approx(5.0)


def test_a_single_vehicle_has_no_distance_and_no_gap(run_of):
    figures = compute(run_of(Motions(1, 50)))
    assert figures.least_distance_m is None
    assert figures.final_gaps_m == []
    assert figures.formation_time_s == 0.0


def test_the_margin_takes_the_smaller_adhesion(run_of):
    motions = Motions(2, 50)
    # gamma_max = 0.85 * 0.8 * 9.8 / 20 = 0.3332 rad/s at the planner's mu, half of it on a road of 0.4.
    motions.gamma[0, 10] = -0.1666
    assert compute(run_of(motions)).boundary_margin_min == pytest.approx(0.5)


@pytest.mark.parametrize(("mu", "margin"), [(0.4, 0.0), (0.2, -1.0), (1.2, 0.5)])
def test_the_margin_on_other_roads(run_of, mu, margin):
    motions = Motions(2, 50)
    motions.gamma[1, 10] = 0.1666
    motions.mu[:] = mu
    assert compute(run_of(motions)).boundary_margin_min == pytest.approx(margin)


def refer(motions, vehicle, speed, rate):
    """Have a planner send what its vehicle is to do: a reference is for the cycle after the one it is sent in."""
    told = {"VelocityX": np.roll(speed, -1), "YawRate": np.roll(rate, -1), "ReferenceState": np.ones(len(speed))}
    motions.say(vehicle, "Reference", **told)


def test_tracking_errors_are_against_the_reference_of_the_same_cycle(run_of):
    motions = Motions(2, 100)
    ramp = 20.0 + 0.01 * np.arange(100)
    motions.v_x[0] = ramp + 0.1
    motions.gamma[1] = 0.02
    for vehicle, speed, rate in ((1, ramp, 0.0), (2, np.full(100, 20.0), 0.05)):
        refer(motions, vehicle, speed, np.full(100, rate))
        # What the tracker makes of it does not matter: most trackers do not say.
        motions.say(vehicle, "TrackerReferenceState", VelocityX=np.zeros(100))
    figures = compute(run_of(motions))
    assert figures.speed_rmse_mps == pytest.approx([0.1, 0.0], abs=1e-9)
    assert figures.yaw_rate_rmse_radps == pytest.approx([0.0, 0.03], abs=1e-9)


def test_only_cycles_with_a_reference_that_is_to_be_used_count(run_of):
    motions = Motions(1, 100)
    begun = np.arange(100) >= 30
    motions.say(1, "Reference", VelocityX=np.where(begun, 19.0, 0.0), ReferenceState=begun * 1.0)
    assert compute(run_of(motions)).speed_rmse_mps == pytest.approx([1.0])


def test_without_a_reference_there_is_no_tracking_error(run_of):
    motions = Motions(2, 100)
    refer(motions, 2, np.full(100, 20.0), np.zeros(100))
    run = run_of(motions)
    figures = compute(run)
    assert figures.speed_rmse_mps == [None, 0.0]
    assert figures.yaw_rate_rmse_radps == [None, 0.0]
    rows = {row.name: row for row in table(figures, run.scenario)}
    assert rows["Speed error, RMS"].value == "not sent, 0.0000\u00a0m/s"


def test_what_no_ecu_has_sent_is_none_and_neither_good_nor_bad(tmp_path):
    """Of a tracker that runs, but says nothing of a solver, nor of its times, nor of its reception."""
    motions = Motions(1, 50)
    motions.say(1, "TrackerStatus", State=np.ones(50))
    motions.silent = {(1, "TrackerTiming"), (1, "TrackerBusHealth"), (1, "PlannerTiming")}
    run = Run(write(tmp_path / "run.mcap", motions))
    figures = compute(run)
    told = json.loads(json.dumps(figures.as_dict()))
    names = (
        "solver_ms",
        "tracker_ms",
        "planner_ms",
        "riccati_steps",
        "sdp_steps",
        "fallback_steps",
        "frames_lost",
        "e2e_errors",
    )
    assert [told[name] for name in names] == [None] * 8
    assert told["speed_rmse_mps"] == [None]
    unsaid = [row for row in table(figures, run.scenario) if row.value == "not sent"]
    assert len(unsaid) == 10
    assert {row.met for row in unsaid} == {None}


def test_what_is_known_to_be_lost_counts_even_if_others_say_nothing(tmp_path):
    motions = Motions(1, 50)
    motions.silent = {(1, "TrackerBusHealth")}
    motions.say(1, "PlantBusHealth", FramesLost=np.full(50, 3))
    figures = compute(Run(write(tmp_path / "run.mcap", motions)))
    assert (figures.frames_lost, figures.e2e_errors) == (3, None)


def test_a_run_of_one_cycle_is_complete(run_of):
    figures = compute(run_of(Motions(1, 1)))
    assert figures.complete
    assert figures.duration_s == pytest.approx(0.01)
    assert figures.real_time_factor == pytest.approx(0.02)


def test_times_of_solvers_over_all_vehicles(run_of):
    motions = Motions(2, 100)
    motions.say(1, "TrackerTiming", SolveTime=np.full(100, 1500.0), StepTime=np.full(100, 2000.0))
    motions.say(2, "TrackerTiming", SolveTime=np.full(100, 2500.0), StepTime=np.full(100, 3000.0))
    # Between its optimisations the planner reports no time of 0: every step takes some.
    motions.say(1, "PlannerTiming", StepTime=np.arange(1.0, 101.0) * 100.0)
    run = run_of(motions)
    figures = compute(run)
    assert figures.solver_ms == pytest.approx({"p50": 2.0, "p99": 2.5, "longest_in_ms": 50.0})
    assert figures.tracker_ms == pytest.approx({"p50": 2.5, "p99": 3.0, "longest_in_ms": 50.0})
    values = {row.name: row.value for row in table(figures, run.scenario)}
    assert values["Solver, median / p99"] == "2.00 / 2.50 ms (longest in 50 ms)"
    assert figures.planner_ms["p50"] == pytest.approx(5.05)


def test_steps_are_counted_by_the_source_of_their_gain(run_of):
    motions = Motions(2, 100)
    source, status = np.zeros(100), np.zeros(100)
    source[10:14] = [1, 2, 3, 1]
    source[20:50] = 4
    # A tracker that did not solve at all, as before its first reference, is not in a fallback.
    source[0], status[0] = 3, 6
    motions.say(1, "TrackerStatus", GainSource=source, SolverStatus=status)
    motions.say(2, "TrackerStatus", GainSource=np.zeros(100), SolverStatus=np.zeros(100))
    figures = compute(run_of(motions))
    assert (figures.riccati_steps, figures.sdp_steps, figures.fallback_steps) == (30, 165, 4)


def test_lost_frames_and_refused_ones_are_summed_over_all_ecus(run_of):
    motions = Motions(2, 20)
    rising = np.minimum(np.arange(20), 5)
    motions.say(1, "PlantBusHealth", FramesLost=rising, E2EErrors=rising * 2)
    motions.say(2, "TrackerBusHealth", FramesLost=rising)
    figures = compute(run_of(motions))
    assert (figures.frames_lost, figures.e2e_errors) == (10, 10)


def test_frames_the_conductor_lost_count_too(run_of):
    ended = {"status": "completed", "cycles": "20", "wall_s": "1", "frames_lost": "3"}
    assert compute(run_of(Motions(1, 20), result=ended)).frames_lost == 3


@pytest.mark.parametrize("text", ["inf", "-inf", "nan", "1e999", "9" * 5000, "\u00b2", "x", ""])
def test_a_result_that_is_no_number_counts_as_none(run_of, text):
    """A log can be of anybody."""
    found = compute(run_of(Motions(1, 20), result={"frames_lost": text, "cycles": text, "wall_s": text}))
    assert (found.frames_lost or 0) == 0
    json.dumps(found.as_dict(), allow_nan=False)


def test_a_run_that_was_cut_off_is_not_complete(run_of, tmp_path):
    path = run_of(Motions(3, 200)).path
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.warns(UserWarning, match="ends before its summary"):
        run = Run(cut)
    figures = compute(run)
    assert not figures.complete
    assert figures.real_time_factor is None
    assert 0.2 < figures.duration_s < 1.8


def test_a_log_without_truth_is_refused(run_of, tmp_path):
    path = run_of(Motions(1, 20)).path
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(path.read_bytes()[:3000])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        run = Run(cut)
    with pytest.raises(BadInput, match="no topic /truth/veh1"):
        compute(run)


def test_the_real_formation_is_what_the_issue_asks_for(formation):
    figures = compute(formation)
    assert figures.complete
    assert figures.formation_time_s < 6.5
    assert figures.least_distance_m > 4.0
    assert figures.final_gaps_m == pytest.approx([10.0, 10.0], abs=0.2)
    assert figures.final_speeds_mps == pytest.approx([20.0] * 3, abs=0.1)
    assert figures.boundary_margin_min > 0.0
    assert figures.solver_ms["p50"] > 0.0


def test_without_adhesion_there_is_no_finite_margin_and_no_warning():
    """A damaged log may say that."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = margin(np.array([0.0, 0.1]), np.array([20.0, 20.0]), np.array([0.0, 0.0]))
    assert not np.isfinite(found).any()
