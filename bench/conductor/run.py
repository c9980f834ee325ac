"""A run from start to end: buses, processes, log."""

import gc
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from bench.bus.address import Address, settle
from bench.bus.codec import load_codecs
from bench.bus.link import open_link
from bench.conductor.interrupts import Interrupted, Interrupts
from bench.conductor.linux import as_batch_work
from bench.conductor.lockstep import Lockstep
from bench.conductor.stage import Stage
from bench.ecu.main import DEFAULT_ECUS, ecu_name, load_class
from bench.errors import BadInput, RunFailed
from bench.plant.description import read_description
from bench.scenario import Scenario
from platoon_fmu.build import default_fmu
from platoon_fmu.errors import FmuError

READY_S = 60.0
"""Wall-clock time in s that the processes may take to start; only a machine in trouble needs more."""

SILENCE_S = 10.0
"""Wall-clock time in s without a frame after which a run has failed."""

GRACE_S = 1.0
"""Wall-clock time in s that processes have to stop before they are killed."""


@dataclass(frozen=True)
class RunResult:
    """What a completed run says of itself.

    Attributes:
        path: the log.
        wall_s: wall-clock time in s from the first BenchSync to the end of the last cycle.
        startup_s: wall-clock time in s from the call of `run` to the first BenchSync.
        cycles: number of cycles.
        frames_lost: frames that anyone on the buses has lost.
    """

    path: Path
    wall_s: float
    startup_s: float
    cycles: int
    frames_lost: int


@dataclass(frozen=True)
class _Ending:
    """How a run ended: completed, failed or interrupted, and why."""

    status: str
    reason: str = ""


def run(
    scenario: Scenario,
    *,
    address: Address,
    out: Path,
    command_line: Sequence[str],
    on_progress: Callable[[float], None] | None = None,
    ecus: Mapping[str, str] = DEFAULT_ECUS,
    external: Collection[str] = (),
    fmu: Path | None = None,
    silence_s: float = SILENCE_S,
) -> RunResult:
    """Run a scenario and log it.

    Args:
        scenario: what to run.
        address: where the buses are; `direct` keeps everything in this process.
        out: the log to write; it must not exist.
        command_line: how the run was called, for the log.
        on_progress: called now and then with the simulated time in s.
        ecus: class of each role's ECU, as `bench.ecu.main.load_class` takes it.
        external: names of ECUs that are not to be started, as they run elsewhere: `veh1.planner`.
        fmu: the vehicle; None for the one that `platoon fmu build` made.
        silence_s: wall-clock time in s without a frame after which the run has failed.

    Raises:
        BadInput: the log exists, the FMU is missing, an ECU cannot be loaded, a bus cannot be opened; nothing was
            started or written.
        RunFailed: a process ended or fell silent; the log is closed and holds all up to then.
        Interrupted: SIGINT, SIGTERM or SIGHUP came; the log likewise.
    """
    called = time.perf_counter()
    if out.exists():
        raise BadInput(f"the log {out} exists; give another file with --out, or remove it")
    fmu = fmu or _built_fmu()
    vehicles = len(scenario.vehicles)
    _check_ecus(ecus, external, vehicles, address)
    with ExitStack() as stack:
        settled = stack.enter_context(settle(address, vehicles))
        codecs = load_codecs(vehicles)
        stage = Stage(scenario, settled, codecs, fmu, read_description(fmu), ecus, external)
        links = {bus: stack.enter_context(open_link(bus, settled)) for bus in codecs}
        interrupts = stack.enter_context(Interrupts())
        stack.enter_context(as_batch_work())
        lockstep = Lockstep(links, codecs, vehicles, silence_s)
        crew = stage.crew(links, lockstep, interrupts, stack)
        # Not at the top: so these imports take place while the processes start.
        from bench.conductor.recorder import open_recorder

        recorder = open_recorder(out, stage, command_line)
        startup_s = 0.0
        ending = _Ending("failed", "the conductor failed")
        try:
            crew.wait_ready(READY_S)
            startup_s = time.perf_counter() - called
            # What there is now stays to the end of the run; no garbage collection need look at it in every cycle.
            gc.freeze()
            lockstep.run(crew, recorder, scenario.cycles, on_progress)
            problems = crew.stop(GRACE_S)
            ending = _Ending("failed", "\n".join(problems)) if problems else _Ending("completed")
        except Interrupted as error:
            ending = _Ending("interrupted", str(error))
        except RunFailed as error:
            ending = _Ending("failed", str(error))
        finally:
            gc.unfreeze()
            if ending.status != "completed":
                lockstep.stop()
                crew.stop(GRACE_S / 2)
                lockstep.record_rest(recorder)
                recorder.event(lockstep.cycle, "fatal", "conductor", ending.reason)
            lost = recorder.frames_lost() + sum(link.frames_lost() for link in links.values())
            recorder.close(
                {
                    "status": ending.status,
                    "reason": ending.reason,
                    "wall_s": f"{lockstep.wall_s:.6f}",
                    "startup_s": f"{startup_s:.6f}",
                    "cycles": str(lockstep.cycles),
                    "frames_lost": str(lost),
                    "e2e_errors": str(recorder.e2e_errors()),
                }
            )
    if ending.status == "completed":
        return RunResult(out, lockstep.wall_s, startup_s, lockstep.cycles, lost)
    there = f"The log up to there is {out}"
    if ending.status == "interrupted":
        raise Interrupted(f"The run was {ending.reason}\n{there}")
    raise RunFailed(f"The run has failed: {ending.reason}\n{there}")


def _check_ecus(ecus: Mapping[str, str], external: Collection[str], vehicles: int, address: Address) -> None:
    """Refuse ECUs that cannot be loaded, and external ones that could not take part.

    Raises:
        BadInput: see there.
    """
    names = [ecu_name(role, vehicle) for role in ecus for vehicle in range(1, vehicles + 1)]
    unknown = [name for name in external if name not in names]
    if unknown:
        raise BadInput(f"--external {', '.join(unknown)}: the scenario has {', '.join(names)}")
    if external and address.hub is not None:
        raise BadInput(
            "--external: with --can direct all is in one process; allowed: --can udp:PORT, vcan, IFACE:CHANNEL"
        )
    if external and address == Address.parse("udp"):
        raise BadInput("--external: the ECU must know where the buses are; give the port, as in --can udp:45000")
    for role, spec in ecus.items():
        # The bench's own are not tried here: that would import what the conductor does not need.
        if spec != DEFAULT_ECUS.get(role):
            load_class(spec)


def _built_fmu() -> Path:
    try:
        return default_fmu()
    except FmuError as error:
        raise BadInput(str(error)) from error
