"""The command `platoon` as a user calls it, by its output and its exit code: in a process of its own.

What is refused before anything starts is so in this process.
"""

import json
import os
import subprocess
import sys
import tomllib
import zipfile
from pathlib import Path

import pytest

from bench.faults.kinds import kinds
from bench.record import Run
from bench.scenario import load, shipped
from tests.cli.conftest import TERMINAL

ROOT = Path(__file__).parents[2]
SHORT = ["--can", "direct", "--set", "duration_s=0.2"]


def platoon(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    """Call the command in a directory; no colours, a wide terminal."""
    environment = {**os.environ, **TERMINAL, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "bench.cli", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False, cwd=cwd, env=environment, timeout=300)


@pytest.fixture(scope="module")
def platoon_log(tmp_path_factory):
    """The log of a platoon that has been formed from the start."""
    folder = tmp_path_factory.mktemp("platoon")
    arguments = ["--set", "road.force_y_n=0.0", "--out", "run.mcap"]
    done = platoon("run", "crosswind", *SHORT, *arguments, cwd=folder)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder / "run.mcap", done


# run


def test_run_shows_progress_figures_and_paths(platoon_log):
    log, done = platoon_log
    assert "crosswind: 0.2 of 0.2 s simulated" in done.stderr
    for figure in ("formation time", "least distance", "final gaps", "boundary margin", "solver", "real-time factor"):
        assert figure in done.stdout
    assert "log:    run.mcap" in done.stdout
    assert "report: run.html" in done.stdout
    assert log.stat().st_size > 0
    assert log.with_suffix(".html").stat().st_size > 0


def test_run_writes_to_logs_by_default_and_fails_where_no_platoon_was_formed(tmp_path):
    done = platoon("run", *SHORT, "--no-report", cwd=tmp_path)
    assert done.returncode == 1
    assert "formation did not form a platoon in 0.2 s" in done.stderr
    assert "not formed" in done.stdout
    (log,) = (tmp_path / "logs").iterdir()
    assert log.name.startswith("formation-")
    assert log.suffix == ".mcap"


def test_it_tells_the_projects_version(tmp_path):
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert platoon("--version", cwd=tmp_path).stdout == f"platoon {project['version']}\n"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["formtion"], "Did you mean formation?"),
        (
            ["--set", "platoon.gap_m=-10.0"],
            "platoon.gap_m = -10.0 is not allowed; allowed: a finite number from 5 to 100",
        ),
        (["--set", "platoon.gapm=9"], "did you mean platoon.gap_m?"),
        (
            ["--set", "vehicles.1.x_m=8.0", "--set", "vehicles.1.y_m=0.0"],
            "(vehicle 2) starts 1.80 m inside the body of vehicle 1",
        ),
        (["--set", "planner.near_identity_length_m=0.1"], "planner.near_identity_length_m is not allowed"),
        (["--set", "nonsense"], "--set nonsense: expected KEY=VALUE"),
        (["--seed", "-1"], "seed = -1 is not allowed"),
        (["--seed", "one"], "Invalid value for '--seed': Input should be a valid integer"),
        (["--can", "carrier-pigeon"], "--can carrier-pigeon: not a bus; allowed: udp"),
        (["--clock", "sundial"], "--clock sundial: no such clock; allowed: lockstep"),
        (["--ecu", "tracker"], "--ecu tracker: write ROLE=CLASS"),
        (["--ecu", "tracker=no.such.module:Tracker", "--can", "direct"], "no.such.module"),
        (["--ecu", "tracker=no.such.module:Tracker"], "no.such.module"),
        (["--ecu", "tracker=json:dumps"], "json has no class dumps"),
        (["--without", "veh9.tracker", "--can", "direct"], "veh9.tracker"),
        (["--without", "veh1.tracker", "--can", "direct"], "--can direct runs everything in one process"),
        (["--without", "veh1.tracker"], "give the port: --can udp:45000 or --can veh1=udp:45000"),
        (
            ["--without", "veh1.planner", "--can", "veh1=udp:45001"],
            "the ECU must know the address of v2v; give the port",
        ),
        (
            [
                *("--without", "veh1.tracker", "--can", "udp:45000"),
                *("--set", 'faults=[{kind="ecu_hang", at_s=0.1, ecu="veh1.tracker"}]'),
            ],
            "--without veh1.tracker: the scenario has a fault ecu_hang for it",
        ),
        (["--can", "udp", "--can", "vcan"], "--can vcan: every bus already has udp"),
        (["--can", "veh4=udp"], "--can veh4=...: the scenario has the buses v2v, veh1, veh2, veh3"),
        (["--can", "veh1=can0"], "--can veh1=can0: not a bus; allowed: udp"),
        (["--can", "veh1=udp:45000@nowhere0"], "no network device nowhere0; this host has"),
        (["--set", "planner.speed_max_mps=3.0"], "planner.speed_max_mps = 3 is below planner.speed_min_mps = 5"),
        (["--set", "planner.sigma_eps=1e-308"], "planner.sigma_eps = 1e-308 is not allowed"),
        (["--set", "tracker.force_unit_n=1e-300"], "tracker.force_unit_n = 1e-300 is not allowed"),
        (["--out", "run.html"], "run.html: give a name that ends in .mcap"),
        (["--out", ""], "give a name that ends in .mcap"),
        (["--out", f"{'x' * 300}.mcap"], "File name too long"),
        (["--out", "/proc/run.mcap"], "/proc/run.mcap"),
        (["x" * 5000], "File name too long"),
        (["--out", "nowhere/run.mcap"], "there is no directory nowhere; create it with: mkdir -p nowhere"),
        (["--no-such-option"], "No such option"),
    ],
)
def test_bad_input_to_run_ends_with_2_before_anything_starts(arguments, message, tmp_path, refused):
    (tmp_path / "logs").mkdir()
    assert message in refused("run", *arguments, cwd=tmp_path)


