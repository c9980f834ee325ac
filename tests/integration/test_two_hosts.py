"""A bench on one host and an ECU on another, over UDP: two network namespaces joined by a virtual Ethernet cable."""

import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from bench.record.compare import diff
from bench.record.reader import Run

ROOT = Path(__file__).parents[2]
TRACKER = f"{ROOT}/bench/examples/single_track.py:SingleTrack"
GUARD_S = 120.0
PLATOON = [sys.executable, "-m", "bench.cli"]


def ip(*words: str) -> str:
    """Run `ip`; what it says where that fails, else nothing."""
    done = subprocess.run(["ip", *words], capture_output=True, text=True, check=False)
    return done.stderr.strip() if done.returncode else ""


class Host:
    """A host of its own, as far as the network goes, with one network device besides `lo`."""

    def __init__(self, name: str, device: str, address: str) -> None:
        self.name, self.device = name, device
        for words in (
            ["address", "add", f"{address}/24", "dev", device],
            ["link", "set", device, "up"],
            ["link", "set", "lo", "up"],
            ["route", "add", "239.0.0.0/8", "dev", "lo"],
        ):
            assert ip("-n", name, *words) == ""

    def start(self, *command: str) -> subprocess.Popen[str]:
        return subprocess.Popen(
            ["ip", "netns", "exec", self.name, *command],
            cwd=ROOT,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )


@pytest.fixture
def hosts() -> Iterator[tuple[Host, Host]]:
    if shutil.which("ip") is None:
        pytest.skip("needs the command ip (package iproute2)")
    names = [f"platoon-{os.getpid()}-{side}" for side in "ab"]
    devices = [f"ecu{os.getpid() % 100_000}{side}" for side in "ab"]
    try:
        for name in names:
            problem = ip("netns", "add", name)
            if problem:
                pytest.skip(f"needs the right to make network namespaces (root): {problem}")
        problem = ip(
            "link", "add", devices[0], "netns", names[0], "type", "veth", "peer", devices[1], "netns", names[1]
        )
        if problem:
            pytest.skip(f"needs virtual Ethernet devices (veth): {problem}")
        yield Host(names[0], devices[0], "10.77.0.1"), Host(names[1], devices[1], "10.77.0.2")
    finally:
        for name in names:
            ip("netns", "delete", name)


@pytest.fixture
def begin() -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Start a command on a host, and see to its end."""
    started: list[subprocess.Popen[str]] = []

    def start(host: Host, *command: str) -> subprocess.Popen[str]:
        started.append(host.start(*command))
        return started[-1]

    yield start
    for process in started:
        process.kill()
        process.communicate()


def run_command(out: Path, *more: str) -> list[str]:
    short = ["--set", "duration_s=0.5", "--no-report", "--ecu", f"tracker={TRACKER}"]
    return [*PLATOON, "run", "formation", *short, "--out", str(out), *more]


def test_an_ecu_on_another_host_gives_the_same_frames(
    hosts: tuple[Host, Host], begin: Callable[..., subprocess.Popen[str]], tmp_path: Path
) -> None:
    rig, other = hosts
    where = f"veh2=udp:45002@{rig.device}"
    bench = begin(rig, *run_command(tmp_path / "two.mcap", "--can", "udp", "--can", where, "--without", "veh2.tracker"))
    assert bench.stderr is not None
    # A slow start has been told before.
    assert any("waiting for veh2.tracker on udp:45002@" in line for line in bench.stderr)
    there = ["--can", f"veh2=udp:45002@{other.device}", "--class", TRACKER]
    ecu = begin(other, *PLATOON, "ecu", "tracker", "--vehicle", "2", *there)
    output, errors = bench.communicate(timeout=GUARD_S)
    assert "two.mcap" in output, errors
    words = ecu.communicate(timeout=GUARD_S)[1]
    assert (ecu.returncode, words) == (0, f"veh2.tracker listens on veh2 at udp:45002@{other.device}\n")

    one = subprocess.run(run_command(tmp_path / "one.mcap"), cwd=ROOT, capture_output=True, text=True, check=False)
    assert "one.mcap" in one.stdout, one.stderr
    assert Run(tmp_path / "two.mcap").metadata["status"] == "completed"
    difference = diff(tmp_path / "two.mcap", tmp_path / "one.mcap")
    assert difference.same, str(difference)
    assert difference.frames[0] > 2500


def test_frames_stay_on_a_host_that_names_no_device(
    hosts: tuple[Host, Host], begin: Callable[..., subprocess.Popen[str]]
) -> None:
    """Also where the network that the others are on is the one that multicast goes to."""
    rig, other = hosts
    for host in hosts:
        assert ip("-n", host.name, "route", "replace", "239.0.0.0/8", "dev", host.device) == ""
    code = (
        "import sys, selectors; from bench.bus.link.opening import Address, open_link\n"
        "link = open_link('veh1', Address.parse(sys.argv[1]))\n"
        "with selectors.DefaultSelector() as selector:\n"
        "    selector.register(link.fileno(), selectors.EVENT_READ)\n"
        "    print('listens', flush=True)\n"
        "    selector.select()\n"
        "print([frame.data for frame in link.receive()], flush=True)\n"
    )
    send = (
        "import sys; from bench.bus.link.opening import Address, open_link\n"
        "open_link('veh1', Address.parse(sys.argv[1])).send(1, sys.argv[2].encode())\n"
    )
    listener = begin(other, sys.executable, "-c", code, f"veh1=udp:45001@{other.device}")
    assert listener.stdout is not None
    assert listener.stdout.readline() == "listens\n"
    # Sent in this order over the same cable: had the first left its host, it would be the one that is read.
    for place, text in (("udp:45001", "stays"), (f"udp:45001@{rig.device}", "leaves")):
        sender = begin(rig, sys.executable, "-c", send, f"veh1={place}", text)
        assert sender.communicate(timeout=GUARD_S) == ("", "")
    assert listener.communicate(timeout=GUARD_S)[0] == "[b'leaves']\n"


def test_a_device_that_is_down_is_said_with_the_mend(
    hosts: tuple[Host, Host], begin: Callable[..., subprocess.Popen[str]]
) -> None:
    rig, _ = hosts
    assert ip("-n", rig.name, "link", "set", rig.device, "down") == ""
    there = ["--can", f"veh1=udp:45001@{rig.device}"]
    ecu = begin(rig, *PLATOON, "ecu", "tracker", "--vehicle", "1", *there)
    words = ecu.communicate(timeout=GUARD_S)[1]
    assert ecu.returncode == 2
    assert words.startswith(f"platoon: bus veh1: no multicast on the network device {rig.device} (")
    assert f"sudo ip link set {rig.device} up" in words
