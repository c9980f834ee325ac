"""This checkout against itself: every row of every table is there, with figures. How large they are is not tested."""

import argparse
import io
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest
from rich.console import Console

from bench.benchmarks.against import checkout, command, tables
from bench.benchmarks.against.checkout import this_checkout
from bench.benchmarks.against.comparison import BUSES, in_pairs
from bench.errors import BadInput
from bench.scenario import SCENARIO_DIR, load

ROOT = Path(__file__).parents[3]


def options(*arguments):
    parser = argparse.ArgumentParser()
    command.add_arguments(parser)
    return parser.parse_args(["HEAD", *arguments])


def printed(shown):
    file = io.StringIO()
    Console(width=160, file=file).print(shown)
    return file.getvalue()


@pytest.mark.parametrize("vehicles", [1, 2, 3, 5, 10])
def test_a_scenario_may_have_another_number_of_vehicles(vehicles, tmp_path):
    made = load(command.scenario_file("formation", vehicles, tmp_path))
    before = load("formation").vehicles
    assert len(made.vehicles) == vehicles
    assert made.vehicles[:3] == before[:vehicles]
    assert all(a.x_m - b.x_m == 8.0 for a, b in zip(made.vehicles, made.vehicles[1:], strict=False))
    assert all(a.y_m != b.y_m for a, b in zip(made.vehicles, made.vehicles[1:], strict=False))


def test_a_shipped_scenario_is_this_checkouts_file(tmp_path):
    assert command.scenario_file("formation", None, tmp_path) == SCENARIO_DIR / "formation.toml"


def test_a_random_scenario_is_written_for_the_other_checkout(tmp_path):
    assert load(command.scenario_file("random:7", None, tmp_path)) == load("random:7")
    assert len(load(command.scenario_file("random:7", 9, tmp_path)).vehicles) == 9


def test_impossible_scenarios_are_refused(tmp_path):
    with pytest.raises(BadInput, match="nonsense"):
        command.scenario_file("nonsense", None, tmp_path)
    single = tmp_path / "single.toml"
    single.write_text(
        'description = "one"\nduration_s = 1.0\n[platoon]\nlane_y_m = 0.0\nspeed_mps = 20.0\ngap_m = 10.0\n'
        "[[vehicles]]\nx_m = 0.0\ny_m = 0.0\nspeed_mps = 20.0\n"
    )
    with pytest.raises(BadInput, match="needs two vehicles"):
        command.scenario_file(str(single), 3, tmp_path)


@pytest.mark.nightly
def test_every_table_is_whole(tmp_path):
    # Also with a checkout that is built: `test_the_command_builds_and_compares`.
    this = this_checkout(print)
    chosen = options("--pairs", "1", "--seconds", "1", "--realtime", "1")
    found = list(command.compared(this, this, SCENARIO_DIR / "formation.toml", chosen, tmp_path))
    texts = [printed(each) for each in found]
    assert len(texts) == 7
    for words in ("processor time of a simulated second, udp", "first frame, direct", "tracker's whole step, p99, udp"):
        assert words in texts[1]
    assert "tracker, peak resident" in texts[2]
    assert "plant, system" in texts[3]
    assert "tracker's control" in texts[4]
    assert all("one busy process" in text or "quiet" in text for text in texts[5:])


@pytest.mark.nightly
def test_every_figure_is_positive(tmp_path):
    this = this_checkout(print)
    costs = in_pairs((this, this), SCENARIO_DIR / "formation.toml", 1.0, 2, tmp_path, print)
    rows = [row for section in tables.times(*costs) for row in section]
    assert len(rows) == (4 + 2 + 4) * len(BUSES)
    for row in rows:
        assert (row.other > 0.0).all(), row
        assert row.ratios.size == 2, row
    for section in tables.memory(*costs):
        assert len(section) >= 5
        assert all((row.this > 0.0).all() for row in section)
    ((*by_node,), (whole,)) = tables.nodes(*costs)
    assert len(by_node) >= 8
    assert (whole.this > 0.0).all()


@pytest.fixture
def builds(tmp_path):
    """A folder in which HEAD is built already: its files, with this checkout's virtual environment."""
    commit = checkout.commit_of("HEAD")
    folder = tmp_path / "builds" / commit
    folder.parent.mkdir()
    checkout._unpack(commit, folder, ROOT)
    (folder / ".venv").symlink_to(Path(sys.executable).parents[1])
    (folder / ".built").touch()
    return folder.parent


def _take_interrupts():
    signal.signal(signal.SIGINT, signal.SIG_DFL)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_comparison_leaves_no_process_behind(number, builds):
    arguments = ["HEAD", "--pairs", "1", "--builds", str(builds)]
    called = [sys.executable, "-m", "bench.benchmarks", "against", *arguments]
    streams = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    # A shell starts what runs in the background with SIGINT ignored, and these tests may run there.
    with subprocess.Popen(called, cwd=ROOT, preexec_fn=_take_interrupts, **streams) as process:
        while "to fill caches" not in process.stderr.readline():
            assert process.poll() is None
        itself = psutil.Process(process.pid)
        while len(started := itself.children(recursive=True)) < 3:
            time.sleep(0.05)
        process.send_signal(number)
        said, problems = process.communicate()
    assert process.returncode == 130, problems
    assert not said
    assert not problems
    assert not psutil.wait_procs(started, timeout=30)[1]


@pytest.mark.nightly
def test_the_command_builds_and_compares(tmp_path):
    arguments = ["HEAD", "--pairs", "1", "--seconds", "1", "--no-profile", "--builds", str(tmp_path)]
    called = [sys.executable, "-m", "bench.benchmarks", "against", *arguments]
    done = subprocess.run(called, capture_output=True, text=True, check=False, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    assert "1 pair: time" in done.stdout
    assert "of a simulated second" in done.stdout
