"""The vehicle FMU's speed: in its binary, through Python, and compared with another vehicle model (`commonroad`).

It measures this machine's binary, built from the current sources.
"""

import math
import tempfile
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from time import perf_counter

import numpy as np
from rich.table import Table

from bench.benchmarks import commonroad
from bench.benchmarks.figures import Figure, Measure, in_turns, ratio_figure, table_of, time_figure
from bench.benchmarks.prepared import PreparedCalls, Step
from bench.benchmarks.timing_host import Points, TimingHost
from bench.plant.description import read_description
from bench.plant.fmu import FmuInstance
from platoon_fmu.build import build, default_directory
from platoon_fmu.errors import FmuError
from platoon_fmu.importer import Instance, Kind, OpenFmu, opened
from platoon_fmu.versions import FMI2, FMI3

STEP_S = 0.01
"""Co-simulation step size, as in the bench (s)."""

CIRCLE = {"v_x_start": 20.0, "steering_angle": 0.02, "force_x": 500.0}
"""An endless manoeuvre: a circle, driven by a force that balances the resistances near the initial speed."""

SLALOM_S, SLALOM_HZ, SLALOM_RAD = 2.0, 0.5, 0.03
"""The manoeuvre that provides the states for the right-hand side."""


@dataclass(frozen=True)
class Effort:
    """The amount of work per metric.

    Attributes:
        rounds: number of measurements.
        right_hand_sides, jacobians, steps: number of these averaged in one measurement.
        instances: number of vehicles in the test with many instances.
    """

    rounds: int = 31
    right_hand_sides: int = 20_000
    jacobians: int = 1_000
    steps: int = 1_000
    instances: int = 1_000


@dataclass(frozen=True)
class Size:
    """One FMU's size.

    Attributes:
        name: of the FMU.
        platforms: folders of its binaries.
        packed, largest_binary: bytes of the FMU, and of the largest binary in it.
    """

    name: str
    platforms: tuple[str, ...]
    packed: int
    largest_binary: int


def tables() -> Iterator[Table | str]:
    """Build the FMUs in a temporary folder and measure them; yield each table, or the reason for omitting it."""
    effort = Effort()
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="platoon-bench-")))
        try:
            files = [build(folder, version=version) for version in (FMI2, FMI3)]
            fmu2, fmu3 = (stack.enter_context(opened(file)) for file in files)
            host = TimingHost(fmu2, fmu3, folder)
        except FmuError as error:
            yield f"The FMU's benchmarks are omitted: {error}"
            return
        yield table_of("Vehicle FMU: in the binary, called from C", binary_figures(host, fmu2, fmu3, effort))
        yield table_of(
            "Vehicle FMU: a step of 10 ms from Python, all inputs set, all outputs got",
            python_figures(fmu2, files[0], effort),
        )
        built = {f"{file.name}, as measured": file for file in files}
        shelf = default_directory()
        built |= {f"{shelf.name}/{file.name}": file for file in sorted(shelf.glob("*.fmu"))}
        yield size_table(sizes(built))
        yield commonroad.table(fmu2)


def binary_figures(host: TimingHost, fmu2: OpenFmu, fmu3: OpenFmu, effort: Effort) -> list[Figure]:
    """Measure what does not depend on the caller."""
    with ExitStack() as stack:

        def started(fmu: OpenFmu, kind: Kind, **more: float) -> Instance:
            return stack.enter_context(Instance(fmu, kind)).start({**CIRCLE, **more})

        points = slalom(fmu2)
        exchange = started(fmu2, Kind.MODEL_EXCHANGE)
        spread = np.linspace(0.0, CIRCLE["steering_angle"], effort.instances)
        many = [started(fmu2, Kind.CO_SIMULATION, steering_angle=float(angle)) for angle in spread]
        each = math.ceil(effort.steps / effort.instances)
        taken = in_turns(
            {
                "model": lambda: host.model(points, effort.right_hand_sides),
                "right-hand side": lambda: host.right_hand_side(exchange, points, effort.right_hand_sides),
                "step 2": host.steps([started(fmu2, Kind.CO_SIMULATION)], STEP_S, effort.steps),
                "step 3": host.steps([started(fmu3, Kind.CO_SIMULATION)], STEP_S, effort.steps),
                "many": host.steps(many, STEP_S, each),
                "directional": lambda: host.directional(exchange, points, effort.jacobians),
                "differences": lambda: host.differences(exchange, points, effort.jacobians),
            },
            effort.rounds,
        )
    return [
        time_figure("right-hand side: the model alone", "300 ns", taken["model"]),
        time_figure("right-hand side: Model Exchange, states set, derivatives got", "300 ns", taken["right-hand side"]),
        time_figure("step of 10 ms, FMI 2.0 Co-Simulation: ten steps of Runge-Kutta 4", "15 µs", taken["step 2"]),
        time_figure("  the same of FMI 3.0", "15 µs", taken["step 3"]),
        time_figure(f"  the same of each of {effort.instances:,} instances (FMI 2.0)", "", taken["many"]),
        ratio_figure("    over that of a single one", "", taken["many"], taken["step 2"]),
        time_figure("Jacobian of the states: directional derivatives", "", taken["directional"]),
        time_figure("  from central differences", "", taken["differences"]),
        ratio_figure(
            "  directional derivatives over differences", "below 1", taken["directional"], taken["differences"]
        ),
    ]


