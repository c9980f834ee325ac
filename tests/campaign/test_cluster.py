"""A campaign on a Dask cluster of the user's: scheduler and workers are started as docs and messages say."""

import json
import os
import shutil
import subprocess
from dataclasses import dataclass, field
from pathlib import Path

import psutil
import pytest
from distributed import Client, LocalCluster
from polars.testing import assert_frame_equal

from bench.campaign import cluster as clusters
from bench.campaign.cluster import Place, connected
from bench.errors import BadInput
from tests.campaign.commands import (
    DASK,
    PLATOON,
    ROOT,
    WAITING,
    Command,
    makings,
    parts,
    table,
    until,
    write_study,
)

LOOPBACK = "127.0.0.1"
SEEDS = [1, 2, 3, 4]


@dataclass
class Cluster:
    """A scheduler and workers that a test has started."""

    folder: Path
    host: str = LOOPBACK
    before: tuple[str, ...] = ()
    commands: list[Command] = field(default_factory=list)

    @property
    def file(self) -> Path:
        return self.folder / "scheduler.json"

    @property
    def address(self) -> str:
        return json.loads(self.file.read_text())["address"]

    def start_scheduler(self) -> Command:
        self.file.unlink(missing_ok=True)
        words = ["scheduler", "--host", self.host, "--port", "0", "--no-dashboard", "--no-show"]
        command = self._start([*words, "--scheduler-file", str(self.file)], self.before)
        until(lambda: self.file.exists() and self.file.read_text().endswith("}"), "a scheduler")
        return command

    def start_worker(self, *words: str, before: tuple[str, ...] = (), **environment: str) -> Command:
        """Start a worker with one thread, and wait until the scheduler knows it."""
        options = ["--nthreads", "1", "--no-nanny", "--no-dashboard", "--local-directory", str(self.folder)]
        there = self.count()
        command = self._start(["worker", self.address, *options, *words], before or self.before, **environment)
        until(lambda: self.count() > there or command.process.poll() is not None, "a worker")
        assert command.process.poll() is None, command.said
        return command

    def count(self) -> int:
        if self.before:
            return sum("Registered to" in command.said for command in self.commands)
        with Client(self.address, set_as_default=False) as client:
            return len(client.nthreads())

    def end(self) -> None:
        for command in reversed(self.commands):
            command.end()

    def _start(self, words: list[str], before: tuple[str, ...], **environment: str) -> Command:
        self.commands.append(Command([*before, *DASK, *words], self.folder, **environment))
        return self.commands[-1]


@pytest.fixture
def cluster(tmp_path):
    """A scheduler without workers."""
    (tmp_path / "cluster").mkdir()
    found = Cluster(tmp_path / "cluster")
    try:
        found.start_scheduler()
        yield found
    finally:
        found.end()


@pytest.fixture(scope="module")
def expected(tmp_path_factory):
    """The table of the campaign on this machine, with more seeds than some tests have."""
    folder = tmp_path_factory.mktemp("here")
    write_study(folder, SEEDS)
    command = Command([*PLATOON, "campaign", "study.toml", "--workers", "1", "--out", "out"], folder)
    try:
        assert command.code() == 0, command.said
    finally:
        command.end()
    return table(folder / "out")


def check_goes_on(address: str) -> None:
    """The cluster is as it was before the campaign, and works."""
    with Client(address, set_as_default=False) as client:
        plugins = client.run(lambda dask_worker: [name for name in dask_worker.plugins if name.startswith("platoon")])
        assert plugins
        assert set(map(tuple, plugins.values())) == {()}
        known = client.run_on_scheduler(lambda dask_scheduler: list(dask_scheduler.worker_plugins))
        assert not [name for name in known if name.startswith("platoon")]
        assert client.submit(sum, [1, 2]).result() == 3


def test_a_cluster_by_its_file_and_by_its_address(tmp_path, begin, cluster, expected):
    write_study(tmp_path, SEEDS)
    worker = cluster.start_worker()
    for name, option in (("a", ["--scheduler-file", str(cluster.file)]), ("b", ["--cluster", cluster.address])):
        command = begin([*PLATOON, "campaign", "study.toml", *option, "--out", name])
        assert command.code() == 0, command.said
        assert_frame_equal(table(tmp_path / name), expected)
        (address,) = set(parts(tmp_path / name)["worker"])
        assert psutil.Process(worker.process.pid).children() == []
        with Client(cluster.address, set_as_default=False) as client:
            assert list(client.nthreads()) == [address]
    check_goes_on(cluster.address)
    assert not list(cluster.folder.rglob("platoon-*"))


