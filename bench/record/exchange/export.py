"""Exports the frames of our log to a file of another tool."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bench.errors import BadInput
from bench.files import check_new, written_aside
from bench.mcap.time_span import NS
from bench.record.can_frame import Frame
from bench.record.exchange import writers
from bench.record.exchange.formats import BUS_NAME, LONGEST_NS, Format
from bench.record.reader import Run

# Contents of our log other than frames, by topic prefix.
_BESIDE = {"/signals/": "decoded signals", "/truth/": "truth", "/tf": "poses", "/plan/": "plans", "/events": "events"}


@dataclass(frozen=True)
class Exported:
    """The result of an export.

    Attributes:
        frames: number of frames.
        channels: bus -> its number in the file; its name there in candump.
        notes: data that the file does not carry, and other notes; a line each.
    """

    frames: int
    channels: dict[str, str]
    notes: tuple[str, ...]


def export_log(log: Path, target: Path, kind: Format, buses: Sequence[str] = ()) -> Exported:
    """Write the frames of `log` to the new file `target`; all buses if none is named. Times are those of the log.

    Raises:
        BadInput: the log cannot be read, has no such bus or no frame, or the file cannot be written.
    """
    kind.check_available()
    check_new(target, kind.suffix)
    run = Run(log)
    numbers = {bus: number for number, bus in enumerate(run.buses, 1) if bus in (buses or run.buses)}
    for bus in buses:
        if bus not in numbers:
            raise BadInput(f"--bus {bus}: {log} has no such bus; it has {', '.join(run.buses) or 'none'}")
    for bus in numbers:
        if not BUS_NAME.fullmatch(bus):
            raise BadInput(f"{log}: bus {bus!r} has a name that {kind} cannot carry")
    what = _survey(run, numbers)
    if not what.frames:
        raise BadInput(f"{log} holds no frame: there is nothing to export")
    if what.last_ns > LONGEST_NS:
        limit = f"times are exported exactly up to {LONGEST_NS // NS} s"
        raise BadInput(f"{log} has a frame at {what.last_ns / NS:.0f} s; {limit}")
    frames: Iterable[Frame] = (frame for frame in run.frames() if frame.bus in numbers)
    if not what.in_order:
        frames = sorted(frames, key=lambda frame: frame.time_ns)
    with written_aside(target, new=True) as path:
        writers.write(kind, path, frames, numbers, decimals=what.decimals)
    named = {bus: bus if kind is Format.CANDUMP else str(number) for bus, number in numbers.items()}
    return Exported(what.frames, named, tuple(_notes(run, kind, what)))


@dataclass(frozen=True)
class _Survey:
    """The result of a first pass over the frames, so that they need not be held in memory.

    Attributes:
        frames: number of frames.
        last_ns: time of the latest frame.
        in_order: whether they are sorted by time.
        decimals: number of decimals that the times need in seconds, 6 or 9.
    """

    frames: int
    last_ns: int
    in_order: bool
    decimals: int


def _survey(run: Run, buses: Iterable[str]) -> _Survey:
    count, last_ns, in_order, decimals = 0, -1, True, 6
    for group in run.log.parts([f"/can/{bus}" for bus in buses]):
        times = np.concatenate([part.time_ns for _, part in group])
        times = times[np.argsort(np.concatenate([part.offsets for _, part in group]))]
        in_order &= bool(times[0] >= last_ns and (np.diff(times) >= 0).all())
        count, last_ns = count + len(times), max(last_ns, int(times.max()))
        decimals = 9 if (times % writers.MICROSECOND).any() else decimals
    return _Survey(count, last_ns, in_order, decimals)


def _notes(run: Run, kind: Format, what: _Survey) -> list[str]:
    beside = [name for start, name in _BESIDE.items() if any(topic.startswith(start) for topic in run.topics)]
    beside += ["attachments"] if run.attachments else []
    notes = [f"{kind} carries frames only; left out: {', '.join([*beside, 'metadata, receive and wire times'])}"]
    if kind in (Format.CANDUMP, Format.ASC) and what.decimals > 6:
        notes.append("times are not whole microseconds: written with 9 decimals, which can-utils may not read")
    if not what.in_order:
        notes.append("the log's frames were not in the order of time; the file's are")
    return notes
