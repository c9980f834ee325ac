"""One run of a checkout, measured from outside: by the kernel, and by the log that it has written."""

import itertools
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bench.analysis.timing import timing
from bench.benchmarks.against.checkout import Checkout, environment
from bench.benchmarks.against.processes import Command, Usage, Watch
from bench.errors import RunFailed
from bench.names import CONDUCTOR, PLANT, vehicle_bus
from bench.record.reader import Run

STEPS = {"tracker": "TrackerTiming", "planner": "PlannerTiming"}
"""The messages whose StepTime is the time of an ECU's whole step."""

_MICROSECONDS_PER_MS = 1000.0

_numbers = itertools.count()


@dataclass(frozen=True)
class NodeCost:
    """What one process of a run took.

    Attributes:
        user, system: processor time in s per simulated second, without its start; NaN if the run was too short.
        peak_bytes: peak resident memory.
        shared_bytes: largest proportional memory (PSS).
    """

    user: float
    system: float
    peak_bytes: float
    shared_bytes: float


@dataclass(frozen=True)
class Steps:
    """The times that an ECU's whole steps took.

    Attributes:
        times_ms: (vehicles, n) a row for each vehicle; each value is the largest of `cycles` cycles.
        cycles: number of cycles between two messages.
    """

    times_ms: NDArray[np.float64]
    cycles: int

    def largest_of(self, cycles: int) -> NDArray[np.float64]:
        """Return the largest times of every `cycles` cycles, of all vehicles (m,), without those before any step."""
        group = max(1, cycles // self.cycles)
        whole = self.times_ms[:, : self.times_ms.shape[1] // group * group]
        largest: NDArray[np.float64] = whole.reshape(whole.shape[0], -1, group).max(axis=2).ravel()
        return largest[largest > 0]


@dataclass(frozen=True)
class Deadlines:
    """What became of the deadlines of a run in real time.

    Attributes:
        missed: missed deadlines of the ECUs as a fraction of all.
        largest_ms: largest response time of an ECU.
    """

    missed: float
    largest_ms: float


@dataclass(frozen=True)
class RunCost:
    """What a run took.

    Attributes:
        simulated_s: its duration.
        cpu_s: user and system time in s of all its processes, from the start of the command to its end.
        start_s: wall-clock time in s from the start of the command to the first frame.
        lockstep_s: wall-clock time in s from the first cycle to the last.
        recorder_s: processor time in s of recording, as the log has it; NaN if it has none.
        steps: of each ECU by role.
        nodes: of each process by name.
        deadlines: of a run in real time.
    """

    simulated_s: float
    cpu_s: float
    start_s: float
    lockstep_s: float
    recorder_s: float
    steps: Mapping[str, Steps]
    nodes: Mapping[str, NodeCost]
    deadlines: Deadlines | None


def command_of(
    checkout: Checkout, scenario: Path, can: str, seconds: float, log: Path, *options: str
) -> Sequence[str | Path]:
    """Return the command that runs a scenario without a report."""
    duration = f"duration_s={seconds:g}"
    return [checkout.platoon, "run", scenario, "--can", can, "--set", duration, "--no-report", "--out", log, *options]


def measure(checkout: Checkout, scenario: Path, can: str, seconds: float, folder: Path, *options: str) -> RunCost:
    """Run a scenario; return what it took. The log, in `folder`, is deleted.

    Raises:
        RunFailed: the run did not complete.
    """
    log, said = (folder / f"{next(_numbers)}{suffix}" for suffix in (".mcap", ".txt"))
    with said.open("wb") as output:
        started_ns = time.time_ns()
        command = command_of(checkout, scenario, can, seconds, log, *options)
        with (
            Command(command, cwd=folder, env=environment(), stdout=output, stderr=output) as running,
            Watch(running.pid) as watch,
        ):
            running.wait()
    run = completed(log, said, checkout)
    cost = RunCost(
        simulated_s=seconds,
        cpu_s=running.cpu_s,
        start_s=(next(run.frames()).receive_ns - started_ns) / 1e9,
        lockstep_s=float(run.result["wall_s"]),
        recorder_s=float(run.result.get("recorder_cpu_s", "nan")),
        steps={role: _steps(run, message) for role, message in STEPS.items()},
        nodes=_nodes(watch.usages, running.pid, *_progress(run)),
        deadlines=_deadlines(run),
    )
    log.unlink()
    return cost


def completed(log: Path, said: Path, checkout: Checkout) -> Run:
    """Return the log of a run.

    Raises:
        RunFailed: it did not complete; with the last lines of what the command said.
    """
    # Its exit code is 1 as well if no platoon was formed, as after 1 s.
    if log.exists():
        run = Run(log)
        if run.result.get("status") == "completed":
            return run
    last = "\n".join(said.read_text(errors="replace").splitlines()[-5:])
    raise RunFailed(f"a run of {checkout.name} did not complete:\n{last}")


def _steps(run: Run, message: str) -> Steps:
    buses = [vehicle_bus(vehicle) for vehicle in range(1, run.vehicles + 1)]
    if not all(run.has(bus, message) for bus in buses):
        return Steps(np.empty((len(buses), 0)), 1)
    rows = [run.signal(bus, message, "StepTime")[1] / _MICROSECONDS_PER_MS for bus in buses]
    shortest = min(row.size for row in rows)
    codec = run.codec(buses[0])
    return Steps(np.stack([row[:shortest] for row in rows]), codec.period(message) if codec else 1)


def _progress(run: Run) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the wall-clock times (ns since 1970) of the frames of a bus, and their simulated times (s), (n,) each."""
    table = run.frame_table(vehicle_bus(1))
    wall = table["receive"].astype(np.float64)
    order = np.argsort(wall, kind="stable")
    return wall[order], table["time"][order] / 1e9


def _nodes(
    usages: Mapping[int, Usage], conductor: int, wall_ns: NDArray[np.float64], simulated_s: NDArray[np.float64]
) -> dict[str, NodeCost]:
    """Return the cost of each process that was sampled during the run."""
    found = {}
    for pid, usage in usages.items():
        at = np.array(usage.at_ns, dtype=np.float64)
        inside = np.flatnonzero((at >= wall_ns[0]) & (at <= wall_ns[-1]))
        name = CONDUCTOR if pid == conductor else usage.name
        user = system = np.nan
        if inside.size > 1:
            first, last = inside[0], inside[-1]
            passed = float(np.diff(np.interp(at[[first, last]], wall_ns, simulated_s))[0])
            user, system = (
                (times[last] - times[first]) / passed if passed > 0.0 else np.nan
                for times in (usage.user_s, usage.system_s)
            )
        elif not inside.size:
            continue
        found[name] = NodeCost(user, system, usage.peak_bytes, usage.shared_bytes)
    return found


def _deadlines(run: Run) -> Deadlines | None:
    times = timing(run)
    if times is None:
        return None
    ecus = [node.response_ms for node in times.nodes if not node.name.endswith(f".{PLANT}")]
    return Deadlines(times.miss_rate, max((float(each.max(initial=0.0)) for each in ecus), default=0.0))
