"""Where the processor's time goes in a run on `direct`, by part of the bench: a sampling profile by py-spy.

py-spy stops the process at each sample and reads its stack: Python frames, and with `--native` those of machine code,
of which Cython's name the module. A sample belongs to the part that the innermost frame of our packages names; whatever
that calls (numpy, Clarabel, the kernel) belongs to it, too. The run is profiled at two durations: the difference is
what a simulated second costs, without start and end. A profiled run takes longer, so only the shares are taken from
it, and scaled to the processor time of runs without a profiler.
"""

import re
from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path

from bench.benchmarks.against.checkout import Checkout, environment
from bench.benchmarks.against.processes import Command
from bench.benchmarks.against.run_cost import command_of, completed
from bench.errors import RunFailed
from platoon_fmu.interpreter import interpreter

RATE = 100
"""Samples per second."""

OTHER = "other"

PARTS: tuple[tuple[str, str], ...] = (
    ("planner's search", r"control/genetic"),
    ("planner", r"control/(planner|flocking|near_identity|boundaries)|ecu/(planner|peers)"),
    ("tracker's control", r"control/"),
    ("ECU around the control", r"ecu/"),
    ("inbox", r"bus/(inbox|reception)"),
    ("outbox", r"bus/outbox"),
    ("codec", r"bus/codec"),
    ("links and nodes", r"bus/(link|node|udp|direct|socketcan|sockets|interface|multicast)"),
    ("recorder", r"record/|mcap/|bus/wire/|bus/timing|conductor/recorder"),
    ("plant", r"plant/|platoon_fmu"),
    ("conductor", r"conductor/"),
)
"""The parts, and the modules of each, below `bench`; the first that matches. A module of none belongs to its caller."""

# `encode (bench/bus/codec.py:163)`, or `encode (bench.bus.codec.cpython-311-x86_64-linux-gnu.so)` if it is compiled.
_MODULE = re.compile(
    r"\((?:[^()]*/)?(?:bench[./]|(?=platoon_fmu[./]))([\w./]+?)(?:\.py(?::\d+)?|\.cpython[^()]*|\.abi3[^()]*)\)"
)


def is_possible() -> bool:
    """Whether py-spy is installed."""
    return _py_spy().exists()


def _py_spy() -> Path:
    return Path(interpreter()[0]).with_name("py-spy")


def part_of(stack: str) -> str:
    """Return the part to which a sample belongs: a stack as py-spy writes it, the innermost frame last."""
    for module in reversed(_MODULE.findall(stack)):
        path = module.replace(".", "/")
        for part, modules in PARTS:
            if re.match(modules, path):
                return part
    return OTHER


def samples_by_part(lines: Iterable[str]) -> Counter[str]:
    """Return the number of samples of each part from py-spy's raw output, lines of stack and number of samples."""
    counts: Counter[str] = Counter()
    for line in lines:
        stack, _, count = line.rpartition(" ")
        counts[part_of(stack)] += int(count)
    return counts


def profile(checkout: Checkout, scenario: Path, seconds: float, folder: Path) -> Counter[str]:
    """Run a scenario on `direct` under py-spy; return the number of samples of each part.

    Raises:
        RunFailed: the run did not complete, or the system does not let py-spy read another process.
    """
    log, said, stacks = (folder / f"profile{suffix}" for suffix in (".mcap", ".txt", ".stacks"))
    run = command_of(checkout, scenario, "direct", seconds, log)
    options: list[str | Path] = ["--native", "--format", "raw", "--rate", str(RATE), "--output", stacks]
    command: list[str | Path] = [_py_spy(), "record", *options, "--", checkout.python, "-P", *run]
    with (
        said.open("wb") as output,
        Command(command, cwd=folder, env=environment(), stdout=output, stderr=output) as running,
    ):
        running.wait()
    completed(log, said, checkout)
    if not stacks.exists():
        raise RunFailed(f"py-spy wrote nothing:\n{said.read_text(errors='replace')[-500:]}")
    counts = samples_by_part(stacks.read_text().splitlines())
    for file in (log, said, stacks):
        file.unlink()
    return counts


def shares(long: Mapping[str, int], short: Mapping[str, int]) -> dict[str, float]:
    """Return each part's share of what the longer runs took more than the shorter ones; below 0 is noise, and 0."""
    more = {part: max(0, long.get(part, 0) - short.get(part, 0)) for part in [*(name for name, _ in PARTS), OTHER]}
    total = sum(more.values())
    return {part: count / total if total else 0.0 for part, count in more.items()}
