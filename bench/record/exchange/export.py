"""Exports the frames of our log to a file of another tool."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from bench.errors import BadInput
from bench.record.can_frame import Frame
from bench.record.exchange import writers
from bench.record.exchange.aside import check_new, written_aside
from bench.record.exchange.formats import BUS_NAME, LONGEST_NS, NS, Format
from bench.record.reader import Run

# What our log has beside frames, by the beginning of its topics.
_BESIDE = {"/signals/": "decoded signals", "/truth/": "truth", "/tf": "poses", "/plan/": "plans", "/events": "events"}


@dataclass(frozen=True)
class Exported:
    """What was exported.

    Attributes:
        frames: how many.
        channels: bus -> its number in the file; its name there in candump.
        notes: what the file does not carry, and what to know of it; a line each.
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
    frames = [frame for frame in run.frames() if frame.bus in numbers]
    if not frames:
        raise BadInput(f"{log} holds no frame: there is nothing to export")
    ordered = sorted(frames, key=lambda frame: frame.time_ns)
    if ordered[-1].time_ns > LONGEST_NS:
        limit = f"times are exported exactly up to {LONGEST_NS // NS} s"
        raise BadInput(f"{log} has a frame at {ordered[-1].time_ns / NS:.0f} s; {limit}")
    with written_aside(target) as path:
        writers.write(kind, path, ordered, numbers)
    named = {bus: bus if kind is Format.CANDUMP else str(number) for bus, number in numbers.items()}
    return Exported(len(frames), named, tuple(_notes(run, kind, ordered, in_order=ordered == frames)))


def _notes(run: Run, kind: Format, frames: Sequence[Frame], *, in_order: bool) -> list[str]:
    beside = [what for start, what in _BESIDE.items() if any(topic.startswith(start) for topic in run.topics)]
    beside += ["attachments"] if run.attachments else []
    notes = [f"{kind} carries frames only; left out: {', '.join([*beside, 'metadata, receive and wire times'])}"]
    if kind in (Format.CANDUMP, Format.ASC) and not writers.fits_microseconds(frames):
        notes.append("times are not whole microseconds: written with 9 decimals, which can-utils may not read")
    if not in_order:
        notes.append("the log's frames were not in the order of time; the file's are")
    return notes
