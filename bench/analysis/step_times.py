"""Step times of ECUs, and percentiles of times.

A message of times carries the longest since the one before: of several steps, by its cycle time in the log's DBC file.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from bench.cycle import CYCLE_MS
from bench.names import vehicle_bus
from bench.record import Run

NOT_SENT = "not sent"
"""What is shown in place of a value that no ECU has sent."""

MEDIAN_AND_P99 = (50.0, 99.0)
_MICROSECONDS_PER_MS = 1000.0


def step_times_ms(run: Run, message: str, signal: str) -> dict[str, float]:
    """Return median and 99th percentile, in ms, of a time signal (us in the DBC) over all vehicles.

    They are of the longest times in `longest_in_ms`, which is the third item. Zero times are left out; empty if there
    are no others.
    """
    buses = [vehicle_bus(vehicle) for vehicle in range(1, run.vehicles + 1)]
    columns = [run.signal(bus, message, signal)[1] for bus in buses if run.has(bus, message)]
    times = np.concatenate([np.empty(0), *columns])
    found = {name: time / _MICROSECONDS_PER_MS for name, time in percentiles(times[times > 0]).items()}
    return {**found, "longest_in_ms": longest_in_ms(run, message)} if found else {}


def longest_in_ms(run: Run, message: str) -> float:
    """Return the time, in ms, of which each time in a message is the longest: that of a cycle if every step has one."""
    codec = run.codec(vehicle_bus(1))
    return float(CYCLE_MS * (codec.period(message) if codec is not None and message in codec.names else 1))


def longest(in_ms: float) -> str:
    """Return what to say of times that are the longest in `in_ms`; nothing if every step has one."""
    return f"longest in {in_ms:g} ms" if in_ms > CYCLE_MS else ""


def percentiles(values: npt.NDArray[np.float64], wanted: Sequence[float] = MEDIAN_AND_P99) -> dict[str, float]:
    """Return percentiles by name, e.g. `p50`, `p99.9`; empty without values."""
    if not values.size:
        return {}
    # As np.percentile, which loads numpy's masked arrays.
    places = np.asarray(wanted) / 100.0 * (values.size - 1)
    found = np.interp(places, np.arange(values.size), np.sort(values, axis=None))
    return {f"p{share:g}": float(value) for share, value in zip(wanted, found, strict=True)}


def median_and_p99(times_ms: Mapping[str, float] | None) -> str:
    """Return times of `step_times_ms` as text."""
    if not times_ms:
        return NOT_SENT
    of = longest(times_ms["longest_in_ms"])
    return f"{times_ms['p50']:.2f} / {times_ms['p99']:.2f} ms" + (f" ({of})" if of else "")
