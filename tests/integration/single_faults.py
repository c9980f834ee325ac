"""Every kind of fault on every vehicle at several times: how near vehicles come, and when who says what is wrong.

`.venv/bin/python -m tests.integration.single_faults` makes the table of `docs/faults.md`; it runs the bench more than a
hundred times. Stopped and started again it continues: the result of each run is kept in `build/single-faults` as long
as no code has changed that a run depends on.
"""

import argparse
import hashlib
import json
import math
import os
import sys
import tempfile
import warnings
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np

from bench.analysis.clearance import clearances
from bench.analysis.metrics import CLEARANCE_WITH_FAULT_M
from bench.analysis.motion import motion
from bench.analysis.requirements import LEAST_DISTANCE_M
from bench.benchmarks.comfort.runs import ROOT
from bench.bus.codec import load_codecs
from bench.bus.link.address import Address
from bench.bus.states import Cause
from bench.campaign.version import code_version
from bench.conductor.options import RunOptions
from bench.conductor.run import run
from bench.record.reader import Run
from bench.scenario import load

VEHICLES = (1, 2, 3)
TIMES = (0.0, 0.4, 1.0, 2.0, 6.0)
KEPT = ROOT / "build" / "single-faults"

KINDS: dict[str, tuple[str, int | None]] = {
    "Reference lost": ('kind="frame_loss",bus="{bus}",message="Reference"', 0),
    "Reference delayed": ('kind="frame_delay",bus="{bus}",message="Reference",cycles=3,jitter_cycles=2', 0),
    "Reference doubled": ('kind="frame_duplicate",bus="{bus}",message="Reference"', None),
    "Reference swapped": ('kind="frame_reorder",bus="{bus}",message="Reference"', 2),
    "Reference corrupted": ('kind="frame_corrupt",bus="{bus}",message="Reference",bits=3', 0),
    "Reference counter stuck": ('kind="counter_stuck",bus="{bus}",message="Reference"', 1),
    "Reference yaw rate stuck": ('kind="signal_stuck",bus="{bus}",message="Reference",signal="YawRate"', None),
    "Reference speed stuck": ('kind="signal_stuck",bus="{bus}",message="Reference",signal="VelocityX"', None),
    "steering command lost": ('kind="frame_loss",bus="{bus}",message="SteeringCommand"', 3),
    "steering command stuck": (
        'kind="signal_stuck",bus="{bus}",message="SteeringCommand",signal="SteeringAngle"',
        None,
    ),
    "torque command stuck": ('kind="signal_stuck",bus="{bus}",message="TorqueCommandFront",signal="TorqueFL"', None),
    "all frames lost, v2v": ('kind="frame_loss",bus="v2v"', 1),
    # Its ECUs cannot say so on that bus; the others do.
    "all frames lost, vehicle": ('kind="frame_loss",bus="{bus}"', 6),
    "half of all lost, vehicle": ('kind="frame_loss",bus="{bus}",probability=0.5', 2),
    "half of all lost, v2v": ('kind="frame_loss",bus="v2v",probability=0.5', 3),
    "bursts of loss, vehicle": ('kind="frame_loss",bus="{bus}",bursts={{to_bad=0.05,to_good=0.2}}', None),
    "all delayed, v2v": ('kind="frame_delay",bus="v2v",cycles=1,jitter_cycles=3', 2),
    "all corrupted, v2v": ('kind="frame_corrupt",bus="v2v"', 1),
    "broadcast position stuck": ('kind="signal_stuck",bus="v2v",message="V2VPosition_{n}",signal="X"', 4),
    "broadcast speed stuck": ('kind="signal_stuck",bus="v2v",message="V2VMotion_{n}",signal="Speed"', None),
    "broadcast counter stuck": ('kind="counter_stuck",bus="v2v",message="V2VMotion_{n}"', 2),
    "X off by 5 m": ('kind="sensor_bias",bus="{bus}",message="VehiclePosition",signal="X",bias=5.0', 0),
    "Y off by 2 m": ('kind="sensor_bias",bus="{bus}",message="VehiclePosition",signal="Y",bias=2.0', 0),
    "yaw off by 0.1 rad": ('kind="sensor_bias",bus="{bus}",message="VehicleAttitude",signal="Yaw",bias=0.1', 0),
    "v_x off by 3 m/s": ('kind="sensor_bias",bus="{bus}",message="VehicleMotion",signal="VelocityX",bias=3.0', 0),
    "v_y off by 1 m/s": ('kind="sensor_bias",bus="{bus}",message="VehicleMotion",signal="VelocityY",bias=1.0', 0),
    "yaw rate off by 0.2 rad/s": (
        'kind="sensor_bias",bus="{bus}",message="VehicleMotion",signal="YawRate",bias=0.2',
        6,
    ),
    "wheel speed off by 20 rad/s": (
        'kind="sensor_bias",bus="{bus}",message="WheelSpeedsFront",signal="WheelSpeedFL",bias=20.0',
        0,
    ),
    "X noisy, 1 m": ('kind="sensor_noise",bus="{bus}",message="VehiclePosition",signal="X",sigma=1.0', 3),
    "Y noisy, 1 m": ('kind="sensor_noise",bus="{bus}",message="VehiclePosition",signal="Y",sigma=1.0', 3),
    "yaw noisy, 0.1 rad": ('kind="sensor_noise",bus="{bus}",message="VehicleAttitude",signal="Yaw",sigma=0.1', 3),
    "v_x noisy, 2 m/s": ('kind="sensor_noise",bus="{bus}",message="VehicleMotion",signal="VelocityX",sigma=2.0', 3),
    "yaw rate noisy, 0.2 rad/s": (
        'kind="sensor_noise",bus="{bus}",message="VehicleMotion",signal="YawRate",sigma=0.2',
        3,
    ),
    "position stuck": ('kind="signal_stuck",bus="{bus}",message="VehiclePosition",signal="X"', 1),
    "yaw stuck": ('kind="signal_stuck",bus="{bus}",message="VehicleAttitude",signal="Yaw"', None),
    "yaw rate stuck": ('kind="signal_stuck",bus="{bus}",message="VehicleMotion",signal="YawRate"', None),
    "motion sensor gone": ('kind="sensor_dropout",bus="{bus}",message="VehicleMotion"', 0),
    "position sensor gone": ('kind="sensor_dropout",bus="{bus}",message="VehiclePosition"', 0),
    "planner babbles": ('kind="babbling_idiot",node="{bus}.planner"', 10),
    "planner off the bus": ('kind="bus_off",node="{bus}.planner"', 0),
    "tracker off the bus": ('kind="bus_off",node="{bus}.tracker"', 3),
    "plant off the bus": ('kind="bus_off",node="{bus}.plant"', 0),
    "radio of one out": ('kind="v2v_outage",vehicle={n}', 1),
    "radio of all out": ('kind="v2v_outage"', 1),
    "planner crashes": ('kind="ecu_crash",ecu="{bus}.planner"', 0),
    "planner crashes, back after 1 s": ('kind="ecu_crash",ecu="{bus}.planner",for_s=1.0', 0),
    "planner hangs for 1 s": ('kind="ecu_hang",ecu="{bus}.planner",for_s=1.0', 0),
    "tracker crashes": ('kind="ecu_crash",ecu="{bus}.tracker"', 3),
    "tracker crashes, back after 1 s": ('kind="ecu_crash",ecu="{bus}.tracker",for_s=1.0', 3),
    "tracker hangs for 1 s": ('kind="ecu_hang",ecu="{bus}.tracker",for_s=1.0', 3),
    "steering stuck": ('kind="actuator_stuck",vehicle={n},actuator="steering"', None),
    "steering stuck at 0.03 rad": ('kind="actuator_stuck",vehicle={n},actuator="steering",value=0.03', 3),
    "wheel torque stuck at 600 N m": ('kind="actuator_stuck",vehicle={n},actuator="torque_fl",value=600.0', None),
    "wheel torque stuck at -900 N m": ('kind="actuator_stuck",vehicle={n},actuator="torque_rr",value=-900.0', None),
    "front axle softens": ('kind="axle_softening",vehicle={n},axle="front"', None),
    "rear axle softens": ('kind="axle_softening",vehicle={n},axle="rear"', None),
    "ice under one": ('kind="ice_patch",vehicle={n}', None),
    "ice under all": ('kind="ice_patch"', None),
    "front left tyre blows out": ('kind="tyre_blowout",vehicle={n},wheel="fl"', None),
    "rear left tyre blows out": ('kind="tyre_blowout",vehicle={n},wheel="rl"', None),
    "rear right tyre blows out": ('kind="tyre_blowout",vehicle={n},wheel="rr"', None),
    "front right tyre blows out": ('kind="tyre_blowout",vehicle={n},wheel="fr"', None),
}
"""Keys of a `[[faults]]` table without its time, and cycles after which the bus must say so.

None where that depends on how the vehicle moves: what is stuck is wrong only once it should have changed, and tyres and
road show only while they are used.
"""


