"""Processor usage of a process of the bench, `platoon.ProcessUsage`, once per second of wall-clock time."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bench.record.layout import Field, Layout, file_descriptor_set

NAME = "platoon.ProcessUsage"
LAYOUT = Layout(
    [
        Field("cpu_time", "double", "s", "time on a processor since the process started, user and system"),
        Field("cpu_share", "double", "", "processors taken since the sample before: 1 is one of them all the time"),
        Field("memory", "fixed64", "B", "resident memory"),
        Field("preemptions", "fixed64", "", "how often others took its processor (involuntary context switches)"),
    ]
)
UNITS = {f"unit {field.name}": field.unit for field in LAYOUT.fields if field.unit}
SCHEMA = file_descriptor_set(NAME, LAYOUT, "What a process has taken of the machine. Differs from run to run.")


class ProcessUsage(NamedTuple):
    """One sample; see the fields of `LAYOUT`."""

    cpu_time: float
    cpu_share: float
    memory: int
    preemptions: int

    def encoded(self) -> bytes:
        """Return the sample as a message."""
        row = np.frombuffer(LAYOUT.template, LAYOUT.dtype).copy()
        for name, value in self._asdict().items():
            row[name] = value
        return row.tobytes()