def test_a_stopped_campaign_leaves_nothing_on_the_cluster(tmp_path, begin, cluster):
    write_study(tmp_path, [WAITING, 1, 2])
    worker = cluster.start_worker()
    command = begin([*PLATOON, "campaign", "study.toml", "--cluster", cluster.address, "--out", "out"])
    until(lambda: makings(tmp_path) or command.process.poll() is not None, "a run")
    command.process.terminate()
    assert command.code() == 1, command.said
    until(lambda: not psutil.Process(worker.process.pid).children(), "the end of the run")
    check_goes_on(cluster.address)
    assert f"--cluster {cluster.address} --out out --resume" in command.said


def test_a_killed_scheduler_stops_the_campaign_and_another_one_goes_on(tmp_path, begin, cluster, expected):
    write_study(tmp_path, [*SEEDS[:2], WAITING])
    worker = cluster.start_worker()
    words = [*PLATOON, "campaign", "study.toml", "--scheduler-file", str(cluster.file), "--out", "out"]
    command = begin(words)
    until(lambda: WAITING in makings(tmp_path) or command.process.poll() is not None, "a run that waits")
    until(lambda: parts(tmp_path / "out").height == 2 or command.process.poll() is not None, "rows")
    cluster.commands[0].process.kill()
    assert command.code() == 1, command.said
    first, second = command.said.splitlines()[-2:]
    assert first == "platoon: The campaign was stopped: the scheduler is gone"
    assert second.endswith(
        f"go on with: platoon campaign study.toml --scheduler-file {cluster.file} --out out --resume"
    )
    assert "Traceback" not in command.said, command.said
    worker.end()

    cluster.start_scheduler()
    cluster.start_worker()
    (tmp_path / "go").touch()
    resumed = begin([*words, "--resume"])
    assert resumed.code() == 0, resumed.said
    assert_frame_equal(table(tmp_path / "out").head(2).drop("log"), expected.head(2).drop("log"))
    assert table(tmp_path / "out")["in.seed"].to_list() == [*SEEDS[:2], WAITING]
    assert {seed: len(pids) for seed, pids in makings(tmp_path).items()} == {1: 1, 2: 1, WAITING: 2}


def copy_of_the_packages(folder: Path) -> Path:
    """Copy what a worker on another machine has: no FMU, no machine code."""
    for name in ("bench", "platoon_fmu", "dbc"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns("__pycache__", "*.so", "build"))
    return folder


def refused(command: Command) -> str:
    """Return what a refused command says: one message, and nothing else has come of it."""
    assert command.code() == 2, command.said
    assert command.out == ""
    assert command.said.count("platoon: ") == 1
    assert "Traceback" not in command.said, command.said
    until(lambda: not command.all(), "the end of all its processes")
    return command.said


def test_a_worker_with_other_code_is_refused(tmp_path, begin, cluster):
    write_study(tmp_path, SEEDS)
    other = copy_of_the_packages(tmp_path / "other")
    with (other / "bench" / "control" / "settings.py").open("a") as file:
        file.write("# edited\n")
    cluster.start_worker(PYTHONPATH=str(other))
    said = refused(begin([*PLATOON, "campaign", "study.toml", "--cluster", cluster.address, "--out", "out"]))
    with Client(cluster.address, set_as_default=False) as client:
        (address,) = client.nthreads()
    assert f"the worker {address} has code " in said
    assert "install the same state of the project" in " ".join(said.split())
    assert not (tmp_path / "out").exists()
    check_goes_on(cluster.address)


def test_a_worker_with_other_code_that_joins_later_stops_the_campaign(tmp_path, begin, cluster):
    write_study(tmp_path, [WAITING, *SEEDS])
    other = copy_of_the_packages(tmp_path / "other")
    with (other / "bench" / "control" / "settings.py").open("a") as file:
        file.write("# edited\n")
    cluster.start_worker()
    command = begin([*PLATOON, "campaign", "study.toml", "--cluster", cluster.address, "--out", "out"])
    until(lambda: WAITING in makings(tmp_path) or command.process.poll() is not None, "a run that waits")
    cluster.start_worker(PYTHONPATH=str(other))
    assert command.code() == 1
    assert "a worker cannot make runs: the worker tcp://" in command.said
    assert "has code " in command.said
    assert "Traceback" not in command.said, command.said
    check_goes_on(cluster.address)


def test_a_worker_gets_fmu_base_and_ecus_if_it_has_none(tmp_path, begin, cluster, expected):
    write_study(tmp_path / "study", SEEDS)
    cluster.start_worker(PYTHONPATH=str(copy_of_the_packages(tmp_path / "other")))
    command = begin([*PLATOON, "campaign", "study/study.toml", "--cluster", cluster.address, "--out", "out"])
    assert command.code() == 0, command.said
    assert_frame_equal(table(tmp_path / "out"), expected)


