"""How long the tracker's step takes at worst: many short runs from random starts, each step timed.

A run is one of the shipped scenarios with up to five vehicles, over `direct`, for `DURATION_S`, with another seed. Each
vehicle starts with another speed and heading; the tyres of both axles, the lateral wind from `WIND_AT_S` on, and the
platoon's speed and gap are drawn as well. All is drawn from one seed.
"""

import tempfile
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter, thread_time
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray
from rich.table import Table

from bench.benchmarks.figures import seconds_text
from bench.benchmarks.sheet import Sheet
from bench.bus.link.address import Address
from bench.bus.reception import Health
from bench.bus.topic import Outgoing, Signals, Topic
from bench.conductor.options import RunOptions
from bench.conductor.run import run
from bench.control.tracker import TrackerOutput
from bench.ecu.loading import DEFAULT_ECUS
from bench.ecu.plausibility import OwnState
from bench.ecu.tracker import NextReference, TrackerEcu
from bench.scenario import Scenario, load, shipped

RUNS, FEW = 1000, 20
"""Number of runs for the page, and where only a sample is wanted."""
DURATION_S, WIND_AT_S = 0.5, 0.25
SEED = 2021
MOST_VEHICLES = 5
QUANTILES = (0.5, 0.99, 0.999, 0.9999, 1.0)


@dataclass(frozen=True)
class Step:
    """One step of a tracker: its time by the clock and of the processor (s), and where its gain came from."""

    clock: float
    processor: float
    source: str


class TimedTracker(TrackerEcu):
    """The built-in tracker, which keeps how long each of its steps took."""

    steps: ClassVar[list[Step]] = []

    def step(self, cycle: int, time_s: float, inputs: Mapping[Topic, Signals | None], health: Health) -> list[Outgoing]:
        """Track this cycle's reference."""
        self._found: TrackerOutput | None = None
        clock, processor = perf_counter(), thread_time()
        messages = super().step(cycle, time_s, inputs, health)
        spent = perf_counter() - clock, thread_time() - processor
        if self._found is not None:
            self.steps.append(Step(*spent, self._found.source.name))
        return messages

    def _track(self, own: OwnState, then: NextReference, applied: NDArray[np.float64]) -> TrackerOutput:
        self._found = super()._track(own, then, applied)
        return self._found


def tables() -> Iterator[Table]:
    """Yield the table of a few runs."""
    yield worst_sheet(FEW).table()


def worst_sheet(runs: int) -> Sheet:
    """Run and return the table of step times."""
    # Loaded before, as by a tracker's first step that needs it.
    import bench.control.robust_program  # noqa: F401

    TimedTracker.steps.clear()
    for scenario in _scenarios(runs):
        _time_run(scenario)
    steps = TimedTracker.steps
    sources = [step.source for step in steps]
    rows = [
        _row("by the clock", [step.clock for step in steps]),
        _row("of the processor", [step.processor for step in steps]),
        *(
            _row(f"of the processor, gain by {source}", [step.processor for step in steps if step.source == source])
            for source in dict.fromkeys(sources)
        ),
    ]
    headings = ("time", "steps", "p50", "p99", "p99.9", "p99.99", "largest")
    return Sheet(f"The tracker's step over {runs} short runs from random starts", headings, rows)


def _row(title: str, seconds: list[float]) -> list[str]:
    return [title, str(len(seconds)), *(seconds_text(float(value)) for value in np.quantile(seconds, QUANTILES))]


def _scenarios(count: int) -> Iterator[Scenario]:
    dice = np.random.default_rng(SEED)
    vehicles = {name: len(load(name).vehicles) for name in shipped()}
    names = [name for name, number in vehicles.items() if number <= MOST_VEHICLES]
    for _ in range(count):
        name = names[dice.integers(len(names))]
        wind = float(dice.uniform(-1500.0, 1500.0))
        overrides = [
            f"duration_s={DURATION_S}",
            f"seed={dice.integers(2**32)}",
            f"platoon.speed_mps={dice.uniform(17.0, 23.0):.3f}",
            f"platoon.gap_m={dice.uniform(8.0, 14.0):.3f}",
            f"road.lambda_f={dice.uniform(-1.0, 1.0):.3f}",
            f"road.lambda_r={dice.uniform(-1.0, 1.0):.3f}",
            f'road.force_y_n={{kind = "step", before = 0.0, after = {wind:.1f}, at_s = {WIND_AT_S}}}',
        ]
        for place in range(vehicles[name]):
            overrides += [
                f"vehicles.{place}.speed_mps={dice.uniform(16.0, 24.0):.3f}",
                f"vehicles.{place}.yaw_rad={dice.uniform(-0.03, 0.03):.4f}",
            ]
        yield load(name, overrides)


def _time_run(scenario: Scenario) -> None:
    ecus = {**DEFAULT_ECUS, "tracker": f"{__name__}:{TimedTracker.__name__}"}
    with tempfile.TemporaryDirectory(prefix="platoon-bench-") as folder:
        out = Path(folder) / "run.mcap"
        run(RunOptions(scenario, Address.parse("direct"), out, ["bench.benchmarks", "worst"], ecus=ecus))
