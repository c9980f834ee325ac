"""Step times of ECUs, and percentiles of times."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from bench.record import Run

NOT_SENT = "not sent"
"""What is shown in place of a value that no ECU has sent."""

MEDIAN_AND_P99 = (50.0, 99.0)
_MICROSECONDS_PER_MS = 1000.0


def step_times_ms(run: Run, message: str, signal: str) -> dict[str, float]:
    """Return median and 99th percentile, in ms, of a time signal (us in the DBC) over all vehicles.

    Zero times are left out; empty if there are no others.
    """
    buses = [f"veh{vehicle}" for vehicle in range(1, run.vehicles + 1)]
    columns = [run.signal(bus, message, signal)[1] for bus in buses if run.has(bus, message)]
    times = np.concatenate([np.empty(0), *columns])
    return {name: time / _MICROSECONDS_PER_MS for name, time in percentiles(times[times > 0]).items()}


def percentiles(values: npt.NDArray[np.float64], wanted: Sequence[float] = MEDIAN_AND_P99) -> dict[str, float]:
    """Return percentiles by name, e.g. `p50`, `p99.9`; empty without values."""
    if not values.size:
        return {}
    return {f"p{share:g}": float(found) for share, found in zip(wanted, np.percentile(values, wanted), strict=True)}


def median_and_p99(times_ms: Mapping[str, float] | None) -> str:
    """Return median and 99th percentile of times as text."""
    return f"{times_ms['p50']:.2f} / {times_ms['p99']:.2f} ms" if times_ms else NOT_SENT