@dataclass(frozen=True)
class Case:
    """One fault in one run."""

    name: str
    vehicle: int
    at_s: float

    @property
    def fault(self) -> str:
        """The fault as a table of TOML."""
        keys = KINDS[self.name][0].format(bus=f"veh{self.vehicle}", n=self.vehicle)
        return f"{{{keys},at_s={self.at_s}}}"

    @property
    def is_of_one(self) -> bool:
        """Whether the fault is different for each vehicle."""
        return "{" in KINDS[self.name][0].replace("{{", "")


@dataclass(frozen=True)
class Outcome:
    """What came of it.

    Attributes:
        distance_m: least distance between two vehicles' centres of mass (m).
        clearance_m: least distance between two vehicles' bodies, negative where they overlap (m).
        when_s: when that was (s).
        detected: cycles from the fault's beginning to the first frame that says so; None where none did.
        by: who said so, and what cause: `veh1.tracker ReferenceLost`.
        slowest: the lowest speed of any vehicle at the end (m/s).
    """

    distance_m: float
    clearance_m: float
    when_s: float
    detected: int | None
    by: str
    slowest: float

    @property
    def is_safe(self) -> bool:
        """Whether the vehicles stayed as far apart as is required with a fault."""
        return self.distance_m > LEAST_DISTANCE_M and self.clearance_m >= CLEARANCE_WITH_FAULT_M