def test_what_is_refused_ends_its_process_with_2(tmp_path):
    done = platoon("run", "formtion", cwd=tmp_path)
    assert (done.returncode, done.stdout) == (2, "")
    assert "Did you mean formation?" in done.stderr
    assert "Traceback" not in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_scenario_file_is_refused_by_name_and_line(tmp_path, refused):
    scenario = tmp_path / "mine.toml"
    scenario.write_text(load("formation").toml().replace("gap_m = 10.0", 'gap_m = "10 m"'))
    line = 1 + scenario.read_text().splitlines().index('gap_m = "10 m"')
    message = refused("run", "mine.toml", cwd=tmp_path)
    assert message.startswith("platoon: Scenario mine.toml has 1 error:\n")
    assert f'line {line}: platoon.gap_m = "10 m" is not allowed' in message


def test_a_label_that_says_nothing_or_too_much_is_refused(tmp_path, refused):
    assert "--label" in refused("run", *SHORT, "--label", "", cwd=tmp_path)
    assert "at most 60" in refused("run", *SHORT, "--label", "x" * 61, cwd=tmp_path)


def test_a_log_that_is_there_is_never_overwritten(platoon_log, refused):
    log, _ = platoon_log
    before = log.read_bytes()
    assert "run.mcap already exists" in refused("run", *SHORT, "--out", "run.mcap", cwd=log.parent)
    (log.parent / "other.html").touch()
    assert "other.html already exists" in refused("run", *SHORT, "--out", "other.mcap", cwd=log.parent)
    assert log.read_bytes() == before


# what comes after a run


