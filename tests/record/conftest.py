"""Small logs with random frames of every message, written by the real writer."""

import random
import struct

import pytest

from bench.bus.codec import load_codecs
from bench.bus.link.address import Address
from bench.conductor.options import RunOptions
from bench.conductor.run import run
from bench.cycle import CYCLE_NS
from bench.events import ProcessOutput
from bench.record import RunWriter
from bench.scenario import load

VEHICLES = 2
TRUTH_NAMES = ("X", "Y", "psi", "phi", "v_x", "v_y", "gamma", "F_z_fl")
SCENARIO = b"[platoon]\nlane_y_m = 7.0\n[[vehicles]]\ny_m = 0.0\n[[vehicles]]\ny_m = 3.5\n"


class Recorded:
    """A log and what was put into it: frames as (time_ns, bus, can_id, data, receive_ns), truth by vehicle, events."""

    def __init__(self, path):
        self.path = path
        self.frames = []
        self.truth = {vehicle: [] for vehicle in range(1, VEHICLES + 1)}
        self.events = []


def open_writer(path, codecs, timeline=None):
    return RunWriter(
        path,
        codecs=codecs,
        truth_names=TRUTH_NAMES,
        vehicles=VEHICLES,
        metadata={"seed": "7"},
        attachments={"scenario.toml": SCENARIO},
        truth_units={"X": "m", "psi": "rad"},
        timeline=timeline,
    )


def present(codec):
    """The messages of a bus that the vehicles of these logs send."""
    return [name for name in codec.names if not name.startswith("V2V") or int(name.split("_")[1]) <= VEHICLES]


def write_log(path, codecs, cycles=40, seed=1, change=None):
    """Write `cycles` cycles of random frames; `change(frame)` may alter or drop (None) each before it is recorded."""
    generator = random.Random(seed)
    recorded = Recorded(path)
    writer = open_writer(path, codecs)
    for cycle in range(cycles):
        time_ns = cycle * CYCLE_NS
        for bus, codec in codecs.items():
            for name in present(codec):
                message = codec.message(name)
                values = {s.name: generator.uniform(float(s.minimum), float(s.maximum)) for s in message.signals}
                frame = (time_ns, bus, *codec.encode(name, values, cycle), generator.getrandbits(62))
                frame = change(frame) if change else frame
                if frame:
                    recorded.frames.append(frame)
                    writer.frame(frame[1], frame[0], frame[2], frame[3], frame[4])
        for vehicle in recorded.truth:
            row = [generator.gauss(0.0, 100.0) for _ in TRUTH_NAMES]
            recorded.truth[vehicle].append((time_ns, row))
            writer.truth(vehicle, time_ns, row)
        if cycle % 10 == 3:
            recorded.events.append((time_ns, ProcessOutput("plant", f"ünusual cycle {cycle}")))
            writer.event(*recorded.events[-1])
    writer.close({"status": "completed", "cycles": str(cycles)})
    return recorded


@pytest.fixture(scope="session")
def codecs():
    return load_codecs(VEHICLES)


@pytest.fixture(scope="session")
def recorded(codecs, tmp_path_factory):
    return write_log(tmp_path_factory.mktemp("log") / "run.mcap", codecs)


@pytest.fixture(scope="session")
def real_log(tmp_path_factory):
    """The log of a real run of three vehicles, 1 s long."""
    path = tmp_path_factory.mktemp("real") / "formation.mcap"
    scenario = load("formation", ["duration_s=1.0"])
    run(RunOptions(scenario, address=Address.parse("direct"), out=path, command_line=["test"]))
    return path


@pytest.fixture
def make_log(codecs, tmp_path):
    """Write a log into the test's folder: `make_log(name, **options of write_log)`."""
    return lambda name, **options: write_log(tmp_path / name, codecs, **options)


def same_double(a, b):
    """Equal bit by bit, so that NaN equals itself and -0.0 is not 0.0."""
    return struct.pack("<d", a) == struct.pack("<d", b)
