"""What is killed in the middle of a campaign: nothing is lost, nothing is made twice, nothing is left."""

import os
import signal

import psutil
import pytest
from polars.testing import assert_frame_equal

from tests.campaign.commands import (
    PLATOON,
    WAITING,
    Command,
    interrupt,
    logs,
    makings,
    parts,
    table,
    until,
    write_study,
)

FREE, HELD = [1, 2, 3, 4, 5], [WAITING + each for each in (150, 250, 350, 450, 550, 650, 750)]
SEEDS = FREE + HELD
TWO = ["--workers", "2", "--worst", "2"]


def seeds_of(rows):
    return set(rows["in.seed"])


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """The table of the campaign if nothing happens, and the numbers of the logs kept."""
    folder = tmp_path_factory.mktemp("undisturbed")
    write_study(folder, SEEDS)
    (folder / "go").touch()
    command = Command([*PLATOON, "campaign", "study.toml", *TWO, "--out", "out"], folder)
    try:
        assert command.code() == 0, command.said
    finally:
        command.end()
    assert makings(folder).keys() == set(SEEDS)
    return table(folder / "out"), logs(folder / "out")


@pytest.fixture
def halfway(tmp_path, begin):
    """A campaign of which the runs of FREE are done and two others wait in the middle."""
    write_study(tmp_path, SEEDS)
    command = begin([*PLATOON, "campaign", "study.toml", *TWO, "--out", "out"])
    until(lambda: command.process.poll() is not None or len(makings(tmp_path)) == len(FREE) + 2, "runs that wait")
    until(lambda: command.process.poll() is not None or parts(tmp_path / "out").height == len(FREE), "rows")
    assert command.process.poll() is None, command.said
    return command


def resume(folder, begin):
    (folder / "go").touch()
    command = begin([*PLATOON, "campaign", "study.toml", *TWO, "--out", "out", "--resume"])
    assert command.code() == 0, command.said
    return command


def check_whole(folder, undisturbed):
    """The folder holds what it would if nothing had happened."""
    rows, kept = undisturbed
    assert_frame_equal(table(folder), rows)
    assert logs(folder) == kept
    assert not list(folder.rglob("*.part*"))


def test_a_killed_command_leaves_nothing_and_goes_on_where_it_was(tmp_path, begin, halfway, undisturbed):
    before, begun = parts(tmp_path / "out"), makings(tmp_path)
    files = {path: path.read_bytes() for path in (tmp_path / "out" / "parts").iterdir()}
    assert len(halfway.workers()) == 2
    os.kill(halfway.process.pid, signal.SIGKILL)
    assert halfway.code() == -signal.SIGKILL
    until(lambda: not halfway.all(), "the end of the workers and of the processes of runs")
    assert not (tmp_path / "out" / "runs.parquet").exists()

    resumed = resume(tmp_path, begin)
    check_whole(tmp_path / "out", undisturbed)
    assert {path: path.read_bytes() for path in files} == files
    assert seeds_of(before) == set(FREE)
    made = makings(tmp_path)
    assert all(made[seed] == begun[seed] and len(made[seed]) == 1 for seed in FREE)
    # Those that were in the middle begin again, and no others.
    assert sorted(map(len, made.values())) == [1] * (len(SEEDS) - 2) + [2, 2]
    until(lambda: not resumed.all(), "the end of all its processes")


def test_runs_of_a_killed_worker_go_to_others(tmp_path, halfway, undisturbed):
    victim = halfway.workers()[0]
    lost = {each.pid for each in victim.children(recursive=True)}
    victim.kill()
    until(lambda: not any(map(psutil.pid_exists, lost)), "the end of the worker's processes")
    (tmp_path / "go").touch()
    assert halfway.code() == 0, halfway.said
    check_whole(tmp_path / "out", undisturbed)
    made = makings(tmp_path)
    assert all(len(made[seed]) == 1 for seed in FREE)
    assert sum(map(len, made.values())) == len(SEEDS) + 1
    until(lambda: not halfway.all(), "the end of all its processes")


def test_a_run_whose_process_is_killed_is_made_a_second_time(tmp_path, halfway, undisturbed):
    seed, (pid,) = next((seed, pids) for seed, pids in makings(tmp_path).items() if seed in HELD)
    os.kill(pid, signal.SIGKILL)
    until(lambda: len(makings(tmp_path)[seed]) == 2, "a second time")
    (tmp_path / "go").touch()
    assert halfway.code() == 0, halfway.said
    check_whole(tmp_path / "out", undisturbed)
    tries = {row["in.seed"]: row["tries"] for row in parts(tmp_path / "out").iter_rows(named=True)}
    assert tries == dict.fromkeys(SEEDS, 1) | {seed: 2}


@pytest.mark.parametrize("how", ["Ctrl-C", "SIGTERM"])
def test_a_signal_stops_the_command_cleanly(how, tmp_path, halfway):
    if how == "Ctrl-C":
        interrupt(halfway)
    else:
        halfway.process.terminate()
    assert halfway.code() == 1
    name = "SIGINT" if how == "Ctrl-C" else "SIGTERM"
    go_on = "platoon campaign study.toml --workers 2 --worst 2 --out out --resume"
    assert halfway.said.splitlines()[-2:] == [
        f"platoon: The campaign was stopped: interrupted by {name}",
        f"  What is made, stays; go on with: {go_on}",
    ]
    assert "Traceback" not in halfway.said
    until(lambda: not halfway.all(), "the end of all its processes")
    assert seeds_of(parts(tmp_path / "out")) == set(FREE)
    assert not list((tmp_path / "out").rglob("*.part*"))


def test_ctrl_c_while_the_workers_start_is_not_lost(tmp_path, begin):
    write_study(tmp_path, FREE)
    command = begin([*PLATOON, "campaign", "study.toml", *TWO, "--out", "out"])
    until(lambda: command.workers() or command.process.poll() is not None, "a worker that starts")
    interrupt(command)
    assert command.code() == 1
    assert "The campaign was stopped: interrupted by SIGINT" in command.said
    assert "Traceback" not in command.said, command.said
    until(lambda: not command.all(), "the end of all its processes")
    assert not makings(tmp_path)
