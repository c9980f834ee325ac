"""Logs sent out again over real buses, seen by python-can and by a real ECU."""

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import ExitStack
from pathlib import Path

import can
import pytest
from can.interfaces.udp_multicast import UdpMulticastBus
from typer.testing import CliRunner

from bench.bus.codec import load_codecs
from bench.bus.link.base import LinkError
from bench.bus.link.direct import DirectLink, Hub
from bench.bus.link.udp import reserve_udp_ports
from bench.cli.main import app
from bench.errors import BadInput
from bench.replay.order import in_order
from bench.replay.player import play
from bench.replay.selection import Selection

from .conftest import ECUS

ROOT = Path(__file__).parents[2]
GUARD_S = 60.0


@pytest.fixture
def port():
    """The first of four ports in a row that no bench uses just now."""
    with ExitStack() as stack:
        ports = stack.enter_context(reserve_udp_ports(4))
    return ports.start


class Listener:
    """A python-can bus that keeps what it hears as (identifier, data)."""

    def __init__(self, port):
        self.frames = []
        self._bus = can.Bus(interface="udp_multicast", channel=UdpMulticastBus.DEFAULT_GROUP_IPv4, port=port)
        with socket.socket(fileno=os.dup(self._bus.fileno())) as sock:
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4 * 1024 * 1024)
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._listen)
        self._thread.start()

    def _listen(self):
        while not self._end.is_set():
            message = self._bus.recv(timeout=0.1)
            if message is not None:
                self.frames.append((message.arbitration_id, bytes(message.data)))

    def wait_for(self, count, can_id=None):
        """Wait for as many frames, of an identifier or of all."""
        end = time.monotonic() + GUARD_S
        while sum(can_id in (None, number) for number, _ in self.frames) < count and time.monotonic() < end:
            time.sleep(0.01)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._end.set()
        self._thread.join()
        self._bus.shutdown()


def frames_of(run, bus, without=()):
    return [(f.can_id, f.data) for f in in_order(run.frames()) if f.bus == bus and f.can_id not in without]


def command(run, *options):
    result = CliRunner().invoke(app, ["replay", str(run.path), *options])
    if isinstance(result.exception, BadInput):
        raise result.exception
    return result


def test_every_frame_goes_out_in_its_order(recorded, port):
    with Listener(port) as v2v, Listener(port + 2) as veh2:
        result = command(recorded, "--can", f"udp:{port}", "--speed", "10")
        wanted = frames_of(recorded, "v2v"), frames_of(recorded, "veh2")
        v2v.wait_for(len(wanted[0]))
        veh2.wait_for(len(wanted[1]))
    assert result.exit_code == 0, result.output
    assert (v2v.frames, veh2.frames) == wanted
    assert f"{sum(len(recorded.frame_table(bus)) for bus in recorded.buses)} frames sent" in result.output
    assert "late by p50" in result.output


def test_only_one_bus_and_without_one_ecu(recorded, port):
    codec = load_codecs(3)["veh2"]
    own = {codec.can_id(name) for name in codec.names if codec.message(name).senders == ["Tracker"]}
    with Listener(port + 1) as veh1, Listener(port + 2) as veh2:
        options = ("--only", "veh2", "--without", "veh2.tracker", "--speed", "max")
        result = command(recorded, "--can", f"udp:{port}", *options)
        wanted = frames_of(recorded, "veh2", own)
        veh2.wait_for(len(wanted))
    assert result.exit_code == 0
    assert 0 < len(wanted) < len(frames_of(recorded, "veh2"))
    assert veh2.frames == wanted
    assert veh1.frames == []
    assert "late" not in result.output


def test_a_part_of_the_time(recorded, port):
    with Listener(port) as v2v:
        result = command(recorded, "--can", f"udp:{port}", "--from", "0.1", "--to", "0.2", "--only", "v2v")
        wanted = [(f.can_id, f.data) for f in in_order(recorded.frames(start_s=0.1, end_s=0.2)) if f.bus == "v2v"]
        v2v.wait_for(len(wanted))
    assert result.exit_code == 0
    assert v2v.frames == wanted


