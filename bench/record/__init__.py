"""The MCAP log: writing, reading, comparing."""

from bench.record.compare import Difference, diff
from bench.record.reader import Event, LogDamaged, Run
from bench.record.writer import RunWriter

__all__ = ["Difference", "Event", "LogDamaged", "Run", "RunWriter", "diff"]
