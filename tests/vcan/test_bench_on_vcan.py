"""The bench on SocketCAN's virtual links, with the tools that people use there."""

import re
import shutil
import signal
import subprocess
import threading
import time
from pathlib import Path

import pytest
from typer.testing import CliRunner

from bench.bus.codec import DBC_DIR, load_codecs
from bench.bus.link.address import Address
from bench.bus.link.kernel_links import lack_of_can
from bench.bus.link.opening import open_link
from bench.cli.main import app
from bench.conductor.options import RunOptions
from bench.conductor.run import run
from bench.ecu.loading import DEFAULT_ECUS
from bench.errors import RunFailed
from bench.events import ReceptionErrors
from bench.record.compare import diff
from bench.record.reader import Run
from bench.replay.order import in_order
from bench.scenario import load

SIMPLE_FILE = Path(__file__).parents[1] / "ecus" / "simple.py"
SIMPLE = {"planner": f"{SIMPLE_FILE}:CruisePlanner", "tracker": f"{SIMPLE_FILE}:SpeedTracker"}
PATIENCE_S = 120.0
"""User-mode Linux has one core and slow system calls."""

pytestmark = [
    pytest.mark.kernel_can,
    pytest.mark.skipif(bool(lack_of_can()), reason=f"this kernel has no CAN: {lack_of_can()}"),
]
needs_can_utils = pytest.mark.skipif(shutil.which("candump") is None, reason="can-utils is not installed")


def log(out: Path, can: str, *overrides: str, ecus: dict[str, str] = SIMPLE, realtime: bool = False) -> Run:
    result = run(
        RunOptions(
            load("formation", list(overrides)),
            address=Address.parse(can),
            out=out,
            command_line=["test"],
            ecus=ecus,
            silence_s=PATIENCE_S,
            realtime=realtime,
        )
    )
    assert result.frames_lost == 0
    return Run(result.path)


class Candump:
    """candump on all links of three vehicles, from before a run to its end; `frames` is what it saw by link."""

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            ["candump", "-L", *(f"vcan{number}" for number in range(4))], stdout=subprocess.PIPE, text=True
        )
        self.lines: list[str] = []
        self._reader = threading.Thread(target=self._read)
        self._reader.start()
        time.sleep(2.0)

    def _read(self) -> None:
        assert self._process.stdout is not None
        self.lines += self._process.stdout

    def __enter__(self) -> "Candump":
        return self

    def __exit__(self, *_: object) -> None:
        time.sleep(2.0)
        self._process.send_signal(signal.SIGINT)
        self._reader.join(PATIENCE_S)
        self._process.wait()

    def frames(self, link: str) -> list[tuple[int, str]]:
        found = (re.match(rf"\([\d.]+\) {link} ([0-9A-F]+)#([0-9A-F]*)$", line.strip()) for line in self.lines)
        return [(int(match[1], 16), match[2]) for match in found if match]


CRASH = 'faults=[{kind = "ecu_crash", at_s = 0.1, for_s = 0.1, ecu = "veh2.tracker"}]'


@pytest.mark.nightly
def test_frames_are_byte_identical_on_vcan_and_direct(tmp_path: Path) -> None:
    """Of the paper's ECUs; those of simple ones are so in the next test, those of udp in tests/integration."""
    first, other = (
        log(tmp_path / f"{can}.mcap", can, "duration_s=0.3", CRASH, ecus=dict(DEFAULT_ECUS))
        for can in ("direct", "vcan")
    )
    difference = diff(first.path, other.path)
    assert difference.same, str(difference)


@needs_can_utils
def test_candump_sees_every_frame_and_cantools_decodes_them(tmp_path: Path) -> None:
    """Of a run that has the same frames on vcan and direct."""
    with Candump() as candump:
        recorded = log(tmp_path / "run.mcap", "vcan", "duration_s=0.3", CRASH)
    difference = diff(log(tmp_path / "direct.mcap", "direct", "duration_s=0.3", CRASH).path, recorded.path)
    assert difference.same, str(difference)
    for number, bus in enumerate(("v2v", "veh1", "veh2", "veh3")):
        table = recorded.frame_table(bus)
        logged = [(int(row["can_id"]), row["data"].tobytes()[: row["length"]].hex().upper()) for row in table]
        assert sorted(candump.frames(f"vcan{number}")) == sorted(logged), bus
    lines = "".join(line for line in candump.lines if " vcan1 " in line)
    decoded = subprocess.run(
        ["cantools", "decode", "--single-line", str(DBC_DIR / "vehicle.dbc")],
        input=lines,
        capture_output=True,
        text=True,
        check=True,
    )
    speeds = re.findall(r"VehicleMotion\(.*?VelocityX: ([\d.]+) m/s", decoded.stdout)
    assert [float(speed) for speed in speeds] == recorded.message("veh1", "VehicleMotion")["VelocityX"].tolist()
    assert "Unknown" not in decoded.stdout
    assert re.search(r"SteeringCommand\(.*CommandState: Valid", decoded.stdout)