def test_metrics_gives_every_figure_from_the_log_alone(platoon_log):
    log, _ = platoon_log
    figures = json.loads(platoon("metrics", str(log), "--json", cwd=log.parent).stdout)
    assert {
        "formation_time_s",
        "least_distance_m",
        "final_gaps_m",
        "final_speeds_mps",
        "final_lateral_errors_m",
        "final_yaws_rad",
        "boundary_margin_min",
        "speed_rmse_mps",
        "yaw_rate_rmse_radps",
        "solver_ms",
        "planner_ms",
        "fallback_steps",
        "frames_lost",
        "real_time_factor",
    } <= figures.keys()
    assert figures["formation_time_s"] == 0.0
    assert figures["final_gaps_m"] == pytest.approx([10.0, 10.0], abs=0.05)
    assert len(figures["speed_rmse_mps"]) == 3
    table = platoon("metrics", str(log), cwd=log.parent)
    assert table.returncode == 0
    assert "veh3" in table.stdout


def test_vehicles_that_came_too_near_each_other_fail_the_run(tmp_path):
    """A platoon faster than the vehicles can catch up with: they crowd."""
    fast = ["--set", "platoon.speed_mps=39.9", "--set", "duration_s=5.0"]
    done = platoon("run", "formation", *fast, "--can", "direct", "--no-report", cwd=tmp_path)
    assert done.returncode == 1
    assert "where 4 m is the least" in done.stderr


def test_a_report_never_takes_the_place_of_a_log(platoon_log, tmp_path, refused):
    log, _ = platoon_log
    before = log.read_bytes()
    assert "give a name that ends in .html" in refused("report", str(log), "-o", str(log), cwd=tmp_path)
    assert log.read_bytes() == before


def test_fmu_build_refuses_a_place_it_cannot_write_to_before_it_builds(tmp_path, refused):
    (tmp_path / "file").touch()
    for place in ("file", "file/inside", "/proc/inside"):
        message = refused("fmu", "build", "-o", place, cwd=tmp_path)
        assert f"{place}: the FMU cannot be written there" in message
        assert "generating" not in message


def test_fmu_build_tells_its_steps_and_takes_a_version_and_platforms(tmp_path, refused):
    done = platoon("fmu", "build", "--fmi", "3", "--platform", "native", "-o", "here", cwd=tmp_path)
    assert done.stdout.split() == ["here/Vehicle_FMI3.fmu"]
    generating, compiling = done.stderr.splitlines()
    assert "generating" in generating
    assert "compiling for" in compiling
    assert "allowed: native, " in refused("fmu", "build", "--platform", "vax", cwd=tmp_path)
    assert "--fmi" in refused("fmu", "build", "--fmi", "4", cwd=tmp_path)


def test_fmu_info_of_another_archive_is_refused(tmp_path, refused):
    with zipfile.ZipFile(tmp_path / "other.fmu", "w") as archive:
        archive.writestr("modelDescription.xml", "<foo/>")
    assert "other.fmu is not an FMU" in refused("fmu", "info", "other.fmu", cwd=tmp_path)


