"""The socket of `platoon fault`: hostile clients of a real bench, and hostile servers in a bench's place."""

import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from bench.conductor.fault_desk import ask, running_benches
from bench.conductor.fault_socket import address_of, listening_names
from bench.errors import BadInput
from bench.events import FaultRequested
from bench.record.reader import Run

from .conftest import GUARD_S, wait_until

ROOT = Path(__file__).parents[2]
PLATOON = Path(sys.executable).with_name("platoon")
AS_ROOT = pytest.mark.skipif(os.getuid() != 0, reason="only root can act as another user")
NOBODY = 65534


def name_of(pid: int) -> str:
    """Name of the bench with this process number, once it listens."""
    wait_until(lambda: any(name.startswith(f"{pid}-") for name in listening_names()), "the bench to listen")
    (name,) = [name for name in listening_names() if name.startswith(f"{pid}-")]
    return name


def connected(name: str) -> socket.socket:
    connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    connection.settimeout(GUARD_S)
    connection.connect(address_of(name))
    return connection


def said(connection: socket.socket) -> list[dict]:
    """All lines up to the end of the connection."""
    received = b""
    while part := connection.recv(65536):
        received += part
    return [json.loads(line) for line in received.splitlines()]


REQUESTS = [
    b"[" * 60_000 + b"\n",
    b"[" * 8000 + b"\n",
    b'{"kind":' * 900 + b"\n",
    b"\xff\xff\n",
    b"\n",
    b"null\n",
    b'"ice_patch"\n',
    b'{"kind": "ice_patch", "mu": NaN}\n',
    b'{"kind": "ice_patch", "mu": 1e999}\n',
    b'{"kind": "ice_patch", "at_s": 1e308}\n',
    b'{"kind": "ice_patch", "at_s": ' + b"9" * 5000 + b"}\n",
    b'{"kind": "ice_patch", "at_s": "soon"}\n',
    b'{"kind": "ice_patch", "at_s": {}}\n',
    b'{"kind": ["ice_patch"]}\n',
    b'{"kind": "ice_patch", "kind": "ice_patch"}\n',
    b'{"kind": "ecu_crash", "ecu": "\\ud800"}\n',
    b'{"kind": "ecu_crash", "ecu": "' + b"x" * 8000 + b'"}\n',
    b'{"kind": "ecu_crash", "ecu": "veh1.nobody"}\n',
    b'{"kind": "v2v_outage", "vehicle": -1}\n',
    b'{"kind": "v2v_outage", "vehicle": 999999999999999999}\n',
    b"GET / HTTP/1.1\r\n\r\n",
]


def test_whatever_is_sent_is_refused_and_the_run_completes(start) -> None:
    run = start(set=["duration_s=20.0"])
    run.await_time(0.1)
    name = name_of(run.process.pid)
    for request in REQUESTS:
        with connected(name) as connection:
            connection.sendall(request)
            lines = said(connection)
        assert [list(line) for line in lines] == [["error"]], (request[:60], lines)
    asked = ask(name, {"kind": "v2v_outage", "vehicle": 1})
    code, _, errors = run.end()
    assert (code, errors) == (0, "")
    run.assert_all_gone()
    recorded = Run(run.out)
    assert recorded.result["cycles"] == "2000"
    assert [event.fields["fault"] for event in recorded.events if event.kind == FaultRequested.kind] == [asked["fault"]]


def test_no_cycle_waits_for_those_who_send_slowly_or_never_read(start) -> None:
    run = start(set=["duration_s=20.0"])
    run.await_time(0.1)
    name = name_of(run.process.pid)
    slow = [connected(name) for _ in range(12)]
    # These hold everything that a client can hold: half a line, an answer not read, nothing at all.
    for number, connection in enumerate(slow):
        connection.sendall([b'{"kind": "ice_', b'{"kind": "ice_patch", "mu": 0.01}\n', b""][number % 3])
    run.await_time(3.0)

    def is_closed(dripping: socket.socket) -> bool:
        try:
            dripping.sendall(b"x")
        except OSError:
            return True
        return False

    wait_until(lambda: is_closed(slow[0]), "the bench to have no more patience")
    for connection in slow:
        connection.close()
    assert "at_s" in ask(name, {"kind": "v2v_outage", "vehicle": 1})
    assert run.end()[0] == 0
    assert Run(run.out).result["cycles"] == "2000"


