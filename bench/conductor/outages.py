"""ECUs that faults have crashed or stopped, cycle by cycle."""

from enum import Enum

from bench.conductor.crew import Crew
from bench.faults.kinds import EcuCrash, EcuHang
from bench.faults.plan import FaultPlan

GOES_ON_WITHOUT = "; the run goes on without "
"""How the event of an ECU's failure says, before their names, who is missing from there on."""


class _Condition(Enum):
    RUNNING = "running"
    STOPPED = "stopped"
    DEAD = "dead"


class Outages:
    """Brings every ECU into the condition that the faults of a cycle want it in.

    Attributes:
        absent: names of the ECUs that send nothing in the cycle.
    """

    def __init__(self, plan: FaultPlan) -> None:
        """Begin with all ECUs running."""
        self._plan = plan
        self._conditions: dict[str, _Condition] = {}
        self._failed: set[str] = set()

    @property
    def absent(self) -> list[str]:
        """See the class."""
        return [*self._failed, *(name for name in self._conditions if name not in self._failed)]

    def failed(self, name: str, crew: Crew) -> None:
        """Note that an ECU has failed that no fault told to; it stays away."""
        self._failed.add(name)
        crew.excuse(name)

    def apply(self, cycle: int, crew: Crew) -> None:
        """Do what the faults of `cycle` want done to ECUs before it begins.

        Raises:
            RunFailed: an ECU did not start anew.
            Interrupted: a signal has come.
        """
        wanted: dict[str, _Condition] = {}
        for _, fault in self._plan.at(cycle):
            if isinstance(fault, EcuCrash):
                wanted[fault.ecu] = _Condition.DEAD
            elif isinstance(fault, EcuHang):
                wanted.setdefault(fault.ecu, _Condition.STOPPED)
        if wanted == self._conditions:
            return
        for name in {**self._conditions, **wanted}:
            if name not in self._failed:
                before, after = self._conditions.get(name), wanted.get(name)
                self._change(name, before or _Condition.RUNNING, after or _Condition.RUNNING, crew)
        self._conditions = wanted

    def _change(self, name: str, before: _Condition, after: _Condition, crew: Crew) -> None:
        if before is after:
            return
        if after is _Condition.DEAD:
            crew.kill(name)
            return
        if before is _Condition.DEAD:
            crew.restart(name)
        if after is _Condition.STOPPED:
            crew.pause(name)
        elif before is _Condition.STOPPED:
            crew.resume(name)