def test_report_is_written_where_it_is_asked_for(platoon_log, tmp_path, refused):
    log, _ = platoon_log
    done = platoon("report", str(log), "-o", "mine.html", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "<html" in (tmp_path / "mine.html").read_text(encoding="utf-8")[:2000].lower()
    assert "there is no directory nowhere" in refused("report", str(log), "-o", "nowhere/r.html", cwd=tmp_path)


def test_diff_tells_the_same_run_from_another(platoon_log, tmp_path):
    log, _ = platoon_log
    again = ["run", "crosswind", *SHORT, "--set", "road.force_y_n=0.0", "--no-report"]
    faster = ["--set", "vehicles.0.speed_mps=20.1", "--label", " a bit\nfaster "]
    assert platoon(*again, "--out", "again.mcap", cwd=tmp_path).returncode == 0
    assert "a bit faster\n" in platoon(*again, *faster, "--out", "other.mcap", cwd=tmp_path).stdout
    same = platoon("diff", str(log), "again.mcap", cwd=tmp_path)
    assert same.returncode == 0, same.stdout
    different = platoon("diff", str(log), "other.mcap", cwd=tmp_path)
    assert different.returncode == 1
    assert "veh1" in different.stdout
    # What they were started with comes first.
    assert different.stdout.startswith("A: run.mcap\nB: a bit faster\nWhat differs in ")
    settings, frames = different.stdout.split("\n\n")
    assert "  scenario  vehicles.0.speed_mps  A: 20.0  B: 20.1\n" in settings
    assert frames.startswith("different: ")
    as_json = platoon("diff", str(log), "other.mcap", "--json", cwd=tmp_path)
    assert as_json.returncode == 1
    found = json.loads(as_json.stdout)
    row = {"group": "scenario", "name": "vehicles.0.speed_mps", "a": "20.0", "b": "20.1"}
    assert row in found["settings"]["differences"]
    assert (found["frames"]["same"], found["settings"]["names"]) == (False, ["run.mcap", "a bit faster"])
    # The same run but for a place to write to differs in nothing; the label is everywhere where runs are told apart.
    nothing = platoon("diff", "again.mcap", "again.mcap", cwd=tmp_path).stdout
    assert "Nothing differs in scenario, seed, versions, options and machine.\n" in nothing
    assert "label  " in platoon("log", "info", "other.mcap", cwd=tmp_path).stdout
    assert platoon("metrics", "other.mcap", cwd=tmp_path).stdout.startswith("a bit faster\n")
    assert json.loads(platoon("metrics", "other.mcap", "--json", cwd=tmp_path).stdout)["label"] == "a bit faster"


@pytest.mark.parametrize("command", [["metrics"], ["report"], ["diff", "garbage.mcap"]])
def test_what_is_no_log_is_refused(command, tmp_path, refused):
    (tmp_path / "garbage.mcap").write_bytes(b"garbage" * 100)
    (tmp_path / "empty.mcap").touch()
    assert "is not there" in refused(*command, "missing.mcap", cwd=tmp_path) or command[0] == "diff"
    assert "garbage.mcap" in refused(*command, "garbage.mcap", cwd=tmp_path)
    assert ".mcap" in refused(*command, "empty.mcap", cwd=tmp_path)
    assert "directory" in refused(*command[:1], *[str(tmp_path)] * len(command), cwd=tmp_path)


# the rest


def test_scenarios_lists_and_prints_the_shipped_ones(tmp_path, refused):
    listed = platoon("scenarios", cwd=tmp_path).stdout
    for name in shipped():
        assert f"{name} " in listed
    (tmp_path / "mine.toml").write_text(platoon("scenarios", "five", cwd=tmp_path).stdout)
    assert load(tmp_path / "mine.toml").vehicles == load("five").vehicles
    assert "shipped are" in refused("scenarios", "six", cwd=tmp_path)


def test_a_random_scenario_is_printed_and_run_by_its_number(tmp_path, refused):
    assert "random:SEED " in platoon("scenarios", cwd=tmp_path).stdout
    printed = platoon("scenarios", "--random", "7", cwd=tmp_path).stdout
    assert platoon("scenarios", "random:7", cwd=tmp_path).stdout == printed
    (tmp_path / "mine.toml").write_text(printed)
    assert load(tmp_path / "mine.toml") == load("random:7")
    short = ["--can", "direct", "--set", "duration_s=0.5", "--no-report", "--out", "run.mcap"]
    done = platoon("run", "random:7", *short, cwd=tmp_path)
    assert "random-7 did not form a platoon in 0.5 s" in done.stderr
    assert Run(tmp_path / "run.mcap").scenario == load("random:7", ["duration_s=0.5"])
    assert "--schema and --random: give one of them" in refused("scenarios", "--schema", "--random", "7", cwd=tmp_path)
    assert "give a number or a name" in refused("scenarios", "five", "--random", "7", cwd=tmp_path)
    assert "allowed: random:0 to random:4294967295" in refused("run", "random:x", cwd=tmp_path)
    assert "-1" in refused("scenarios", "--random", "-1", cwd=tmp_path)


def test_a_random_fault_is_printed_and_run_by_its_number(tmp_path, refused):
    assert "random-fault:SEED " in platoon("scenarios", cwd=tmp_path).stdout
    (tmp_path / "mine.toml").write_text(platoon("scenarios", "random-fault:17", cwd=tmp_path).stdout)
    assert load(tmp_path / "mine.toml") == load("random-fault:17")
    short = ["--can", "direct", "--set", "duration_s=0.1", "--no-report", "--out", "run.mcap"]
    platoon("run", "random-fault:17", *short, cwd=tmp_path)
    assert Run(tmp_path / "run.mcap").scenario == load("random-fault:17", ["duration_s=0.1"])
    assert "allowed: random-fault:0 to random-fault:4294967295" in refused("run", "random-fault:x", cwd=tmp_path)


def test_fmu_is_built_checked_and_described(tmp_path, refused):
    assert platoon("fmu", "build", "-o", "here", cwd=tmp_path).returncode == 0
    fmu = "here/Vehicle.fmu"
    assert "no problems found" in platoon("fmu", "validate", fmu, cwd=tmp_path).stdout
    info = platoon("fmu", "info", fmu, cwd=tmp_path).stdout
    assert "Vehicle, FMI 2.0, Model Exchange and Co-Simulation" in info
    assert "steering_angle" in info
    (tmp_path / "garbage.fmu").write_bytes(b"garbage")
    for command in ("validate", "info"):
        assert "garbage.fmu" in refused("fmu", command, "garbage.fmu", cwd=tmp_path)
        assert "missing.fmu" in refused("fmu", command, "missing.fmu", cwd=tmp_path)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["planner", "--vehicle", "1", "--can", "direct"], "--can direct"),
        (["planner", "--vehicle", "4", "--can", "udp:45000"], "has vehicles 1 to 3"),
        (["planner", "--vehicle", "1", "--can", "udp"], "udp:PORT"),
        (["steward", "--vehicle", "1", "--can", "udp:45000"], "steward"),
    ],
)
def test_bad_input_to_ecu_ends_with_2(arguments, message, tmp_path, refused):
    assert message in refused("ecu", *arguments, cwd=tmp_path)