def slalom(fmu: OpenFmu) -> Points:
    """Return the states along a slalom, so that consecutive evaluations differ."""
    rows = []
    with Instance(fmu, Kind.CO_SIMULATION) as vehicle:
        vehicle.start(CIRCLE)
        while vehicle.time < SLALOM_S:
            vehicle.set(steering_angle=SLALOM_RAD * math.sin(2 * math.pi * SLALOM_HZ * vehicle.time))
            vehicle.step(STEP_S)
            rows.append(vehicle.get(*vehicle.state_names))
    return np.array(rows)


def python_figures(fmu: OpenFmu, file: Path, effort: Effort) -> list[Figure]:
    """Measure a step with all inputs and outputs in each of Python's ways to call it."""
    with ExitStack() as stack:

        def prepared() -> PreparedCalls:
            return PreparedCalls(stack.enter_context(Instance(fmu, Kind.CO_SIMULATION)).start(CIRCLE))

        plant = FmuInstance(read_description(file), fmu.folder, "plant", CIRCLE)
        stack.callback(plant.close)
        inputs = plant.inputs()

        def by_plant(time: float, h: float) -> None:
            plant.step(time, h, inputs)
            plant.outputs()

        ways = {
            "ctypes": prepared().by_ctypes(),
            "fmpy": prepared().by_fmpy(),
            "plant": by_plant,
            "lists": prepared().by_fmpys_lists(),
        }
        taken = in_turns({way: _repeated(step, effort.steps) for way, step in ways.items()}, effort.rounds)
    return [
        time_figure("plain ctypes, arrays allocated once", "", taken["ctypes"]),
        time_figure("fmpy's functions, arrays allocated once", "", taken["fmpy"]),
        ratio_figure("  over plain ctypes", "at most 1.3", taken["fmpy"], taken["ctypes"]),
        time_figure("the bench's plant: the same, values in and out as lists", "", taken["plant"]),
        ratio_figure("  over plain ctypes", "at most 1.3", taken["plant"], taken["ctypes"]),
        time_figure("fmpy's setReal, doStep, getReal: new arrays at every call", "", taken["lists"]),
        ratio_figure("  over plain ctypes", "", taken["lists"], taken["ctypes"]),
    ]


def _repeated(step: Step, steps: int) -> Measure:
    """Return a measure that does `steps` steps, continuing from call to call, and returns the seconds per step."""
    done = 0

    def seconds() -> float:
        nonlocal done
        start = perf_counter()
        for number in range(done, done + steps):
            step(number * STEP_S, STEP_S)
        taken = perf_counter() - start
        done += steps
        return taken / steps

    return seconds


def sizes(files: Mapping[str, Path]) -> list[Size]:
    """Return the size of each FMU by name, identical ones only once."""
    distinct: dict[bytes, Size] = {}
    for name, file in files.items():
        distinct.setdefault(file.read_bytes(), _size(name, file))
    return list(distinct.values())


def _size(name: str, file: Path) -> Size:
    with zipfile.ZipFile(file) as archive:
        binaries = [entry for entry in archive.infolist() if entry.filename.startswith("binaries/")]
    folders = sorted({PurePosixPath(entry.filename).parts[1] for entry in binaries})
    largest = max((entry.file_size for entry in binaries), default=0)
    return Size(name, tuple(folders), file.stat().st_size, largest)


def size_table(found: Sequence[Size]) -> Table:
    """Return the table of sizes."""
    table = Table(title="Vehicle FMU: sizes", title_justify="left")
    table.add_column("")
    table.add_column("platforms")
    for heading in ("packed\nkB", "largest binary\nkB"):
        table.add_column(heading, justify="right")
    for size in found:
        table.add_row(
            size.name, ", ".join(size.platforms), f"{size.packed / 1000:.1f}", f"{size.largest_binary / 1000:.1f}"
        )
    return table