def test_a_cluster_without_workers_is_refused(monkeypatch):
    monkeypatch.setattr(clusters, "WORKERS_S", 0.2)
    with (
        LocalCluster(n_workers=0, host=LOOPBACK, dashboard_address=None) as empty,
        pytest.raises(BadInput, match=r"no worker within 0\.2 s; start some: dask worker"),
        connected(Place(address=empty.scheduler_address)),
    ):
        pass


@pytest.mark.parametrize(
    ("option", "words"),
    [
        (["--cluster", "tcp://127.0.0.1:1"], "--cluster tcp://127.0.0.1:1: no scheduler answers there within 10 s"),
        (["--cluster", "nonsense"], "--cluster nonsense: no scheduler answers there"),
        (["--cluster", "carrier-pigeon://a:1"], "--cluster carrier-pigeon://a:1: no scheduler answers there"),
        (["--scheduler-file", "missing.json"], "--scheduler-file missing.json: No such file or directory"),
        (["--scheduler-file", "study.toml"], "--scheduler-file study.toml: no scheduler has written its address there"),
    ],
)
def test_a_scheduler_that_does_not_answer_is_refused(option, words, tmp_path, begin):
    write_study(tmp_path, SEEDS)
    before = sorted(tmp_path.rglob("*"))
    said = refused(begin([*PLATOON, "campaign", "study.toml", *option, "--out", "out"]))
    assert words in said
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize("dashboard", [False, True])
def test_this_machines_scheduler_and_workers_listen_on_loopback_only(dashboard):
    with connected(Place(workers=1, dashboard=dashboard)) as client:
        here = psutil.Process()
        processes = [here, *here.children(recursive=True)]
        heard = {
            each.laddr.ip
            for process in processes
            for each in process.net_connections("inet")
            if each.status == psutil.CONN_LISTEN
        }
        assert heard == {LOOPBACK}
        assert client.scheduler_info()["address"].startswith(f"tcp://{LOOPBACK}:")


def ip(*words: str) -> str:
    """Run `ip`; what it says where that fails, else nothing."""
    done = subprocess.run(["ip", *words], capture_output=True, text=True, check=False)
    return done.stderr.strip() if done.returncode else ""


def cannot(reason: str) -> None:
    """Skip, but not in CI."""
    assert "CI" not in os.environ, reason
    pytest.skip(reason)


@pytest.fixture
def hosts():
    """Two network namespaces joined by a cable: their names and addresses."""
    if shutil.which("ip") is None:
        cannot("needs the command ip (package iproute2)")
    names = [f"campaign-{os.getpid()}-{side}" for side in "ab"]
    devices = [f"dask{os.getpid() % 100_000}{side}" for side in "ab"]
    addresses = ["10.78.0.1", "10.78.0.2"]
    try:
        for name in names:
            problem = ip("netns", "add", name)
            if problem:
                cannot(f"needs the right to make network namespaces (root): {problem}")
        one, other = names
        problem = ip("link", "add", devices[0], "netns", one, "type", "veth", "peer", devices[1], "netns", other)
        if problem:
            cannot(f"needs virtual Ethernet devices (veth): {problem}")
        for name, device, address in zip(names, devices, addresses, strict=True):
            for words in (
                ["address", "add", f"{address}/24", "dev", device],
                ["link", "set", device, "up"],
                ["link", "set", "lo", "up"],
            ):
                assert ip("-n", name, *words) == ""
        yield list(zip(names, addresses, strict=True))
    finally:
        for name in names:
            ip("netns", "delete", name)


def test_workers_on_two_hosts_make_the_runs_of_one_campaign(tmp_path, begin, hosts, expected):
    write_study(tmp_path, [*SEEDS, WAITING, WAITING + 1])
    (one, address), (other, _) = hosts
    there = {name: ("ip", "netns", "exec", name) for name in (one, other)}
    (tmp_path / "cluster").mkdir()
    cluster = Cluster(tmp_path / "cluster", address, there[one])
    try:
        cluster.start_scheduler()
        for name in (one, other):
            cluster.start_worker(before=there[name])
        words = ["campaign", "study.toml", "--cluster", cluster.address, "--out", "out"]
        command = begin([*there[one], *PLATOON, *words])
        # Two runs that wait at once are on both workers, each of which has one thread.
        both = {WAITING, WAITING + 1}
        until(lambda: both <= set(makings(tmp_path)) or command.process.poll() is not None, "both workers at work")
        (tmp_path / "go").touch()
        assert command.code() == 0, command.said
    finally:
        cluster.end()
    rows = parts(tmp_path / "out")
    assert {worker.split("/")[2].split(":")[0] for worker in rows["worker"]} == {each for _, each in hosts}
    assert_frame_equal(table(tmp_path / "out").head(4).drop("log"), expected.drop("log"))
