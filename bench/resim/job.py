"""One ECU to be run again, and the outcome: the input and output of a separate process."""

import traceback
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from bench.bus.topic import Topic
from bench.conductor.crew import Ended
from bench.cycle import time_of
from bench.errors import BadInput, BenchError
from bench.faults.base import Fault
from bench.record.compare import SignalDifference
from bench.resim.comparison import Comparison, First, Pair
from bench.resim.recording import EcuLog
from bench.resim.rerun import Rerun
from bench.resim.step_limit import StepLimit
from bench.resim.tolerance import Tolerance
from bench.scenario import Scenario


@dataclass(frozen=True)
class Job:
    """One ECU to be run again.

    Attributes:
        log: its recorded inputs and outputs.
        spec: its class, as `bench.ecu.loading.load_class` takes it.
        scenario: that of the run.
        faults: all faults of the run, in the order that seeds their random draws.
        tolerance: allowed difference of its frames.
    """

    log: EcuLog
    spec: str
    scenario: Scenario
    faults: Sequence[Fault]
    tolerance: Tolerance

    @property
    def name(self) -> str:
        """Name of the ECU: `veh2.tracker`."""
        return self.log.slot.name


@dataclass(frozen=True)
class Outcome:
    """The outcome of running an ECU again.

    Attributes:
        name: of the ECU.
        spec: its class.
        frames: frames of the log that have been compared.
        cycles: cycles that have been compared.
        steps: number of steps the ECU did.
        waited: number of cycles without a step although it sent something then.
        not_numbers: number of values it sent that are not numbers; their messages were not sent.
        not_there: inputs that the log does not have at all.
        differing: frames whose bytes differ, or that only one side has.
        beyond: those of them that differ by more than the tolerance.
        first: the first of those.
        signals: the signals that differ.
        alone: frames that only one side has, in words.
        changes: all frames that differ, by cycle.
        error: why it ended early or did not run at all; empty if all went well.
        failed: whether that is because the ECU failed, not because the log has too little of it.
        bad_input: whether the user's input is the reason.
    """

    name: str
    spec: str
    frames: int = 0
    cycles: int = 0
    steps: int = 0
    waited: int = 0
    not_numbers: int = 0
    not_there: tuple[Topic, ...] = ()
    differing: int = 0
    beyond: int = 0
    first: First | None = None
    signals: tuple[SignalDifference, ...] = ()
    alone: tuple[str, ...] = ()
    changes: Mapping[int, Sequence[Pair]] = field(default_factory=dict)
    error: str = ""
    failed: bool = False
    bad_input: bool = False

    @property
    def same(self) -> bool:
        """Whether the ECU has sent what the log has, within the tolerance."""
        return not self.beyond and not self.error


def work(job: Job, limit: StepLimit) -> Outcome:
    """Run an ECU again in this process; a step that exceeds `limit` ends the process."""
    if not job.log.ran:
        return Outcome(job.name, job.spec, error="it never ran: the log has no frame of it")
    if not job.log.end:
        return Outcome(job.name, job.spec, error="the log has no whole cycle of its buses")
    comparison = Comparison(job.log, job.tolerance)
    error, bad_input, steps, not_numbers = "", False, 0, 0
    inputs: tuple[Topic, ...] = ()
    try:
        with Rerun(job.log, job.spec, job.scenario, job.faults, limit) as rerun:
            inputs = rerun.witness.inputs
            try:
                for step in rerun:
                    comparison.add(step, rerun.witness.seen.get(step.cycle))
            finally:
                steps, not_numbers = rerun.steps, rerun.not_numbers
    except Ended as failure:
        error = f"after {time_of(comparison.cycles):.3f} s {failure}{_where(failure)}"
    except BenchError as failure:
        error, bad_input = str(failure), isinstance(failure, BadInput)
    except Exception as failure:  # noqa: BLE001 - any error of a custom class; the other jobs continue
        error = f"it cannot be created: {type(failure).__name__}: {failure}{_where(failure)}"
    failed = bool(error)
    if not failed and not comparison.frames:
        error = "it sent nothing in the cycles that could be compared"
    return Outcome(
        name=job.name,
        spec=job.spec,
        frames=comparison.frames,
        cycles=comparison.cycles,
        steps=steps,
        waited=comparison.waited,
        not_numbers=not_numbers,
        not_there=tuple(topic for topic in inputs if not job.log.has(topic)),
        differing=comparison.differing,
        beyond=comparison.beyond,
        first=comparison.first,
        signals=comparison.signals,
        alone=comparison.alone,
        changes=comparison.changes,
        error=error,
        failed=failed,
        bad_input=bad_input,
    )


def _where(failure: Exception) -> str:
    """The place in a custom class where it failed."""
    place = traceback.extract_tb((failure.__cause__ or failure).__traceback__)[-1]
    return f" ({place.filename}, line {place.lineno})"
