"""BenchAbsent: in virtual time, the announcement that a due frame of a cycle will not be sent."""

from typing import NamedTuple

from bench.bus.e2e import is_whole
from bench.bus.layout import Layout

BENCH_ABSENT = "BenchAbsent"

_LENGTH = 8


class Absence(NamedTuple):
    """Identifier of the absent frame, and its cycle."""

    can_id: int
    cycle: int


def read_absence(layout: Layout, data: bytes) -> Absence | None:
    """Return what a BenchAbsent, whose layout is given, announces; None if its bytes are not whole."""
    if len(data) != _LENGTH or not is_whole(data, layout.crc_of_id):
        return None
    values = layout.decode(data)
    return Absence(int(values["Identifier"]), int(values["Cycle"]))
