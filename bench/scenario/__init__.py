"""Scenarios, the complete input of a run: `load` reads one, `Scenario` is the model, `shipped` lists those included."""

from bench.faults.profile import Constant, Profile, Sine, Step
from bench.scenario.loading import SCENARIO_DIR, from_log, load, shipped
from bench.scenario.model import Platoon, Road, Scenario, Vehicle

__all__ = [
    "SCENARIO_DIR",
    "Constant",
    "Platoon",
    "Profile",
    "Road",
    "Scenario",
    "Sine",
    "Step",
    "Vehicle",
    "from_log",
    "load",
    "shipped",
]
