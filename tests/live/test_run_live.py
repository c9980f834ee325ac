"""`platoon run --live` with real runs: what viewers see, and that the run does not care who watches."""

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path

import pytest

from bench.analysis.page_data import events_of
from bench.errors import BadInput
from bench.live import session
from bench.live.address import LiveAddress
from bench.record import diff
from bench.record.reader import Run

from .conftest import GUARD_S, Bench, Start, served_by


def test_a_viewer_sees_the_run_which_is_none_the_worse(start: Start, whole_log: Path) -> None:
    bench = start("--can", "udp", duration=4.0)
    assert '"live":true' in bench.html()
    messages = list(bench.told())
    code, errors = bench.end()
    # The simple ECUs form no platoon.
    assert code == 1, errors
    assert "live" not in errors
    assert list(messages[-1]) == ["replace"]
    appended = [message["append"] for message in messages if "append" in message]
    assert len(appended) >= 1
    t = [value for each in appended for value in each["pool"]["t"]]
    speed = [value for each in appended for value in each["pool"]["1.v_x"]]
    truth = Run(bench.out).truth(1)
    assert t == sorted(set(t))
    assert speed == pytest.approx(truth["v_x"][: len(speed)].tolist(), rel=1e-5)
    events = [event for each in appended for event in each["events"]]
    recorded = events_of(Run(bench.out).events)
    assert events == recorded[: len(events)]
    assert messages[-1]["replace"]["status"] == "completed"
    assert diff(bench.out, whole_log).same


def test_a_viewer_that_hangs_does_not_hold_up_the_run(start: Start) -> None:
    bench = start("--can", "direct", duration=8.0)
    bench.html()
    port = int(bench.page.split(":")[2].strip("/"))
    with socket.create_connection(("127.0.0.1", port)) as hanging, socket.create_connection(("127.0.0.1", port)):
        hanging.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        key = "Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: "
        hanging.sendall(
            f"GET /feed HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n{key}AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n".encode()
        )
        code, errors = bench.end()
    assert (code, "live" in errors) == (1, False)
    assert Run(bench.out).result["status"] == "completed"


def test_a_server_that_dies_is_missed_by_nobody(start: Start) -> None:
    bench = start("--can", "udp")
    os.kill(bench.server, signal.SIGKILL)
    _, errors = bench.end()
    assert errors.count("the live server was killed by signal 9; the run goes on without it") == 1
    assert Run(bench.out).result["status"] == "completed"


def test_a_server_that_is_stopped_gives_viewers_the_end_nevertheless(start: Start) -> None:
    bench = start("--can", "udp", duration=300.0)
    bench.html()
    viewer = bench.told()
    next(viewer)
    os.kill(bench.server, signal.SIGSTOP)
    bench.process.send_signal(signal.SIGINT)
    messages = list(viewer)
    code, errors = bench.end()
    assert (code, errors.count("live server")) == (1, 0), errors
    assert messages[-1]["replace"]["status"] == "interrupted"


def test_a_server_that_somebody_keeps_stopping_is_killed(tmp_path: Path) -> None:
    warnings: list[str] = []
    live = session.LiveSession(tmp_path / "run.mcap", LiveAddress.parse("127.0.0.1:0"), warnings.append)
    assert live.served().startswith("live: http://")
    pid = live._process.pid
    over = threading.Event()

    def keep_stopping() -> None:
        while not over.wait(0.001):
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGSTOP)

    stopper = threading.Thread(target=keep_stopping)
    stopper.start()
    try:
        live.end()
    finally:
        over.set()
        stopper.join()
    assert warnings == ["the live server is stopped and is killed"]
    assert not Path(f"/proc/{pid}").exists()


def test_ctrl_c_ends_run_and_server(start: Start) -> None:
    bench = start("--can", "udp", duration=300.0)
    bench.html()
    server = bench.server
    viewer = bench.told()
    assert "append" in next(viewer)
    os.killpg(bench.process.pid, signal.SIGINT)
    messages = list(viewer)
    code, errors = bench.end()
    assert code == 1
    assert "interrupted by SIGINT" in errors
    assert messages[-1]["replace"]["status"] == "interrupted"
    assert not Path(f"/proc/{server}").exists()


def test_a_killed_run_leaves_no_server(start: Start) -> None:
    bench = start("--can", "direct", duration=300.0)
    server = bench.server
    bench.process.kill()
    end = time.monotonic() + GUARD_S
    while Path(f"/proc/{server}").exists() and time.monotonic() < end:
        time.sleep(0.05)
    assert not Path(f"/proc/{server}").exists()


def test_a_taken_port_is_refused_before_anything_starts(tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        address = f"127.0.0.1:{taken.getsockname()[1]}"
        told = subprocess.run(
            [sys.executable, "-m", "bench.cli", "run", "--out", "run.mcap", "--live-address", address],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            timeout=GUARD_S,
        )
    assert told.returncode == 2
    assert told.stderr.startswith(f"platoon: cannot listen on {address}: ")
    assert list(tmp_path.iterdir()) == []


def test_a_whole_log_is_served_until_ctrl_c(whole_log: Path) -> None:
    command = [sys.executable, "-m", "bench.cli", "live", str(whole_log)]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        bench = Bench(process, whole_log, *served_by(process))
        assert '"live":true' in bench.html()
        (told,) = bench.told(1)
        assert told["replace"]["status"] == "completed"
        process.send_signal(signal.SIGINT)
        assert bench.end() == (0, "")
    finally:
        process.kill()
        process.communicate()


def test_packages_that_are_missing_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(session, "PACKAGES", ("no-such-package",))
    with pytest.raises(BadInput, match=r"needs no-such-package; .*pip install no-such-package"):
        session.check_available()