def test_a_flood_of_connections_ends_nothing(start) -> None:
    run = start(set=["duration_s=10.0"])
    run.await_time(0.1)
    name = name_of(run.process.pid)
    flood = []
    for _ in range(300):
        connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        connection.setblocking(False)
        try:
            connection.connect(address_of(name))
        except OSError:
            # The backlog is full, or the run has ended.
            connection.close()
            time.sleep(0.001)
            continue
        flood.append(connection)
    assert flood
    code, _, errors = run.end()
    for connection in flood:
        connection.close()
    assert (code, errors) == (0, "")
    assert Run(run.out).result["cycles"] == "1000"


@AS_ROOT
def test_another_user_learns_nothing(start) -> None:
    run = start(set=["duration_s=10.0"])
    run.await_time(0.1)
    name = name_of(run.process.pid)
    code = (
        "import os, socket, sys; s = socket.socket(socket.AF_UNIX); s.settimeout(30); "
        f"os.setuid({NOBODY}); s.connect(sys.argv[1].encode()); "
        's.sendall(b\'{"kind": "ice_patch"}\\n\') if len(sys.argv) > 2 else None; print(s.recv(1000))'
    )
    address = address_of(name).decode().replace("\0", "@")
    code = code.replace("sys.argv[1].encode()", "b'\\0' + sys.argv[1][1:].encode()")
    told = subprocess.run([sys.executable, "-c", code, address], capture_output=True, text=True, check=True)
    assert told.stdout == "b''\n"
    assert run.end()[0] == 0


Serve = Callable[..., None]

HOSTILE = """
import os, socket, sys, time
address, user, behaviour = sys.argv[1:]
me = os.stat(os.getcwd())
os.setuid(int(user))
listener = socket.socket(socket.AF_UNIX)
listener.bind(b"\\0" + address[1:].encode())
listener.listen(8)
print("listening", flush=True)
bench = b'{"log": "/run.mcap", "folder": "/", "scenario": "s", "inode": [%d, %d]}\\n' % (me.st_dev, me.st_ino)
kept = []
while True:
    connection, _ = listener.accept()
    kept.append(connection)
    try:
        if behaviour == "drip":
            while True:
                connection.sendall(b"x")
                time.sleep(0.1)
        elif behaviour == "flood":
            while True:
                connection.sendall(b"x" * 100_000)
        elif behaviour == "deep":
            connection.sendall(b"[" * 8000 + b"\\n")
        elif behaviour == "close":
            connection.close()
        elif behaviour != "silent":
            asked = connection.recv(1000)
            answers = {
                "list": b"[]\\n", "number": b'{"at_s": "x"}\\n', "latin": b"\\xff\\n", "nan": b'{"at_s": NaN}\\n',
                "empty": b"{}\\n", "escape": b'{"error": {"a": 1}}\\n',
            }
            connection.sendall(bench if b"bench" in asked else answers[behaviour])
            connection.close()
    except OSError:
        pass
"""


@pytest.fixture
def serve(tmp_path: Path) -> Iterator[Serve]:
    """`serve(name, user, behaviour)`: somebody listens in a bench's place, started in `tmp_path`."""
    servers = []

    def begin(name: str, behaviour: str, user: int = os.getuid()) -> None:
        address = address_of(name).decode().replace("\0", "@")
        command = [sys.executable, "-c", HOSTILE, address, str(user), behaviour]
        servers.append(subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, text=True))
        assert servers[-1].stdout is not None
        assert servers[-1].stdout.readline() == "listening\n"

    yield begin
    for server in servers:
        server.kill()
        server.communicate()


def fault(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    command = [PLATOON, "fault", "v2v_outage", "vehicle=1", *arguments]
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False, timeout=GUARD_S)


@pytest.mark.parametrize(
    "behaviour",
    ["drip", "flood", "deep", "close", "silent", "list", "number", "latin", "nan", "empty", "escape"],
)
def test_a_bench_that_is_none_is_no_more_than_a_message(serve: Serve, tmp_path: Path, behaviour: str) -> None:
    serve(f"1-{os.getpid()}", behaviour)
    done = fault(cwd=tmp_path)
    assert done.returncode == 2
    assert done.stderr.startswith("platoon: ")
    assert "Traceback" not in done.stderr
    assert done.stdout == ""


