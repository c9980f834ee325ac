"""A run from start to end: buses, processes, log."""

import gc
import os
import time
import traceback
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from bench.bus.codec import load_codecs
from bench.bus.link.address import Address, settle
from bench.bus.link.base import Link, LinkError
from bench.bus.link.opening import open_link
from bench.bus.network import EcuSlot
from bench.bus.wire.schedulability import check_load
from bench.conductor.checkout import Checkout
from bench.conductor.conducting import Conductor, Means
from bench.conductor.crew import Crew
from bench.conductor.fault_desk import FaultDesk
from bench.conductor.free_slots import FreeSlots, described, free_slots, refuse_outages
from bench.conductor.interrupts import Interrupted, Interrupts
from bench.conductor.limits import FILES_OF_VEHICLE, LEAST_FILES, require_files
from bench.conductor.linux import as_batch_work
from bench.conductor.lockstep import Lockstep
from bench.conductor.options import RunOptions
from bench.conductor.realtime import Realtime
from bench.conductor.stage import Stage
from bench.conductor.trial import try_ecus
from bench.errors import BadInput, BenchError, RunFailed
from bench.events import FramesLost, FramesRefused, ProcessOutput, RunEnded
from bench.faults.plan import FaultBoard, FaultPlan
from bench.files import already_exists
from bench.names import CONDUCTOR
from bench.plant.description import read_description
from platoon_fmu.build import default_fmu
from platoon_fmu.errors import FmuError

if TYPE_CHECKING:  # it is imported while the processes start
    from bench.conductor.recorder import Recorder

READY_S = 60.0
"""Wall-clock time in s without a sign of progress after which processes that are starting have failed."""

GRACE_S = 1.0
"""Wall-clock time in s that processes have to stop before they are killed."""


@dataclass(frozen=True)
class RunResult:
    """The result of a completed run.

    Attributes:
        path: the log.
        wall_s: wall-clock time in s from the first BenchSync to the end of the last cycle.
        startup_s: wall-clock time in s from the call of `run` to the first BenchSync.
        cycles: number of cycles.
        frames_lost: number of frames lost by all nodes together.
        deadline_misses: in real time, missed deadlines by name of an ECU, or of the plant on one bus (veh1.plant).
        scheduling: in real time, the scheduling that the kernel has granted, as text.
        refused: what was refused on each bus that had frames that do not belong to the run.
    """

    path: Path
    wall_s: float
    startup_s: float
    cycles: int
    frames_lost: int
    deadline_misses: Mapping[str, int] = field(default_factory=dict)
    scheduling: str = ""
    refused: Sequence[FramesRefused] = ()


@dataclass(frozen=True)
class _Ending:
    """How a run ended: completed, failed or interrupted, and why."""

    status: str
    reason: str = ""


@dataclass
class _Started:
    """A run whose processes are starting and whose log has begun.

    Attributes:
        options: its options.
        address: the settled address of its buses.
        free: the slots of the ECUs started by hand.
        waiting: watches for those ECUs.
        links: the conductor's ends of the buses.
        conductor: its conductor.
        crew: runs plant and ECUs.
        recorder: writes the log.
        startup_s: see `RunResult`; 0 until the first cycle.
        frames_lost: see `RunResult`; 0 until the log is closed.
    """

    options: RunOptions
    address: Address
    free: Sequence[EcuSlot]
    waiting: FreeSlots
    links: Mapping[str, Link]
    conductor: Conductor
    crew: Crew
    recorder: "Recorder"
    startup_s: float = 0.0
    frames_lost: int = 0

    def result(self) -> RunResult:
        """Return the result of the run."""
        conductor = self.conductor
        return RunResult(
            path=self.options.out,
            wall_s=conductor.wall_s,
            startup_s=self.startup_s,
            cycles=conductor.cycles,
            frames_lost=self.frames_lost,
            deadline_misses=conductor.misses,
            scheduling=conductor.scheduling,
            refused=conductor.refused,
        )


