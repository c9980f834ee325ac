"""ECUs that misbehave in one way each, for the tests of what the bench makes of it."""

import ctypes
import dataclasses
import json
import math
import sys
import threading
from collections.abc import Mapping
from pathlib import Path

from bench.ecu.base import Health, Outgoing, Signals, Topic
from bench.ecu.loading import load_class
from bench.ecu.planner import PlannerEcu
from bench.ecu.tracker import TrackerEcu
from bench.scenario import Scenario

_SIMPLE = Path(__file__).with_name("simple.py")
_CruisePlanner = load_class(f"{_SIMPLE}:CruisePlanner")
_SpeedTracker = load_class(f"{_SIMPLE}:SpeedTracker")

CYCLE = 20
"""When they misbehave, and it is vehicle 2 that does."""


class _Wrapped:
    """Another ECU, with something of its own before each step."""

    kind: type

    def __init__(self, vehicle: int, scenario: Scenario) -> None:
        self._ecu = self.kind(vehicle, scenario)
        self._vehicle = vehicle
        self.name = self._ecu.name
        self.inputs: tuple[Topic, ...] = self._ecu.inputs

    def step(self, cycle: int, time_s: float, inputs: Mapping[Topic, Signals | None], health: Health) -> list[Outgoing]:
        if cycle == CYCLE and self._vehicle == 2:
            self.misbehave()
        return self.answer(cycle, self._ecu.step(cycle, time_s, inputs, health))

    def misbehave(self) -> None:
        """What it does before the step of that cycle."""

    def answer(self, cycle: int, outgoing: list[Outgoing]) -> list[Outgoing]:  # noqa: ARG002 - for the others
        """What it sends of what it should."""
        return outgoing


class FailingPlanner(_Wrapped):
    kind = _CruisePlanner

    def misbehave(self) -> None:
        raise ZeroDivisionError("the gap was zero")


class CrashingTracker(_Wrapped):
    kind = _SpeedTracker

    def misbehave(self) -> None:
        print("reading address 0")  # noqa: T201 - as people do in their ECUs
        ctypes.string_at(0)


class HangingPlanner(_Wrapped):
    kind = _CruisePlanner

    def misbehave(self) -> None:
        sys.stderr.write("thinking it over\n")
        sys.stderr.flush()
        threading.Event().wait()


class HangingTracker(HangingPlanner):
    kind = _SpeedTracker


class TaciturnTracker(_Wrapped):
    """From that cycle on it leaves out the rear torques."""

    kind = _SpeedTracker

    def answer(self, cycle: int, outgoing: list[Outgoing]) -> list[Outgoing]:
        return [message for message in outgoing if cycle < CYCLE or message.message != "TorqueCommandRear"]


class NanTracker(_Wrapped):
    """From that cycle on, for ten cycles, it steers by NaN; its torques are too large for their signals."""

    kind = _SpeedTracker

    def answer(self, cycle: int, outgoing: list[Outgoing]) -> list[Outgoing]:
        bad = self._vehicle == 2 and CYCLE <= cycle < CYCLE + 10
        return [self._worse(message) for message in outgoing] if bad else outgoing

    @staticmethod
    def _worse(message: Outgoing) -> Outgoing:
        values = {"SteeringCommand": {"SteeringAngle": math.nan}, "TorqueCommandFront": {"TorqueFL": 1e6}}
        return dataclasses.replace(message, values={**message.values, **values.get(message.message, {})})


class QuittingTracker(_Wrapped):
    kind = _SpeedTracker

    def misbehave(self) -> None:
        sys.exit(0)


class _Confessing(_Wrapped):
    """Says in its first cycle what its process has imported."""

    def answer(self, cycle: int, outgoing: list[Outgoing]) -> list[Outgoing]:
        if cycle == 0:
            modules = [name for name in sys.modules if name.split(".")[0] in ("bench", "platoon_fmu", "fmpy", "cvxpy")]
            sys.stderr.write(json.dumps(modules) + "\n")
            sys.stderr.flush()
        return outgoing


class ConfessingPlanner(_Confessing):
    kind = PlannerEcu


class ConfessingTracker(_Confessing):
    kind = TrackerEcu
