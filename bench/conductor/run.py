"""A run from start to end: buses, processes, log."""

import gc
import os
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path

from bench.bus.codec import load_codecs
from bench.bus.link.address import Address, settle
from bench.bus.link.opening import LinkError, open_link
from bench.bus.wire.schedulability import check_load
from bench.conductor.conducting import Conductor, Means
from bench.conductor.fault_desk import FaultDesk
from bench.conductor.free_slots import FreeSlots, described, free_slots, refuse_outages
from bench.conductor.interrupts import Interrupted, Interrupts
from bench.conductor.linux import as_batch_work
from bench.conductor.lockstep import Lockstep
from bench.conductor.realtime import Realtime
from bench.conductor.stage import Stage
from bench.ecu.loading import DEFAULT_ECUS, load_class
from bench.errors import BadInput, RunFailed
from bench.events import RunEnded
from bench.faults.plan import FaultBoard, FaultPlan
from bench.plant.description import read_description
from bench.scenario import Scenario
from platoon_fmu.build import default_fmu
from platoon_fmu.errors import FmuError

READY_S = 60.0
"""Wall-clock time in s that the processes may take to start; only a machine in trouble needs more."""

SILENCE_S = 10.0
"""Wall-clock time in s without a frame after which a run has failed."""

WITHOUT_WAIT_S = 120.0
"""Wall-clock time in s that a run waits for the ECUs it is to go without, which somebody starts by hand."""

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
        deadline_misses: in real time by name: of an ECU, or of the plant on one bus (veh1.plant).
        scheduling: in real time what the kernel has granted, in words.
    """

    path: Path
    wall_s: float
    startup_s: float
    cycles: int
    frames_lost: int
    deadline_misses: Mapping[str, int] = field(default_factory=dict)
    scheduling: str = ""


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
    without: Collection[str] = (),
    without_wait_s: float = WITHOUT_WAIT_S,
    on_waiting: Callable[[str], None] | None = None,
    fmu: Path | None = None,
    silence_s: float = SILENCE_S,
    realtime: bool = False,
) -> RunResult:
    """Run a scenario and log it.

    Args:
        scenario: what to run.
        address: where the buses are; `direct` keeps everything in this process.
        out: the log to write; it must not exist.
        command_line: how the run was called, for the log.
        on_progress: called now and then with the simulated time in s.
        ecus: class of each role's ECU, as `bench.ecu.loading.load_class` takes it.
        without: names of ECUs that are not to be started, as somebody starts them by hand: `veh1.planner`.
        without_wait_s: wall-clock time in s that the run waits for them.
        on_waiting: called with a line for a person before the run waits for them.
        fmu: the vehicle; None for `platoon_fmu.build.default_fmu`.
        silence_s: wall-clock time in s without a frame after which the run has failed.
        realtime: whether the wall clock paces the cycles; else they follow each other as fast as the machine goes.

    Raises:
        BadInput: the log exists, a bus would be overloaded, the FMU is missing, an ECU cannot be loaded, a bus cannot
            be opened; nothing was started or written.
        RunFailed: a process ended or fell silent; the log is closed and holds all up to then.
        Interrupted: SIGINT, SIGTERM or SIGHUP came; the log likewise.
    """
    called = time.perf_counter()
    if out.exists():
        raise BadInput(f"the log {out} exists; give another file with --out, or remove it")
    fmu = fmu or _built_fmu()
    vehicles = len(scenario.vehicles)
    free = free_slots(without, vehicles, address)
    refuse_outages(scenario.faults, without)
    _check_ecus(ecus)
    if realtime and address.hub is not None:
        raise BadInput("--clock realtime: with --can direct all is in one process; take --can udp, vcan, IFACE:CHANNEL")
    with ExitStack() as stack:
        settled = stack.enter_context(settle(address, vehicles))
        codecs = load_codecs(vehicles)
        late = check_load(codecs, vehicles)
        board = FaultBoard.create()
        stack.callback(os.close, board)
        plan = FaultPlan(scenario.faults, scenario.seed, FaultBoard(board))
        stage = Stage(scenario, settled, codecs, fmu, read_description(fmu), ecus, without, plan, board, realtime)
        links = {bus: stack.enter_context(open_link(bus, settled)) for bus in codecs}
        interrupts = stack.enter_context(Interrupts())
        stack.enter_context(as_batch_work())
        desk = stack.enter_context(FaultDesk(plan, FaultBoard(board), vehicles, out, without))
        waiting = FreeSlots(free, codecs, vehicles)
        go_on = scenario.on_ecu_failure == "continue"
        conductor = Realtime if realtime else Lockstep
        conducted: Conductor = conductor(Means(links, codecs, vehicles, silence_s, desk, waiting, go_on))
        crew = stage.crew(links, conducted, interrupts, stack)
        # Not at the top: so these imports take place while the processes start.
        from bench.bus.wire.timing import BusTimeline
        from bench.conductor.process_watch import ProcessWatch
        from bench.conductor.recorder import open_recorder

        timeline = BusTimeline(codecs, crew.inputs, realtime=realtime)
        recorder = open_recorder(out, stage, command_line, timeline, ProcessWatch(lambda: crew.pids))
        for warning in late:
            recorder.event(0, warning)
        startup_s = 0.0
        ending = _Ending("failed", "the conductor failed")
        try:
            crew.wait_ready(READY_S)
            if free and on_waiting is not None:
                there = "; ".join(described(slot, settled) for slot in free)
                on_waiting(f"waiting for {there} (at most {without_wait_s:g} s) ...")
            waiting.wait(crew, without_wait_s)
            startup_s = time.perf_counter() - called
            # What there is now stays to the end of the run; no garbage collection need look at it in every cycle.
            gc.freeze()
            conducted.run(crew, recorder, scenario.cycles, on_progress)
            problems = crew.stop(GRACE_S)
            ending = _Ending("failed", "\n".join(problems)) if problems else _Ending("completed")
        except Interrupted as error:
            ending = _Ending("interrupted", str(error))
        except RunFailed as error:
            ending = _Ending("failed", str(error))
        finally:
            gc.unfreeze()
            if ending.status != "completed":
                with suppress(LinkError):
                    # It may be a bus that has gone down; then the others' nodes are told, and the rest is killed.
                    conducted.stop()
                crew.stop(GRACE_S / 2)
                conducted.record_rest(recorder)
                recorder.event(conducted.cycle, RunEnded(ending.status, ending.reason))
            lost = recorder.frames_lost() + sum(link.frames_lost() for link in links.values())
            recorder.close(
                {
                    "status": ending.status,
                    "reason": ending.reason,
                    "wall_s": f"{conducted.wall_s:.6f}",
                    "startup_s": f"{startup_s:.6f}",
                    "recorder_cpu_s": f"{recorder.cpu_s:.6f}",
                    "cycles": str(conducted.cycles),
                    "frames_lost": str(lost),
                    "e2e_errors": str(recorder.e2e_errors()),
                }
            )
    if ending.status == "completed":
        timing = conducted.misses, conducted.scheduling
        return RunResult(out, conducted.wall_s, startup_s, conducted.cycles, lost, *timing)
    there = f"The log up to there is {out}"
    if ending.status == "interrupted":
        raise Interrupted(f"The run was {ending.reason}\n{there}")
    raise RunFailed(f"The run has failed: {ending.reason}\n{there}")


def _check_ecus(ecus: Mapping[str, str]) -> None:
    """Refuse ECUs that cannot be loaded.

    Raises:
        BadInput: see `load_class`.
    """
    for role, spec in ecus.items():
        # The bench's own are not tried here: that would import what the conductor does not need.
        if spec != DEFAULT_ECUS.get(role):
            load_class(spec)


def _built_fmu() -> Path:
    try:
        return default_fmu()
    except FmuError as error:
        raise BadInput(str(error)) from error