def run(options: RunOptions) -> RunResult:
    """Run a scenario and log it.

    Raises:
        BadInput: the log exists, a bus would be overloaded, the FMU is missing, an ECU cannot be loaded, a bus cannot
            be opened; nothing was started or written.
        RunFailed: a process ended or fell silent; the log is closed and holds everything up to then.
        Interrupted: SIGINT, SIGTERM or SIGHUP was received; the log likewise.
    """
    called = time.perf_counter()
    free, fmu = _checked(options)
    with ExitStack() as stack:
        started = _start(options, free, fmu, stack)
        ending = _conduct(started, called)
    if ending.status == "completed":
        return started.result()
    there = f"The log up to there is {options.out}"
    if ending.status == "interrupted":
        raise Interrupted(f"The run was {ending.reason}\n{there}")
    raise RunFailed(f"The run has failed: {ending.reason}\n{there}")


def _checked(options: RunOptions) -> tuple[list[EcuSlot], Path]:
    """Check the options; return the free slots and the FMU.

    Raises:
        BadInput: the run is not possible.
    """
    if options.out.exists():
        raise already_exists(options.out, "--out")
    require_files(LEAST_FILES + FILES_OF_VEHICLE * options.vehicles)
    fmu = options.fmu or _built_fmu()
    free = free_slots(options.without, options.vehicles, options.address)
    refuse_outages(options.scenario.faults, options.without)
    _check_ecus(options)
    if options.realtime and options.address.hub is not None:
        raise BadInput(
            "--clock realtime: --can direct runs everything in one process; use --can udp, vcan, IFACE:CHANNEL"
        )
    return free, fmu


def _start(options: RunOptions, free: Sequence[EcuSlot], fmu: Path, stack: ExitStack) -> _Started:
    """Open the buses, start plant and ECUs and begin the log; `stack` ends everything except the log.

    Raises:
        BadInput: a bus would be overloaded or cannot be opened, or the FMU cannot be read.
        RunFailed: the log cannot be written.
    """
    scenario, vehicles = options.scenario, options.vehicles
    address = stack.enter_context(settle(options.address, vehicles))
    codecs = load_codecs(vehicles)
    late = check_load(codecs, vehicles)
    board = FaultBoard.create()
    stack.callback(os.close, board)
    plan = FaultPlan(scenario.faults, scenario.seed, FaultBoard(board))
    stage = Stage(options, address, codecs, fmu, read_description(fmu), plan, board)
    links = {bus: stack.enter_context(open_link(bus, address)) for bus in codecs}
    interrupts = stack.enter_context(Interrupts())
    stack.enter_context(as_batch_work())
    desk = FaultDesk(
        plan, FaultBoard(board), vehicles, options.out, options.without, scenario.name, scenario.duration_s
    )
    stack.enter_context(desk)
    waiting = FreeSlots(free, codecs, vehicles)
    go_on = scenario.on_ecu_failure == "continue"
    means = Means(links, codecs, vehicles, options.silence_s, desk, waiting, go_on)
    conductor: Conductor = Realtime(means) if options.realtime else Lockstep(means)
    crew = stage.crew(links, conductor, interrupts, stack)
    recorder = _recorder(stage, crew)
    for warning in late:
        recorder.event(0, warning)
    return _Started(options, address, free, waiting, links, conductor, crew, recorder)


def _recorder(stage: Stage, crew: Crew) -> "Recorder":
    checkout = Checkout()
    # Not at the top, so that these imports run while the processes start.
    from bench.bus.wire.timing import BusTimeline
    from bench.conductor.process_watch import ProcessWatch
    from bench.conductor.recorder import open_recorder

    timeline = BusTimeline(stage.codecs, crew.inputs, realtime=stage.options.realtime)
    return open_recorder(stage, timeline, ProcessWatch(lambda: crew.pids), checkout.commit())


def _conduct(started: _Started, called: float) -> _Ending:
    """Conduct a run from its first cycle to its last, close its log, and return how it ended.

    Args:
        started: the run.
        called: time (`time.perf_counter`, s) from which `startup_s` counts.
    """
    options, conductor, crew = started.options, started.conductor, started.crew
    ending = _Ending("failed")
    try:
        _wait(started)
        started.startup_s = time.perf_counter() - called
        # These objects live until the end of the run; garbage collection can skip them.
        gc.freeze()
        conductor.run(crew, started.recorder, options.scenario.cycles, options.on_progress)
        problems = crew.stop(GRACE_S)
        ending = _Ending("failed", "\n".join(problems)) if problems else _Ending("completed")
    except Interrupted as error:
        ending = _Ending("interrupted", str(error))
    except BenchError as error:
        ending = _Ending("failed", str(error))
    except KeyboardInterrupt:
        ending = _Ending("interrupted", "interrupted by SIGINT")
    except Exception as error:  # noqa: BLE001 - whatever ends a run, its log says why
        ending = _unforeseen(started, error)
    except BaseException as error:
        ending = _Ending("failed", f"the conductor was ended: {type(error).__name__}: {error}")
        raise
    finally:
        gc.unfreeze()
        try:
            if ending.status != "completed":
                _break_off(started, ending)
        finally:
            _close_log(started, ending)
    return ending


