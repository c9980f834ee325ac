"""ECUs that crash and hang, and what the conductor does to their processes for that.

That real processes are killed, stopped and started anew is in tests/integration/test_faults.py.
"""

import pytest

from bench.conductor.outages import Outages
from bench.faults.base import Fault
from bench.faults.plan import FaultPlan
from bench.faults.processes import EcuCrash, EcuHang

ECU = "veh2.tracker"


class Crew:
    """Writes down what it is told to do."""

    def __init__(self) -> None:
        self.done: list[str] = []

    def kill(self, name: str) -> None:
        self.done.append(f"kill {name}")

    def restart(self, name: str) -> None:
        self.done.append(f"restart {name}")

    def pause(self, name: str) -> None:
        self.done.append(f"pause {name}")

    def resume(self, name: str) -> None:
        self.done.append(f"resume {name}")


def orders(*faults: Fault) -> dict[int, list[str]]:
    """Return what is done to ECUs before each cycle, without the cycles in which that is nothing."""
    outages = Outages(FaultPlan(faults))
    by_cycle = {}
    for cycle in range(10):
        crew = Crew()
        outages.apply(cycle, crew)  # type: ignore[arg-type] - it is asked for no more than this
        by_cycle[cycle] = crew.done
        away = any(cycle in range(round(100 * each.at_s), round(100 * (each.at_s + each.for_s))) for each in faults)
        assert outages.absent == ([ECU] if away else [])
    return {cycle: done for cycle, done in by_cycle.items() if done}


def test_an_ecu_that_crashes_is_killed_and_started_anew() -> None:
    crash = EcuCrash(at_s=0.02, for_s=0.03, ecu=ECU)
    assert orders(crash) == {2: [f"kill {ECU}"], 5: [f"restart {ECU}"]}


def test_an_ecu_that_hangs_is_stopped_and_goes_on() -> None:
    hang = EcuHang(at_s=0.02, for_s=0.03, ecu=ECU)
    assert orders(hang) == {2: [f"pause {ECU}"], 5: [f"resume {ECU}"]}


@pytest.mark.parametrize("order", [1, -1])
def test_an_ecu_that_crashes_while_it_hangs_is_dead_and_hangs_again_once_it_is_back(order: int) -> None:
    faults = [EcuHang(at_s=0.02, for_s=0.06, ecu=ECU), EcuCrash(at_s=0.03, for_s=0.02, ecu=ECU)][::order]
    assert orders(*faults) == {
        2: [f"pause {ECU}"],
        3: [f"kill {ECU}"],
        5: [f"restart {ECU}", f"pause {ECU}"],
        8: [f"resume {ECU}"],
    }