@AS_ROOT
def test_a_bench_of_another_user_is_not_talked_to(serve: Serve, tmp_path: Path) -> None:
    name = f"2-{os.getpid()}"
    serve(name, "empty", NOBODY)
    done = fault("--run", name, cwd=tmp_path)
    assert done.returncode == 2
    assert f"ignored: {name}: the socket belongs to user {NOBODY}" in done.stderr
    assert name not in [bench.name for bench in running_benches()[0]]


def test_names_that_are_no_benches_are_passed_over(tmp_path: Path) -> None:
    names = [b"\0\xff\xfe", b"\0platoon-%d-\xff-x" % os.getuid(), b"\0platoon-%d-1-a b" % os.getuid()]
    taken = []
    for name in names:
        taken.append(socket.socket(socket.AF_UNIX, socket.SOCK_STREAM))
        taken[-1].bind(name)
        taken[-1].listen()
    try:
        done = fault("--run", "no such bench", cwd=tmp_path)
    finally:
        for each in taken:
            each.close()
    assert done.returncode == 2
    assert "Traceback" not in done.stderr


def begun(folder: Path, *options: str) -> subprocess.Popen[str]:
    folder.mkdir(exist_ok=True)
    simple = ROOT / "tests" / "ecus" / "simple.py"
    own = ("--ecu", f"tracker={simple}:SpeedTracker", "--ecu", f"planner={simple}:CruisePlanner")
    command = [PLATOON, "run", "formation", "--no-report", "--set", "duration_s=300", *own, *options]
    return subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def test_the_bench_started_here_is_reached_and_another_only_by_name(tmp_path: Path) -> None:
    here, there = tmp_path / "here", tmp_path / "there"
    bench = begun(here, "--out", "log é\n.mcap")
    try:
        name = name_of(bench.pid)
        done = fault(cwd=here)
        assert done.returncode == 0, done.stderr
        assert re.fullmatch(r"v2v_outage at [0-9.]+ s in log é\s\.mcap\n", done.stdout)
        # The same directory by another name.
        there.symlink_to(here)
        assert fault(cwd=there).returncode == 0
        elsewhere = tmp_path / "elsewhere"
        elsewhere.mkdir()
        done = fault(cwd=elsewhere)
        assert done.returncode == 2
        assert "no running bench was started in this directory; name one of these with --run:" in done.stderr
        (row,) = [line for line in done.stderr.splitlines() if f"--run {bench.pid} " in line]
        assert "formation" in row
        assert row.endswith(f"started in {here}") or "log" in row
        done = fault("--run", str(bench.pid), cwd=elsewhere)
        assert done.returncode == 0, done.stderr
        assert str(here) in done.stdout
        with pytest.raises(BadInput, match="no running bench has 'nonsense' in its name"):
            ask("nonsense", {"kind": "ice_patch"})
        assert name in listening_names()
        second = begun(here, "--out", "second.mcap")
        try:
            name_of(second.pid)
            done = fault(cwd=here)
            assert done.returncode == 2
            assert "several benches are running; name one with --run:" in done.stderr
            assert fault("--run", "second", cwd=here).returncode == 0
        finally:
            second.send_signal(signal.SIGINT)
            second.communicate(timeout=GUARD_S)
    finally:
        bench.send_signal(signal.SIGINT)
        bench.communicate(timeout=GUARD_S)
    assert name not in listening_names()


def test_a_bench_that_begins_no_cycle_says_so(tmp_path: Path) -> None:
    bench = begun(tmp_path / "here", "--can", "udp:45800", "--without", "veh1.tracker")
    try:
        name_of(bench.pid)
        done = fault(cwd=tmp_path / "here")
        assert done.returncode == 2
        assert "the run has begun no cycle for 8 s" in done.stderr
    finally:
        bench.send_signal(signal.SIGINT)
        _, errors = bench.communicate(timeout=GUARD_S)
    assert "interrupted by SIGINT" in errors


def test_a_killed_bench_leaves_no_socket(start) -> None:
    run = start(set=["duration_s=300.0"])
    run.await_time(0.1)
    name = name_of(run.process.pid)
    os.kill(run.process.pid, signal.SIGKILL)
    wait_until(lambda: name not in listening_names(), "the socket to be gone")
    run.assert_all_gone()
