"""BenchSync as its receivers accept it.

It opens a cycle for everybody, or ends the run, so it must be whole and consistent: command in its value table, alive
counter and time those of its cycle. Each receiver also requires that its cycle follows those before.
"""

from typing import NamedTuple

import cython

from bench.bus.e2e import COUNTER_MODULUS, is_whole
from bench.bus.layout import Layout
from bench.bus.states import BenchCommand
from bench.cycle import CYCLE_MS

BENCH_SYNC = "BenchSync"

STOP_LAG = 2
"""In real time, the number of cycles by which the conductor, which only listens, may be behind when it stops all."""

_LENGTH = 8
_LATEST = cython.declare(cython.double, 16_777.215)
"""Largest value (s) of the signal Time, which later cycles have, too."""
_ROUNDING = cython.declare(cython.double, 0.001)

_COMMANDS = {float(command): command for command in BenchCommand}
"""The commands by their value in a frame: an enumeration's own search takes a microsecond."""
_REALTIME, _STOP = BenchCommand.RUN_REALTIME, BenchCommand.STOP
_CYCLE_MS = cython.declare(cython.longlong, CYCLE_MS)
_MODULUS = cython.declare(cython.longlong, COUNTER_MODULUS)


class Sync(NamedTuple):
    """A valid BenchSync: the command, and the cycle that it opens or, for STOP, does not open any more."""

    command: BenchCommand
    cycle: int

    @property
    def realtime(self) -> bool:
        """Whether the wall clock paces the cycles."""
        return self.command is _REALTIME

    def stops_after(self, newest: int, *, realtime: bool) -> bool:
        """Return whether this tells a node to stop for which `newest` is the newest cycle; -1 if none has begun."""
        lag = newest + 1 - self.cycle
        return self.command is _STOP and self.cycle > 0 and 0 <= lag <= (STOP_LAG if realtime else 0)


def read_sync(layout: Layout, data: bytes) -> Sync | None:
    """Return the BenchSync, whose layout is given, in the bytes of a frame; None if it is not whole and consistent."""
    if len(data) != _LENGTH or not is_whole(data, layout.crc_of_id):
        return None
    values = layout.decode(data)
    command = _COMMANDS.get(values["Command"])
    cycle: cython.longlong = int(values["Cycle"])
    counter: cython.double = values["AliveCounter"]
    time_s: cython.double = values["Time"]
    begin_s: cython.double = cycle * _CYCLE_MS / 1000.0
    is_in_time: cython.bint = abs(time_s - min(begin_s, _LATEST)) <= _ROUNDING
    return Sync(command, cycle) if command is not None and counter == cycle % _MODULUS and is_in_time else None
