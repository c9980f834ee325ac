"""Faults of ECUs' processes: they crash or hang."""

from typing import Literal

from bench.faults.base import Bench, Condition, EcuName, Fault, Outage, Problem, no_node


class EcuCrash(Fault):
    """An ECU's process is killed; after `for_s` it is restarted and joins the running bench.

    Attributes:
        ecu: the ECU: veh1.planner or veh1.tracker.
    """

    kind: Literal["ecu_crash"] = "ecu_crash"
    ecu: EcuName

    def problems(self, bench: Bench) -> list[Problem]:
        """See `Fault`."""
        return no_node("ecu", self.ecu, bench)

    @property
    def outage(self) -> Outage:
        """See `Fault`."""
        return Outage(self.ecu, Condition.DEAD)


class EcuHang(Fault):
    """An ECU's process is stopped; after `for_s` it continues.

    Attributes:
        ecu: the ECU: veh1.planner or veh1.tracker.
    """

    kind: Literal["ecu_hang"] = "ecu_hang"
    ecu: EcuName

    def problems(self, bench: Bench) -> list[Problem]:
        """See `Fault`."""
        return no_node("ecu", self.ecu, bench)

    @property
    def outage(self) -> Outage:
        """See `Fault`."""
        return Outage(self.ecu, Condition.STOPPED)