def _unforeseen(started: _Started, error: Exception) -> _Ending:
    """Return the ending of a run by an error in the bench itself; the log gets its traceback."""
    _record_traceback(started, error)
    where = traceback.extract_tb(error.__traceback__)[-1]
    last = "".join(traceback.format_exception_only(error)).strip()
    return _Ending("failed", f"an error in the bench itself, {Path(where.filename).name} line {where.lineno}: {last}")


def _record_traceback(started: _Started, error: Exception) -> None:
    text = "".join(traceback.format_exception(error))
    with suppress(RunFailed):
        started.recorder.event(max(started.conductor.cycle, 0), ProcessOutput(CONDUCTOR, text))


def _wait(started: _Started) -> None:
    """Wait for all processes, then for the ECUs started by hand.

    Raises:
        RunFailed: not all started, or one ended.
        Interrupted: a signal has come.
    """
    options = started.options
    started.crew.wait_ready(READY_S, options.on_starting)
    if started.free and options.on_waiting is not None:
        there = "; ".join(described(slot, started.address) for slot in started.free)
        options.on_waiting(f"waiting for {there} (at most {options.without_wait_s:g} s) ...")
    started.waiting.wait(started.crew, options.without_wait_s)


def _break_off(started: _Started, ending: _Ending) -> None:
    """End an incomplete run, and record its remaining data.

    Raises:
        RunFailed: the log cannot be written.
    """
    conductor, recorder = started.conductor, started.recorder
    with suppress(LinkError):
        # A bus may have gone down; then nodes on the other buses are stopped, and the remaining ones are killed.
        conductor.stop()
    started.crew.stop(GRACE_S / 2)
    try:
        conductor.record_rest(recorder)
    except RunFailed:
        raise
    except Exception as error:  # noqa: BLE001 - what has ended the run may also be in the way here
        _record_traceback(started, error)
    recorder.event(max(conductor.cycle, 0), RunEnded(ending.status, ending.reason))


def _close_log(started: _Started, ending: _Ending) -> None:
    conductor, recorder = started.conductor, started.recorder
    lost = {bus: link.frames_lost() for bus, link in started.links.items()}
    started.frames_lost = recorder.frames_lost() + sum(lost.values())
    refused = conductor.refused
    with suppress(RunFailed):
        # An error of writing is reported by `close`.
        for bus, count in lost.items():
            if count:
                recorder.event(max(conductor.cycle, 0), FramesLost(bus, count))
        for event in refused:
            recorder.event(max(conductor.cycle, 0), event)
    recorder.close(
        {
            "status": ending.status,
            "reason": ending.reason,
            "wall_s": f"{conductor.wall_s:.6f}",
            "startup_s": f"{started.startup_s:.6f}",
            "recorder_cpu_s": f"{recorder.cpu_s:.6f}",
            "cycles": str(conductor.cycles),
            "frames_lost": str(started.frames_lost),
            "frames_refused": str(sum(sum(each.counts.values()) for each in refused)),
            **{f"frames_refused {each.bus}": each.kinds for each in refused},
            "e2e_errors": str(recorder.e2e_errors()),
        }
    )


def _check_ecus(options: RunOptions) -> None:
    """Check that the ECUs can be loaded and created.

    Raises:
        BadInput: see `try_ecus`. In one process, ECUs are created before anything is written anyway.
    """
    if options.address.hub is None:
        slots = (EcuSlot(role, vehicle) for role in options.ecus for vehicle in range(1, options.vehicles + 1))
        own = [slot for slot in slots if slot.name not in options.without]
        try_ecus(options.ecus, own, options.scenario, options.on_starting)


def _built_fmu() -> Path:
    try:
        return default_fmu()
    except FmuError as error:
        raise BadInput(str(error)) from error