def test_a_real_ecu_sends_what_it_sent_in_the_run(recorded, port):
    """On what it saw then, the ECU that was left out answers the same, byte for byte."""
    codec = load_codecs(3)["veh2"]
    can_id = codec.can_id("SteeringCommand")
    wanted = [data for number, data in frames_of(recorded, "veh2") if number == can_id]
    alone = [sys.executable, "-m", "bench.cli", "ecu", "tracker", "--vehicle", "2", "--class", ECUS["tracker"]]
    with Listener(port + 2) as veh2:
        ecu = subprocess.Popen([*alone, "--can", f"udp:{port}"], cwd=ROOT, stderr=subprocess.PIPE, text=True)
        try:
            assert ecu.stderr is not None
            assert "veh2.tracker listens on veh2" in ecu.stderr.readline()
            result = command(recorded, "--can", f"udp:{port}", "--without", "veh2.tracker")
            assert ecu.wait(GUARD_S) == 0
            # Of its frames; before the first BenchSync it has sent its status, too.
            veh2.wait_for(len(wanted), can_id)
        finally:
            ecu.kill()
            ecu.communicate()
    assert result.exit_code == 0
    assert [data for number, data in veh2.frames if number == can_id] == wanted
    assert len(wanted) == 40


def test_ctrl_c_ends_it_and_says_how_far_it_came(recorded, port):
    arguments = [sys.executable, "-m", "bench.cli", "replay", str(recorded.path), "--can", f"udp:{port}"]
    with Listener(port + 1) as veh1:
        process = subprocess.Popen(
            [*arguments, "--speed", "0.01"], cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        veh1.wait_for(20)
        process.send_signal(signal.SIGINT)
        output, errors = process.communicate(timeout=GUARD_S)
    assert process.returncode == 1
    assert "frames sent in" in output
    assert errors == "platoon: ended by Ctrl-C\n"


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--can", "direct"], "nobody else could see the frames"),
        (["--can", "veh9=udp"], "--can veh9=udp: .* has the buses v2v, veh1, veh2, veh3"),
        (["--only", "veh7"], "--only veh7: .* has the buses v2v, veh1, veh2, veh3"),
        (["--without", "veh7.tracker"], "tells of the senders conductor, plant, veh1.planner"),
        (["--speed", "0"], "--speed 0: give a number from 0.001 to 1000, or max"),
        (["--speed", "nan"], "--speed nan: give"),
        (["--from", "100"], "has no such frames in that time"),
        (["--from", "2", "--to", "1"], "give an end after the start"),
    ],
)
def test_what_cannot_be_done_is_said(recorded, options, words):
    with pytest.raises(BadInput, match=words):
        command(recorded, *options)


def test_a_message_that_was_never_decoded_is_known_by_the_attached_dbc(recorded):
    never = load_codecs(3)["veh2"].can_id("TorqueCommandRear")
    topics = recorded.topics
    hidden = topics.pop("/signals/veh2/TorqueCommandRear")
    try:
        assert not Selection.of(recorded, without=["veh2.tracker"]).has("veh2", never)
    finally:
        topics[hidden.topic] = hidden


class DownLink(DirectLink):
    """A bus that takes three frames, then no more."""

    taken = 0

    def send(self, can_id, data):
        assert len(data) <= 8
        self.taken += 1
        if self.taken > 3:
            raise LinkError(f"bus {self.name}: frame 0x{can_id:03X} cannot be sent: Network is down")


def test_frames_that_a_bus_does_not_take_are_counted_and_the_others_go_on(recorded):
    hub = Hub()
    played = play(in_order(recorded.frames()), {bus: DownLink(bus, hub) for bus in recorded.buses}, float("inf"))
    for bus in recorded.buses:
        assert played.sent[bus] == 3
        assert played.failed[bus] == len(recorded.frame_table(bus)) - 3
    assert "Network is down" in played.reason


def test_what_goes_wrong_while_the_log_is_read_is_told(recorded):
    def broken():
        yield from list(in_order(recorded.frames()))[:10]
        raise BadInput("a message cannot be decoded")

    hub = Hub()
    with pytest.raises(BadInput, match="cannot be decoded"):
        play(broken(), {bus: DirectLink(bus, hub) for bus in recorded.buses}, float("inf"))
