"""What an ECU sent, apart from what it did not send: the values that figures and metrics are made of.

An ECU may leave out its diagnostics. External ECUs and logs of older versions have frames with the DBC's start values
instead, and an ECU without a result marks its frame or sends zeros. None of these are values.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from bench.bus.states import CommandState, ReferenceState
from bench.cycle import CYCLE_S
from bench.record import Run
from bench.record.reader import Columns

Array = npt.NDArray[np.float64]
Rows = npt.NDArray[np.bool_]

_STEERING = "SteeringCommand"
_COMMANDS = (_STEERING, "TorqueCommandFront", "TorqueCommandRear")
_REFERENCE = "Reference"
_MEASURED = ("TrackerStatus", "TrackerTiming", "PlannerTiming")
"""Messages in which 0 is no result: times, iterations and the cost bound are positive."""

_ESTIMATES = ("TrackerDisturbance", "PlannerPotential", "PlannerGains")
"""Messages of whose signals an ECU may have only some: one that always has its start value counts as not sent."""


def told(run: Run, vehicle: int, message: str, signal: str) -> tuple[Array, Array] | None:
    """Return times (n,) in s and values (n,) that an ECU of a vehicle sent in a signal; None if it sent none.

    A `Reference` is at the time for which it is meant, the cycle after it was sent. References and commands that their
    sender marks as not to be used are left out. Of diagnostics, frames with nothing but start values are left out.

    Args:
        run: the run.
        vehicle: number of the vehicle, from 1.
        message: a message on its bus.
        signal: one of its signals.
    """
    bus = f"veh{vehicle}"
    if not run.has(bus, message):
        return None
    columns = run.message(bus, message)
    t, values = columns["t"], columns[signal].astype(np.float64)
    if message == _REFERENCE:
        t, rows = t + CYCLE_S, columns["ReferenceState"] != ReferenceState.NONE
    elif message in _COMMANDS:
        rows = _commanded(run, bus, columns)
    elif message in _MEASURED:
        rows = values != 0.0
    else:
        starts = _start_values(run, bus, message)
        rows = np.any([columns[name] != start for name, start in starts.items()], axis=0)
        if message in _ESTIMATES and (values == starts[signal]).all():
            return None
    return (t[rows], values[rows]) if rows.any() else None


def _commanded(run: Run, bus: str, columns: Columns) -> Rows:
    """Return which rows of a command are to be used, by the steering command of the same time."""
    if not run.has(bus, _STEERING):
        return np.ones(len(columns["t"]), np.bool_)
    steering = run.message(bus, _STEERING)
    unused = steering.time_ns[steering["CommandState"] == CommandState.NONE]
    return ~np.isin(columns.time_ns, unused)


def _start_values(run: Run, bus: str, message: str) -> dict[str, float]:
    """Return the start value of each signal by the log's DBC, 0 where it has none."""
    codec = run.codec(bus)
    known = codec.start_values(message) if codec is not None and message in codec.names else {}
    return {name: known.get(name, 0.0) for name in run.message(bus, message) if name != "t"}
