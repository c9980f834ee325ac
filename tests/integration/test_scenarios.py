"""Every shipped scenario in closed loop: the paper's controllers, the real FMU, real frames, a real log."""

from pathlib import Path

import numpy as np
import pytest

from bench.analysis.metrics import compute
from bench.bus.codec import MAX_VEHICLES
from bench.bus.link.address import Address
from bench.conductor.options import RunOptions
from bench.conductor.run import run
from bench.record.compare import diff
from bench.record.reader import Run
from bench.scenario import load, shipped
from tests.conftest import Tries


def recorded(folder: Path, name: str, *overrides: str, can: str = "direct") -> Run:
    """The log of a run of a scenario."""
    out = folder / f"{name}-{can}-{len(list(folder.iterdir()))}.mcap"
    run(RunOptions(load(name, overrides), address=Address.parse(can), out=out, command_line=[name, *overrides]))
    return Run(out)


@pytest.mark.parametrize("name", shipped())
def test_forms_a_platoon_inside_the_boundaries(name: str, tmp_path: Path, tries: Tries) -> None:
    """Within 7 s; in the long form over all the time that the scenario has."""
    whole_s = load(name).duration_s
    duration_s = tries(min(7.0, whole_s), whole_s)
    figures = compute(recorded(tmp_path, name, f"duration_s={duration_s}"))

    assert figures.least_distance_m is not None
    assert figures.least_distance_m > 4.0
    assert figures.final_gaps_m == pytest.approx([10.0] * (figures.vehicles - 1), abs=0.2)
    assert figures.final_speeds_mps == pytest.approx([20.0] * figures.vehicles, abs=0.1)
    assert np.abs(figures.final_lateral_errors_m).max() < 0.15
    assert np.abs(figures.final_yaws_rad).max() < 0.01
    assert figures.boundary_margin_min > 0.0
    assert figures.fallback_steps == 0
    assert figures.frames_lost == figures.e2e_errors == 0
    assert figures.formation_time_s is not None
    # The paper shows 6 s.
    assert figures.formation_time_s <= 6.0
    # Over the whole time, if there were no error after the part of it that was run.
    share = (duration_s / whole_s) ** 0.5
    assert max(value for value in figures.speed_rmse_mps if value is not None) * share <= 0.05
    assert max(value for value in figures.yaw_rate_rmse_radps if value is not None) * share <= 0.0145


def offsets(log: Run) -> tuple[float, float]:
    """Mean tracking errors (m/s, rad/s) of vehicle 1 over the last 2 s."""
    truth = log.truth(1)
    last = truth["t"] >= truth["t"][-1] - 2.0
    errors = []
    for signal, actual in (("VelocityX", "v_x"), ("YawRate", "gamma")):
        t, reference = log.signal("veh1", "TrackerReferenceState", signal)
        errors.append(abs(float(np.mean((truth[actual] - np.interp(truth["t"], t, reference))[last]))))
    return errors[0], errors[1]


NIGHTLY = pytest.mark.nightly


@pytest.mark.parametrize("stiffness", [-1.0, pytest.param(0.0, marks=NIGHTLY), pytest.param(1.0, marks=NIGHTLY)])
def test_a_side_wind_leaves_no_offset(stiffness: float, tmp_path: Path) -> None:
    alone = "vehicles=[{x_m=0.0,y_m=7.0,speed_mps=20.0}]"
    axles = [f"road.lambda_f={stiffness}", f"road.lambda_r={stiffness}"]
    log = recorded(tmp_path, "crosswind", alone, *axles)
    without = recorded(tmp_path, "crosswind", alone, *axles, "tracker.offset_free=false")

    for with_estimate, without_estimate in zip(offsets(log), offsets(without), strict=True):
        assert with_estimate < 0.05 * without_estimate
    assert abs(log.truth(1)["Y"][-1] - 7.0) < 0.05


def test_the_seed_decides_the_frames(tmp_path: Path) -> None:
    short = ("duration_s=1.5",)
    first = recorded(tmp_path, "formation", *short).path
    again = recorded(tmp_path, "formation", *short).path
    other = recorded(tmp_path, "formation", *short, "seed=2").path

    assert diff(first, again).same
    assert not diff(first, other).same


def test_ten_vehicles_are_the_same_with_processes_of_their_own(tmp_path: Path) -> None:
    """Twenty ECUs and a plant over udp; no frame is lost."""
    short = ("duration_s=0.12",)
    log = recorded(tmp_path, "ten", *short, can="udp")
    assert diff(log.path, recorded(tmp_path, "ten", *short).path).same
    assert (log.vehicles, log.result["cycles"]) == (10, "12")
    assert compute(log).frames_lost == 0
    assert len(log.message("v2v", "V2VPosition_10")["t"]) == 12


def test_as_many_vehicles_as_the_radio_takes_take_their_slots(tmp_path: Path) -> None:
    starts = [
        f"{{x_m={-9.0 * place},y_m={3.5 * (place % 2)},speed_mps={20.0 + place % 3}}}" for place in range(MAX_VEHICLES)
    ]
    log = recorded(tmp_path, "ten", f"vehicles=[{','.join(starts)}]", "duration_s=0.05")
    slots = [log.signal(f"veh{number}", "PlannerStatus", "Slot")[1][-1] for number in range(1, MAX_VEHICLES + 1)]
    assert slots == list(range(1, MAX_VEHICLES + 1))
