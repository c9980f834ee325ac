"""BenchAbsent: in virtual time, the announcement that a due frame of a cycle will not be sent."""

from typing import NamedTuple

from bench.bus.codec import Codec
from bench.bus.e2e import check

BENCH_ABSENT = "BenchAbsent"

_LENGTH = 8


class Absence(NamedTuple):
    """Identifier of the absent frame, and its cycle."""

    can_id: int
    cycle: int


def read_absence(codec: Codec, data: bytes) -> Absence | None:
    """Return what the bytes of a BenchAbsent frame announce; None if they are not whole."""
    if len(data) != _LENGTH or not check(data, codec.data_id(BENCH_ABSENT)):
        return None
    values = codec.decode(codec.can_id(BENCH_ABSENT), data)[1]
    return Absence(int(values["Identifier"]), int(values["Cycle"]))