@needs_can_utils
def test_a_frame_with_a_bad_crc_from_cansend_is_rejected_and_counted(tmp_path: Path) -> None:
    codec = load_codecs(3)["veh1"]
    can_id, data = codec.encode("SteeringCommand", {"SteeringAngle": 0.5, "CommandState": 1}, 0)
    spoiled = bytes([data[0] ^ 0x55, *data[1:]])
    over = threading.Event()

    def inject() -> None:
        # Once the run is under way, which its own frames say; only once.
        with open_link("veh1", Address.parse("vcan")) as link:
            while not over.wait(0.01):
                if any(got == 0x300 for got, _ in link.receive()):
                    subprocess.run(["cansend", "vcan1", f"{can_id:03X}#{spoiled.hex()}"], check=True)
                    return

    injector = threading.Thread(target=inject)
    injector.start()
    try:
        recorded = log(tmp_path / "run.mcap", "vcan", "duration_s=0.5")
    finally:
        over.set()
        injector.join()
    frames = [row["data"].tobytes() for row in recorded.frame_table("veh1") if row["can_id"] == can_id]
    assert frames.count(spoiled) == 1
    assert int(recorded.message("veh1", "PlantBusHealth")["E2EErrors"][-1]) == 1
    assert recorded.result["e2e_errors"] == "1"
    told = [event.fields for event in recorded.events if event.kind == ReceptionErrors.kind]
    assert {"message": "PlantBusHealth", "frames_lost": 0, "e2e_errors": 1} in told
    # Rejected: it is not what the vehicle steered by, nor did it take a good command's place.
    assert max(abs(recorded.truth(1)["steering_angle"])) < 0.1
    assert set(recorded.message("veh1", "ActuatorStatus")["ActuatorState"][2:]) == {1}


def test_an_ecu_that_hangs_goes_on_with_the_others(tmp_path: Path) -> None:
    fault = 'faults=[{kind = "ecu_hang", at_s = 0.05, for_s = 0.15, ecu = "veh1.planner"}]'
    recorded = log(tmp_path / "run.mcap", "vcan", "duration_s=0.3", fault)
    sent = recorded.message("veh1", "Reference")["t"].round(3).tolist()
    assert sent == [round(cycle / 100, 3) for cycle in range(30) if not 5 <= cycle < 20]


def test_real_time_runs_on_vcan(tmp_path: Path) -> None:
    recorded = log(tmp_path / "run.mcap", "vcan", "duration_s=0.5", realtime=True)
    assert recorded.result["status"] == "completed"
    assert recorded.message("veh1", "BenchSync")["Command"].tolist()[:-1] == [2] * 50


def test_a_link_that_goes_down_ends_the_run(tmp_path: Path) -> None:
    def pull(time_s: float) -> None:
        if time_s >= 0.2:
            subprocess.run(["ip", "link", "set", "vcan3", "down"], check=True)

    scenario, address = load("formation", ["duration_s=60.0"]), Address.parse("vcan")
    try:
        with pytest.raises(RunFailed, match=r"bus veh3: .* down"):
            run(
                RunOptions(
                    scenario, address=address, out=tmp_path / "a.mcap", command_line=[], on_progress=pull, ecus=SIMPLE
                )
            )
    finally:
        subprocess.run(["ip", "link", "set", "vcan3", "up"], check=True)
    assert Run(tmp_path / "a.mcap").result["status"] == "failed"


def test_a_replayed_log_is_on_the_links_again(tmp_path: Path) -> None:
    """The frames of the run come a second time, without those of one ECU."""
    recorded = log(tmp_path / "run.mcap", "direct", "duration_s=0.3")
    codec = load_codecs(3)["veh2"]
    own = [codec.can_id(name) for name in codec.names if codec.message(name).senders == ["Tracker"]]
    wanted = [(f.can_id, f.data) for f in in_order(recorded.frames()) if f.bus == "veh2" and f.can_id not in own]
    seen: list[tuple[int, bytes]] = []
    with open_link("veh2", Address.parse("vcan")) as link:
        options = ["--can", "vcan", "--without", "veh2.tracker", "--speed", "0.5"]
        result = CliRunner().invoke(app, ["replay", str(recorded.path), *options])
        while frames := link.receive():
            seen += frames
    assert result.exit_code == 0, result.output
    assert seen == wanted
