"""Trackers that somebody has changed, for the tests of what a review of the change shows."""

import dataclasses
import math
import os
import signal
import threading
import time
from collections.abc import Mapping

from bench.ecu.base import Health, Outgoing, Signals, Topic
from bench.ecu.tracker import TrackerEcu
from bench.scenario import Scenario

CYCLE = 30
"""When those that change while they run do."""

NUDGE_RAD = 1e-4


class OtherParameter(TrackerEcu):
    """Its observer is slower."""

    def __init__(self, vehicle: int, scenario: Scenario) -> None:
        tracker = dataclasses.replace(scenario.tracker, observer_rate=0.95)
        super().__init__(vehicle, scenario.model_copy(update={"tracker": tracker}))


class Nudged(TrackerEcu):
    """Steers a bit more from a certain cycle on."""

    def step(self, cycle: int, time_s: float, inputs: Mapping[Topic, Signals | None], health: Health) -> list[Outgoing]:
        messages = super().step(cycle, time_s, inputs, health)
        return [self._nudged(m) if cycle >= CYCLE and m.message == "SteeringCommand" else m for m in messages]

    @staticmethod
    def _nudged(message: Outgoing) -> Outgoing:
        angle = message.values["SteeringAngle"] + NUDGE_RAD
        return dataclasses.replace(message, values={**message.values, "SteeringAngle": angle})


class WithoutAngle(TrackerEcu):
    """Steers by NaN from a certain cycle on."""

    def step(self, cycle: int, time_s: float, inputs: Mapping[Topic, Signals | None], health: Health) -> list[Outgoing]:
        nan = {"SteeringAngle": math.nan}
        return [
            dataclasses.replace(m, values={**m.values, **nan})
            if cycle >= CYCLE and m.message == "SteeringCommand"
            else m
            for m in super().step(cycle, time_s, inputs, health)
        ]


class Raising(TrackerEcu):
    """Has an error in it."""

    def step(self, cycle: int, time_s: float, inputs: Mapping[Topic, Signals | None], health: Health) -> list[Outgoing]:
        if cycle == CYCLE:
            raise ZeroDivisionError("no speed")
        return super().step(cycle, time_s, inputs, health)


class Killed(TrackerEcu):
    """Takes its process with it, of vehicle 2."""

    def step(self, cycle: int, time_s: float, inputs: Mapping[Topic, Signals | None], health: Health) -> list[Outgoing]:
        if cycle == CYCLE and self.name == "veh2.tracker":
            os.kill(os.getpid(), signal.SIGKILL)
        return super().step(cycle, time_s, inputs, health)


class Hanging(TrackerEcu):
    """Never ends a step, and tells its process."""

    def step(self, cycle: int, time_s: float, inputs: Mapping[Topic, Signals | None], health: Health) -> list[Outgoing]:
        while cycle == CYCLE:
            print(f"hangs in {os.getpid()}", flush=True)  # noqa: T201
            time.sleep(3600)
        return super().step(cycle, time_s, inputs, health)


class Lingering(TrackerEcu):
    """Leaves a thread behind that never ends."""

    def __init__(self, vehicle: int, scenario: Scenario) -> None:
        super().__init__(vehicle, scenario)
        threading.Thread(target=threading.Event().wait).start()


class Greedy(TrackerEcu):
    """Takes a message as input that its vehicle's bus does not have."""

    def __init__(self, vehicle: int, scenario: Scenario) -> None:
        super().__init__(vehicle, scenario)
        self.inputs = (*self.inputs, Topic(f"veh{vehicle}", "Radar"))
