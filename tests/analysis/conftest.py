"""Logs of made-up motion with every message the analysis reads, and one log of a real run."""

from dataclasses import dataclass, field

import numpy as np
import pytest

from bench.bus.codec import load_codecs
from bench.bus.link.address import Address
from bench.conductor.options import RunOptions
from bench.conductor.run import run
from bench.cycle import CYCLE_S
from bench.record import Run, RunWriter
from bench.scenario import load

WHEELS = ("fl", "rl", "rr", "fr")
TRUTH_NAMES = (
    *("X", "Y", "psi", "phi", "v_x", "v_y", "gamma", "mu", "a_x", "a_y", "steering_angle"),
    *(f"{name}_{wheel}" for name in ("omega", "wheel_torque") for wheel in WHEELS),
)
LANE_Y, SPEED, GAP = 7.0, 20.0, 10.0


@dataclass
class Motions:
    """The motion of N vehicles over n cycles, (N, n) each, as a platoon in formation to begin with."""

    vehicles: int
    cycles: int
    X: np.ndarray = field(init=False)
    Y: np.ndarray = field(init=False)
    psi: np.ndarray = field(init=False)
    v_x: np.ndarray = field(init=False)
    gamma: np.ndarray = field(init=False)
    mu: np.ndarray = field(init=False)
    # More of the ground truth that is not 0: name -> (N, n).
    more: dict = field(default_factory=dict)
    # Values of messages that are not the start values: (vehicle, message) -> signal -> (n,).
    signals: dict = field(default_factory=dict)
    # (vehicle, message) that are never sent.
    silent: set = field(default_factory=set)
    # Time in s and event.
    events: list = field(default_factory=list)

    def __post_init__(self):
        shape = (self.vehicles, self.cycles)
        self.X = SPEED * self.t - GAP * np.arange(self.vehicles)[:, None]
        self.Y, self.v_x = np.full(shape, LANE_Y), np.full(shape, SPEED)
        self.psi, self.gamma, self.mu = np.zeros(shape), np.zeros(shape), np.full(shape, 0.8)

    @property
    def t(self):
        return np.arange(self.cycles) * CYCLE_S

    def say(self, vehicle, message, **signals):
        self.signals.setdefault((vehicle, message), {}).update(signals)


def scenario_of(vehicles, seconds, overrides=()):
    """A scenario of as many vehicles, formed from the begin."""
    base = load("formation", ["duration_s=1.0", *overrides])
    first = base.vehicles[0]
    starts = [first.model_copy(update={"x_m": -GAP * i, "y_m": LANE_Y, "speed_mps": SPEED}) for i in range(vehicles)]
    return base.model_copy(update={"vehicles": tuple(starts), "duration_s": seconds, "name": "made-up"})


def write(path, motions, result=None, truth_names=TRUTH_NAMES, overrides=()):
    """Write the log of made-up motion; messages without values of their own carry their start values."""
    codecs = load_codecs(motions.vehicles)
    scenario = scenario_of(motions.vehicles, motions.cycles * CYCLE_S, overrides)
    writer = RunWriter(
        path,
        codecs=codecs,
        truth_names=truth_names,
        vehicles=motions.vehicles,
        metadata={"scenario": scenario.name, "seed": "1"},
        attachments={"scenario.toml": scenario.toml().encode()},
    )
    for vehicle in range(1, motions.vehicles + 1):
        motions.signals.setdefault((vehicle, "PlannerStatus"), {}).setdefault("Slot", np.full(motions.cycles, vehicle))
    for cycle in range(motions.cycles):
        time_ns = cycle * 10_000_000
        for vehicle in range(1, motions.vehicles + 1):
            bus = f"veh{vehicle}"
            codec = codecs[bus]
            for name in codec.names:
                if (vehicle, name) in motions.silent:
                    continue
                own = motions.signals.get((vehicle, name), {})
                values = codec.start_values(name) | {signal: value[cycle] for signal, value in own.items()}
                writer.frame(bus, time_ns, *codec.encode(name, values, cycle), 0)
            rows = {name: getattr(motions, name) for name in TRUTH_NAMES if hasattr(motions, name)} | motions.more
            known = {name: values[vehicle - 1][cycle] for name, values in rows.items()}
            writer.truth(vehicle, time_ns, [float(known.get(name, 0.0)) for name in truth_names])
    for time_s, event in motions.events:
        writer.event(round(time_s * 1e9), event)
    ended = {"status": "completed", "cycles": str(motions.cycles), "wall_s": "0.5"}
    writer.close(ended if result is None else result)
    return path


@pytest.fixture
def run_of(tmp_path):
    """`run_of(motions)`: the log of made-up motion, open."""
    return lambda motions, **options: Run(write(tmp_path / "run.mcap", motions, **options))


@pytest.fixture(scope="session")
def formation_log(tmp_path_factory):
    """The log of a real run of the shipped scenario `formation`, its first 6 s, all in one process."""
    path = tmp_path_factory.mktemp("formation") / "run.mcap"
    address = Address.parse("direct")
    run(
        RunOptions(
            load("formation", ["duration_s=6.0"]), address=address, out=path, command_line=["test"], on_progress=None
        )
    )
    return path


@pytest.fixture
def formation(formation_log):
    return Run(formation_log)