def examine(case: Case, duration_s: float = 10.0) -> Outcome:
    """Run `formation` with the fault, all in this process."""
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        out = Path(folder) / "run.mcap"
        scenario = load("formation", [f"faults=[{case.fault}]", f"duration_s={duration_s}"])
        run(RunOptions(scenario, address=Address.parse("direct"), out=out, command_line=["single_faults"]))
        recorded = Run(out)
        truth = motion(recorded)
        distance = min(float(each.min()) for each in truth.distances().values())
        apart = np.stack([*clearances(truth).values()]).min(axis=0)
        detected, by = _first_word(recorded, case.at_s)
        when = float(truth.t[apart.argmin()])
        return Outcome(distance, float(apart.min()), when, detected, by, float(truth.v_x[:, -1].min()))


def _first_word(recorded: Run, at_s: float) -> tuple[int | None, str]:
    names = {s.name: s for s in load_codecs(1)["veh1"].message("PlannerStatus").signals}["Cause"].choices or {}
    first = (math.inf, "")
    for number in VEHICLES:
        for role in ("planner", "tracker"):
            bus, message = f"veh{number}", f"{role.capitalize()}Status"
            if f"/signals/{bus}/{message}" not in recorded.topics:
                # Not one frame of it has come.
                continue
            status = recorded.message(bus, message)
            cycles = np.round(np.asarray(status["t"]) * 100).astype(int)
            causes_said = np.asarray(status["Cause"])
            # In its first cycle a planner cannot have heard anybody.
            real = (causes_said > 0) & ((cycles > 0) | (causes_said != Cause.PEER_MISSING))
            said = np.flatnonzero(real & (cycles >= round(at_s * 100)))
            if said.size:
                word = f"veh{number}.{role} {names[int(causes_said[said[0]])]}"
                first = min(first, (int(cycles[said[0]]) - round(at_s * 100), word))
    return (None, "") if first[0] == math.inf else (int(first[0]), first[1])


def cases(times: tuple[float, ...] = TIMES, *, every: bool = False) -> Iterator[Case]:
    """All kinds on all vehicles, each at one of the times in turn; with `every` at each of them."""
    turn = 0
    for name in KINDS:
        for vehicle in VEHICLES:
            if vehicle > 1 and not Case(name, vehicle, 0.0).is_of_one:
                continue
            turn += 1
            for time in times if every else times[turn % len(times) :][:1]:
                yield Case(name, vehicle, time)


def _job(case: Case, folder: Path) -> tuple[Case, Outcome | str]:
    """Return a case with what came of it, which is kept in a folder, or with the error that ended it."""
    kept = folder / f"{hashlib.sha256(case.fault.encode()).hexdigest()[:16]}.json"
    if kept.exists():
        return case, Outcome(**json.loads(kept.read_text(encoding="utf-8")))
    try:
        outcome = examine(case)
    except Exception as error:  # noqa: BLE001 - one run that fails is a line of the table, not its end
        return case, f"{type(error).__name__}: {error}"
    part = kept.with_suffix(f".{os.getpid()}")
    part.write_text(json.dumps(asdict(outcome)), encoding="utf-8")
    part.replace(kept)
    return case, outcome


def main() -> int:
    """Print the table; 1 where two vehicles came too near or a run failed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--every", action="store_true", help="each fault at each of the times, not at one of them")
    parser.add_argument("--only", default="", help="kinds with this in their name")
    parser.add_argument("--processes", type=int, default=os.cpu_count(), help="how many runs are made at a time")
    chosen = parser.parse_args()
    folder = KEPT / code_version()
    folder.mkdir(parents=True, exist_ok=True)
    headings = ("fault", "vehicle", "at s", "distance m", "clearance m", "at s", "first word", "cycles", "end m/s")
    _write_row(*headings)
    _write_row(*("---" for _ in headings))
    failed = 0
    todo = [case for case in cases(every=chosen.every) if chosen.only in case.name]
    with ProcessPoolExecutor(chosen.processes) as pool:
        for case, came in pool.map(partial(_job, folder=folder), todo):
            start = case.name, str(case.vehicle) if case.is_of_one else "all", f"{case.at_s:g}"
            if isinstance(came, str):
                failed += 1
                _write_row(*start, "FAILED", "", "", came, "", "")
                continue
            failed += not came.is_safe
            near = (f"{came.distance_m:.2f}", f"{came.clearance_m:.2f}", f"{came.when_s:.2f}")
            after = "" if came.detected is None else str(came.detected)
            _write_row(*start, *near, came.by, after, f"{came.slowest:.1f}")
    return int(failed > 0)


def _write_row(*cells: str) -> None:
    sys.stdout.write(f"| {' | '.join(cells)} |\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())
