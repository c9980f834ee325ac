"""BenchSync as its receivers accept it.

It opens a cycle for everybody, or ends the run, so it must be whole and consistent: command in its value table, alive
counter and time those of its cycle. Each receiver also requires that its cycle follows those before.
"""

from typing import NamedTuple

from bench.bus.e2e import COUNTER_MODULUS, is_whole
from bench.bus.layout import Layout
from bench.bus.states import BenchCommand
from bench.cycle import time_of

BENCH_SYNC = "BenchSync"

STOP_LAG = 2
"""In real time, the number of cycles by which the conductor, which only listens, may be behind when it stops all."""

_LENGTH = 8
_LATEST_S = 16_777.215
"""Largest value of the signal Time, which later cycles have, too."""
_ROUNDING_S = 0.001


class Sync(NamedTuple):
    """A valid BenchSync: the command, and the cycle that it opens or, for STOP, does not open any more."""

    command: BenchCommand
    cycle: int

    @property
    def realtime(self) -> bool:
        """Whether the wall clock paces the cycles."""
        return self.command is BenchCommand.RUN_REALTIME

    def stops_after(self, newest: int, *, realtime: bool) -> bool:
        """Return whether this tells a node to stop for which `newest` is the newest cycle; -1 if none has begun."""
        lag = newest + 1 - self.cycle
        return self.command is BenchCommand.STOP and self.cycle > 0 and 0 <= lag <= (STOP_LAG if realtime else 0)


def read_sync(layout: Layout, data: bytes) -> Sync | None:
    """Return the BenchSync, whose layout is given, in the bytes of a frame; None if it is not whole and consistent."""
    if len(data) != _LENGTH or not is_whole(data, layout.crc_of_id):
        return None
    values = layout.decode(data)
    cycle = int(values["Cycle"])
    is_consistent = (
        layout.is_possible(values)
        and values["AliveCounter"] == cycle % COUNTER_MODULUS
        and abs(values["Time"] - min(time_of(cycle), _LATEST_S)) <= _ROUNDING_S
    )
    return Sync(BenchCommand(int(values["Command"])), cycle) if is_consistent else None
