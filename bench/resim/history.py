"""What happened to a recorded run from outside: its faults, and the ECUs it continued without."""

import json
from contextlib import suppress
from dataclasses import dataclass

from pydantic import ValidationError

from bench.cycle import CYCLE_MS
from bench.events import EcuFailed, FaultBegins, FaultRequested
from bench.faults.base import Fault
from bench.faults.former import renewed
from bench.faults.kinds import ONE_FAULT
from bench.record.reader import Run


@dataclass(frozen=True)
class History:
    """What happened to the ECUs of a run from outside.

    Attributes:
        faults: of the scenario, then those injected into the running bench, in the order that seeds their random draws.
        untold: number of faults that began in the run but are not completely in the log.
        ended: by name, the cycle in which an ECU ended or fell silent without a fault.
    """

    faults: tuple[Fault, ...]
    untold: int
    ended: dict[str, int]


def read_history(run: Run) -> History:
    """Return what happened in a run.

    Raises:
        BadInput: the log has no scenario that this version can read.
    """
    faults: list[Fault] = list(run.scenario.faults)
    begun = 0
    ended: dict[str, int] = {}
    for event in run.events:
        if event.kind == FaultRequested.kind:
            # Faults unknown to this version are left out, but counted.
            with suppress(ValidationError):
                faults.append(ONE_FAULT.validate_json(json.dumps(renewed(event.fields["fault"]))))
        elif event.kind == FaultBegins.kind:
            begun += 1
        elif event.kind == EcuFailed.kind:
            for name in event.fields["ecus"]:
                ended.setdefault(name, round(event.time_s * 1000 / CYCLE_MS))
    return History(tuple(faults), max(0, begun - len(faults)), ended)
