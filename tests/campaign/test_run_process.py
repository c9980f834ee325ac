"""A process that makes runs: how each can end, and that nothing of it stays."""

import pickle
import threading

import psutil
import pytest

from bench.analysis.metrics import compute
from bench.campaign.requirements import METRIC_NAMES, flat_metrics
from bench.campaign.run_process import Crashed, Ended, RunProcess, RunProcesses, TooLong
from bench.campaign.statuses import FAILED, OK, REFUSED
from bench.campaign.study import load_study
from bench.record import Run
from tests.campaign.commands import ROOT, WAITING, makings, until, write_study
from tests.campaign.steered import CRASHES, HANGS, RAISES

GUARD_S = 120.0
FMU = ROOT / "build" / "Vehicle.fmu"


@pytest.fixture
def study(tmp_path):
    return load_study(write_study(tmp_path, [1, 2, CRASHES, HANGS, RAISES, WAITING]))


@pytest.fixture
def pickled(tmp_path, study):
    file = tmp_path / "study.pickle"
    file.write_bytes(pickle.dumps(study))
    return file


@pytest.fixture
def process(pickled):
    process = RunProcess(pickled, FMU)
    yield process
    process.close()


def test_one_process_makes_run_after_run_whatever_becomes_of_them(tmp_path, study, process):
    log = tmp_path / "a.mcap"
    first = process.ask(0, {"seed": 1}, log, GUARD_S)
    metrics = flat_metrics(compute(Run(log)), study.scenario(0, {"seed": 1}))
    assert (first["status"], first["words"], first["metrics"]) == (OK, "", metrics)
    assert first["wall_s"] > 0
    log.unlink()

    refused = process.ask(1, {"duration_s": -1.0}, log, GUARD_S)
    assert refused["status"] == REFUSED
    assert "duration_s" in refused["words"]
    assert not log.exists()

    failed = process.ask(2, {"seed": RAISES}, log, GUARD_S)
    assert failed["status"] == FAILED
    assert "veh1.tracker failed: ValueError: the third word" in failed["words"]
    assert str(log) not in failed["words"]
    assert failed["metrics"] == {}
    log.unlink()

    second = process.ask(3, {"seed": 1}, log, GUARD_S)
    assert second["metrics"] == first["metrics"]
    assert set(second["metrics"]) == set(METRIC_NAMES)
    assert len({pid for pids in makings(tmp_path).values() for pid in pids}) == 1


def test_a_run_that_crashes_its_process_says_where(tmp_path, process):
    with pytest.raises(Crashed) as crashed:
        process.ask(0, {"seed": CRASHES}, tmp_path / "a.mcap", GUARD_S)
    words = str(crashed.value)
    assert words.startswith("its process was killed by SIGSEGV; it said: Fatal Python error: Segmentation fault")
    assert "_go_wrong" in words


def test_a_run_that_hangs_is_ended(tmp_path, process):
    with pytest.raises(TooLong, match="took longer than 3 s and was ended"):
        process.ask(0, {"seed": HANGS}, tmp_path / "a.mcap", 3.0)
    (pid,) = makings(tmp_path)[HANGS]
    assert not psutil.pid_exists(pid)


def test_a_process_that_died_between_two_runs_has_crashed(tmp_path, process):
    process.ask(0, {"seed": 1}, tmp_path / "a.mcap", GUARD_S)
    ((pid,),) = makings(tmp_path).values()
    psutil.Process(pid).kill()
    with pytest.raises(Crashed, match="its process was killed by SIGKILL"):
        process.ask(1, {"seed": 2}, tmp_path / "b.mcap", GUARD_S)


def test_processes_are_used_again_and_end_all_at_once(tmp_path, pickled):
    processes = RunProcesses(pickled, FMU)
    for number in range(2):
        with processes.one() as process:
            assert process.ask(number, {"seed": 1}, tmp_path / f"{number}.mcap", GUARD_S)["status"] == OK
    (idle,) = {pid for pids in makings(tmp_path).values() for pid in pids}
    errors = []

    def wait():
        try:
            with processes.one() as process:
                process.ask(2, {"seed": WAITING}, tmp_path / "2.mcap", GUARD_S)
        except Crashed as error:
            errors.append(str(error))

    waiting = threading.Thread(target=wait)
    waiting.start()
    until(lambda: WAITING in makings(tmp_path), "a run that waits")
    with processes.one() as process:
        assert process.ask(3, {"seed": 2}, tmp_path / "3.mcap", GUARD_S)["status"] == OK
    pids = {pid for pids in makings(tmp_path).values() for pid in pids}
    assert len(pids) == 2
    assert idle in pids
    processes.end()
    waiting.join(GUARD_S)
    assert errors == ["its process was killed by SIGKILL"]
    assert not any(map(psutil.pid_exists, pids))
    with pytest.raises(Ended), processes.one():
        pass
