"""Makes the reference logs anew: `make references`, on purpose, after a change of what ECUs send was looked at.

They are runs of today's ECUs, kept small: raw frames only, without the host's times and the messages with wall-clock
figures, and of what describes the run without host, commit and date. So the same ECUs give the same bytes on the same
machine, and `git status` tells whether anything has changed.
"""

import sys
import tempfile
from pathlib import Path

from bench.bus.link.address import Address
from bench.conductor.options import RunOptions
from bench.conductor.run import run
from bench.record.reader import Run
from bench.scenario import Scenario, load
from tests.reference.raw_log import write

FOLDER = Path(__file__).parent

FAULTS = (
    '{kind = "frame_loss", at_s = 0.1, for_s = 1.0, bus = "v2v", probability = 0.2}',
    '{kind = "frame_loss", at_s = 0.3, for_s = 0.3, bus = "veh1", message = "SteeringCommand", probability = 0.3}',
    '{kind = "frame_corrupt", at_s = 0.2, for_s = 0.2, bus = "veh3", probability = 0.2}',
    '{kind = "sensor_noise", at_s = 0.4, for_s = 0.2, bus = "veh1", message="VehiclePosition", signal="Y", sigma=1}',
    '{kind = "ecu_crash", at_s = 0.5, for_s = 0.3, ecu = "veh2.tracker"}',
    '{kind = "ecu_hang", at_s = 1.0, for_s = 0.2, ecu = "veh3.planner"}',
    '{kind = "ecu_crash", at_s = 1.2, for_s = 0.2, ecu = "veh1.planner"}',
)

RUNS: dict[str, tuple[str, tuple[str, ...]]] = {
    "formation": ("formation", ("duration_s=1.6",)),
    "five": ("five", ("duration_s=1.0",)),
    "faults": ("formation", ("duration_s=1.6", f"faults=[{', '.join(FAULTS)}]")),
}
"""Name of a log, its scenario and what is set in that."""

KEPT = ("scenario", "seed", "duration_s", "vehicles", "clock", "ecu ", "version ")
"""What the metadata keep, by how it begins."""


def make(scenario: Scenario, out: Path) -> None:
    """Run a scenario and write its log, cut down, to `out`."""
    with tempfile.TemporaryDirectory(prefix="platoon-") as folder:
        whole = Path(folder) / "run.mcap"
        run(RunOptions(scenario, address=Address.parse("direct"), out=whole, command_line=["tests.reference"]))
        cut_down(Run(whole), out)


def cut_down(recorded: Run, out: Path) -> None:
    """Write what a log needs to be run again."""
    head = {key: value for key, value in recorded.metadata.items() if key not in recorded.result}
    metadata = {
        "run": {key: value for key, value in head.items() if key.startswith(KEPT)},
        "result": {key: value for key, value in recorded.result.items() if not key.endswith("_s")},
    }
    clocked = {bus: recorded.wall_clock_ids(bus) for bus in recorded.buses}
    frames = (frame for frame in recorded.frames() if frame.can_id not in clocked[frame.bus])
    bare = (frame._replace(receive_ns=0) for frame in frames)
    write(out, bare, recorded.buses, recorded.scenario_text, metadata)


def main() -> None:
    """Make all reference logs."""
    for name, (scenario, overrides) in RUNS.items():
        out = FOLDER / f"{name}.mcap"
        before = out.read_bytes() if out.exists() else b""
        make(load(scenario, overrides), out)
        after = out.read_bytes()
        state = "as it was" if after == before else "changed" if before else "new"
        sys.stdout.write(f"{out}: {len(after) // 1000} kB, {state}\n")


if __name__ == "__main__":
    main()
