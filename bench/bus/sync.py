"""BenchSync as its receivers accept it.

It opens a cycle for everybody, or ends the run, so it must be whole and consistent: command in its value table, alive
counter and time those of its cycle. Each receiver also requires that its cycle follows those before.
"""

from typing import NamedTuple

from bench.bus.codec import Codec
from bench.bus.e2e import COUNTER_MODULUS, check
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


def read_sync(codec: Codec, data: bytes) -> Sync | None:
    """Return the BenchSync in the bytes of a frame of its identifier; None if it is not whole and consistent."""
    can_id = codec.can_id(BENCH_SYNC)
    if len(data) != _LENGTH or not check(data, codec.data_id(BENCH_SYNC)):
        return None
    values = codec.decode(can_id, data)[1]
    cycle = int(values["Cycle"])
    is_consistent = (
        codec.is_possible(can_id, values)
        and values["AliveCounter"] == cycle % COUNTER_MODULUS
        and abs(values["Time"] - min(time_of(cycle), _LATEST_S)) <= _ROUNDING_S
    )
    return Sync(BenchCommand(int(values["Command"])), cycle) if is_consistent else None
