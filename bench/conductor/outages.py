"""ECUs that faults have crashed or stopped, cycle by cycle."""

from bench.conductor.crew import Crew
from bench.faults.base import Condition
from bench.faults.plan import FaultPlan


class Outages:
    """Brings every ECU into the condition demanded by the faults of a cycle.

    Attributes:
        absent: names of the ECUs that send nothing in the cycle.
    """

    def __init__(self, plan: FaultPlan) -> None:
        """Begin with all ECUs running."""
        self._plan = plan
        self._conditions: dict[str, Condition] = {}
        self._failed: set[str] = set()

    @property
    def absent(self) -> list[str]:
        """See the class."""
        return [*self._failed, *(name for name in self._conditions if name not in self._failed)]

    def failed(self, name: str, crew: Crew) -> None:
        """Note that an ECU has failed without a fault; it stays absent."""
        self._failed.add(name)
        crew.excuse(name)

    def apply(self, cycle: int, crew: Crew) -> None:
        """Crash, stop or restart ECUs for the faults of `cycle` before it begins.

        Raises:
            RunFailed: an ECU did not restart.
            Interrupted: a signal has come.
        """
        wanted: dict[str, Condition] = {}
        for _, fault in self._plan.at(cycle):
            if fault.outage:
                ecu, condition = fault.outage
                wanted[ecu] = max(condition, wanted.get(ecu, Condition.RUNNING))
        if wanted == self._conditions:
            return
        for name in {**self._conditions, **wanted}:
            if name not in self._failed:
                before, after = self._conditions.get(name), wanted.get(name)
                self._change(name, before or Condition.RUNNING, after or Condition.RUNNING, crew)
        self._conditions = wanted

    def _change(self, name: str, before: Condition, after: Condition, crew: Crew) -> None:
        if before is after:
            return
        if after is Condition.DEAD:
            crew.kill(name)
            return
        if before is Condition.DEAD:
            crew.restart(name)
        if after is Condition.STOPPED:
            crew.pause(name)
        elif before is Condition.STOPPED:
            crew.resume(name)
