"""Compares two runs frame by frame: the same scenario and seed must give the same bytes on every bus.

Messages with wall-clock times (DBC attribute WallClock) and the host's receive time are ignored.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from bench.bus.e2e import CRC_SIGNAL
from bench.counts import counted
from bench.errors import BadInput
from bench.mcap.time_span import NS
from bench.record.meaning import Meaning, meanings
from bench.record.reader import Run
from bench.record.time_join import same_times

# The columns that must be equal in two equal frames.
_COMPARED = ("time", "can_id", "length", "data")

_SAME_TIME_S = 1e-9


@dataclass(frozen=True)
class FirstDifference:
    """The first difference of two runs: the frame of each as text; None if a run has no more frames."""

    time_s: float
    bus: str
    a: str | None
    b: str | None


@dataclass(frozen=True)
class SignalDifference:
    """A signal that differs: start, number of differing values, and largest difference (NaN if not a number)."""

    bus: str
    message: str
    signal: str
    first_s: float
    count: int
    largest: float
    unit: str

    @property
    def at_most(self) -> str:
        """The largest difference, as text."""
        return f"by at most {self.largest:.6g} {self.unit}".rstrip()


@dataclass(frozen=True)
class Difference:
    """The differences between two runs.

    Attributes:
        frames: number of frames of each run, without wall-clock messages.
        first: the earliest difference, None if all frames are the same.
        signals: the signals that differ, sorted by the start of the difference.
        notes: other differences: buses, messages or frames that only one run has, and a run that ends earlier.
    """

    frames: tuple[int, int]
    first: FirstDifference | None
    signals: tuple[SignalDifference, ...]
    notes: tuple[str, ...]

    @property
    def same(self) -> bool:
        """Whether all frames are the same."""
        return self.first is None and not self.notes

    def as_dict(self) -> dict[str, Any]:
        """Return the differences as JSON values; a largest difference that is not a number is None."""
        signals = [
            {**asdict(each), "largest": each.largest if math.isfinite(each.largest) else None} for each in self.signals
        ]
        return {"same": self.same, **asdict(self), "signals": signals}

    def __str__(self) -> str:
        """Return the difference as text for a person."""
        if self.same:
            return f"same: {self.frames[0]} frames are the same, byte for byte (wall-clock messages left out)"
        lines = [f"different: {self.frames[0]} and {self.frames[1]} frames (wall-clock messages left out)"]
        if self.first:
            lines += [
                f"first difference at {self.first.time_s:.3f} s on {self.first.bus}:",
                f"  A: {self.first.a or 'no frame'}",
                f"  B: {self.first.b or 'no frame'}",
            ]
        lines += self.notes
        if self.signals:
            lines.append(f"{len(self.signals)} signal{'s differ' if len(self.signals) > 1 else ' differs'}:")
            lines += [
                f"  {s.bus} {s.message}.{s.signal}: from {s.first_s:.3f} s, {counted(s.count, 'value')}, {s.at_most}"
                for s in self.signals
            ]
        return "\n".join(lines)


def diff(a: Run | Path | str, b: Run | Path | str) -> Difference:
    """Compare two logs, each open or given by its path.

    Raises:
        BadInput: a file cannot be read, is not a log, or holds no frame.
    """
    runs = a if isinstance(a, Run) else Run(a), b if isinstance(b, Run) else Run(b)
    for run in runs:
        if not run.buses:
            raise BadInput(f"{run.path} holds no frame: there is nothing to compare")
    buses = [bus for bus in runs[0].buses if bus in runs[1].buses]
    notes = [*_only_one("bus", runs[0].buses, runs[1].buses)]
    firsts: list[FirstDifference] = []
    signals: list[SignalDifference] = []
    counts = [0, 0]
    for bus in buses:
        meant = meanings(*runs, bus)
        left_out = set[int]().union(*(meaning.wall_clock_ids for meaning in meant or ()))
        left, right = (_frames(run, bus, left_out) for run in runs)
        counts[0] += len(left)
        counts[1] += len(right)
        first = _first_difference(meant, bus, left, right)
        if first is None:
            continue
        firsts.append(first)
        ends = tuple(int(table["time"].max(initial=0)) / NS for table in (left, right))
        if ends[0] != ends[1]:
            notes.append(f"{bus} ends at {ends[0]:.3f} s in A, at {ends[1]:.3f} s in B")
        if meant is None:
            notes.append(f"{bus}: neither log tells what its frames mean, so no signals are compared")
            continue
        names = [[name for name, can_id in meaning.can_ids.items() if can_id not in left_out] for meaning in meant]
        notes += _only_one(f"message on {bus}", *names)
        for message in (name for name in names[0] if name in names[1]):
            end_s = min(ends) if ends[0] != ends[1] else math.inf
            found, note = _signal_differences(meant, bus, message, end_s)
            signals += found
            notes += note
    return Difference(
        frames=(counts[0], counts[1]),
        first=min(firsts, key=lambda first: first.time_s, default=None),
        signals=tuple(sorted(signals, key=lambda signal: signal.first_s)),
        notes=tuple(notes),
    )


def _frames(run: Run, bus: str, left_out: set[int]) -> npt.NDArray[Any]:
    table = run.frame_table(bus)
    table = table[~np.isin(table["can_id"], list(left_out))]
    if not table["wire"].any():
        return table
    # On an overloaded bus, a frame is logged only after its transmission, and what was written before depends on the
    # host's clock. Announcements of absent frames are never on the wire and have no order.
    never = table["wire"] == 0
    text = np.where(never, np.ascontiguousarray(table["data"]).view(">u8")[:, 0], 0)
    return table[np.lexsort((text, table["wire"], never, table["time"]))]


def _only_one(what: str, a: Iterable[str], b: Iterable[str]) -> list[str]:
    a, b = list(a), list(b)
    pairs = (("A", a, b), ("B", b, a))
    return [f"only {name} has {what} {item}" for name, own, other in pairs for item in own if item not in other]


def _first_difference(
    meant: tuple[Meaning, Meaning] | None, bus: str, left: npt.NDArray[Any], right: npt.NDArray[Any]
) -> FirstDifference | None:
    common = min(len(left), len(right))
    differs = np.zeros(common, np.bool_)
    for column in _COMPARED:
        unequal = left[column][:common] != right[column][:common]
        differs |= unequal.any(axis=1) if unequal.ndim > 1 else unequal
    at = int(np.argmax(differs)) if differs.any() else common
    rows = [table[at] if at < len(table) else None for table in (left, right)]
    if rows[0] is None and rows[1] is None:
        return None
    time_ns = min(int(row["time"]) for row in rows if row is not None)
    texts = [
        None if row is None else _describe(meaning, row, int((table["can_id"][:at] == row["can_id"]).sum()))
        for meaning, row, table in zip(meant or (None, None), rows, (left, right), strict=True)
    ]
    return FirstDifference(time_ns / NS, bus, texts[0], texts[1])


def _describe(meaning: Meaning | None, row: Any, before: int) -> str:
    """Return a frame as text: time, identifier, bytes and, if known, its signals.

    Args:
        meaning: of its bus.
        row: the frame, of `Run.frame_table`.
        before: number of earlier frames of its identifier on that bus; one cycle may have several.
    """
    can_id, data = int(row["can_id"]), row["data"].tobytes()[: int(row["length"])]
    text = f"{int(row['time']) / NS:.3f} s 0x{can_id:03X} [{data.hex(' ')}]"
    name = next((name for name, known in meaning.can_ids.items() if known == can_id), None) if meaning else None
    if meaning is None or name is None:
        return text
    message = meaning.message(name)
    # A frame of wrong length was not decoded, so the rank in the log does not identify the frame.
    if before >= len(message.columns["t"]) or abs(message.columns["t"][before] - row["time"] / NS) >= _SAME_TIME_S:
        return f"{text} {name}"
    return f"{text} {name}: {message.text(before)}"


def _signal_differences(
    meant: tuple[Meaning, Meaning], bus: str, message: str, end_s: float
) -> tuple[list[SignalDifference], list[str]]:
    """Return the signals of a message that differ, and a note if one run has more of its frames before `end_s`."""
    messages = meant[0].message(message), meant[1].message(message)
    tables = messages[0].columns, messages[1].columns
    rows = same_times(tables[0]["t"], tables[1]["t"])
    found = []
    for name in (name for name in tables[0] if name != "t" and name in tables[1]):
        values = [table[name][index].astype(np.float64) for table, index in zip(tables, rows, strict=True)]
        differs = ~((values[0] == values[1]) | (np.isnan(values[0]) & np.isnan(values[1])))
        if differs.any():
            found.append(
                SignalDifference(
                    bus=bus,
                    message=message,
                    signal=name,
                    first_s=float(tables[0]["t"][rows[0]][np.argmax(differs)]),
                    count=int(differs.sum()),
                    largest=float(np.abs(values[0] - values[1])[differs].max()),
                    unit=messages[0].units.get(name, ""),
                )
            )
    if len(found) > 1:
        # The CRC follows from the other signals; a difference matters only if those are equal.
        found = [signal for signal in found if signal.signal != CRC_SIGNAL]
    lengths = tuple(int((table["t"] < end_s).sum()) for table in tables)
    notes = [f"{message} on {bus}: {lengths[0]} frames in A, {lengths[1]} in B"] if lengths[0] != lengths[1] else []
    return found, notes