def test_fault_lists_every_kind_with_its_keys(tmp_path):
    listed = platoon("fault", cwd=tmp_path)
    assert listed.returncode == 0
    for kind, model in kinds().items():
        assert f"\n{kind} " in f"\n{listed.stdout}"
        assert all(key in listed.stdout for key in model.model_fields if key != "kind")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["ice_ptch"], "no kind of fault 'ice_ptch'; did you mean ice_patch? allowed: frame_loss, "),
        (
            ["ice_patch", "friction=0.1"],
            "friction=0.1: ice_patch takes KEY=VALUE with a KEY of at_s, for_s,",
        ),
        (["ice_patch", "mu"], "mu: ice_patch takes KEY=VALUE"),
        (["ice_patch", "mu=0.1", "mu=0.2"], "mu=0.2: mu is given twice"),
        (["ice_patch", f"mu={'9' * 5000}"], "bench"),
        (["ice_patch", f"mu={'[' * 5000}"], "bench"),
        (["ice_patch", "--run", "no-such-run"], "no running bench has 'no-such-run' in its name"),
    ],
)
def test_bad_input_to_fault_ends_with_2(arguments, message, tmp_path, refused):
    assert message in refused("fault", *arguments, cwd=tmp_path)


def test_doctor_looks_at_all_that_a_run_needs(tmp_path):
    found = platoon("doctor", cwd=tmp_path).stdout
    for subject in ("Python", "C compiler", "machine code", "vehicle FMU", "bus udp", "bus vcan", "cores", "logs"):
        assert subject in found


def test_exit_codes_are_told_in_help(tmp_path):
    for arguments in (["--help"], ["run", "--help"]):
        done = platoon(*arguments, cwd=tmp_path)
        assert done.returncode == 0
        told = (
            "0 done, 1 the run failed, formed no platoon, had vehicles nearer than 4 m or commands that are not "
            "numbers, 2 bad input"
        )
        assert told in " ".join(done.stdout.split())
