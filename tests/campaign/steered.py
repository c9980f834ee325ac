"""A tracker that does what a test asks for: by the scenario's seed, and by files beside this one.

A test copies it into its folder, where it notes in `makings` the seed of each run that is begun.
"""

import os
import signal
import time
from pathlib import Path

from bench.ecu import Command, Motion, Reference, TrackerBase
from bench.scenario import Scenario

HERE = Path(__file__).parent
CRASHES, HANGS, RAISES, WAITS = 1001, 1002, 1003, 2000
"""Seeds: the process crashes, the run hangs, it fails; from WAITS on it waits until there is a file `go`."""


class Steered(TrackerBase):
    """Drives straight on, with a torque that follows from the seed, so that no two runs have the same result."""

    def __init__(self, vehicle: int, scenario: Scenario) -> None:
        super().__init__(vehicle, scenario)
        self._seed, self._vehicle, self._cycles = scenario.seed, vehicle, 0
        if vehicle != 1:
            return
        with (HERE / "makings").open("a") as makings:
            makings.write(f"{self._seed} {os.getpid()}\n")
        while self._seed >= WAITS and not (HERE / "go").exists():
            time.sleep(0.01)

    def control(self, motion: Motion, reference: Reference) -> Command:  # noqa: ARG002 - the interface
        self._cycles += 1
        if self._cycles == 20 and self._vehicle == 1:
            self._go_wrong()
        return Command.evenly(float(self._seed % 1000), 0.0)

    def _go_wrong(self) -> None:
        if self._seed == CRASHES:
            os.kill(os.getpid(), signal.SIGSEGV)
        if self._seed == HANGS:
            time.sleep(3600.0)
        if self._seed == RAISES:
            raise ValueError("the third word")
