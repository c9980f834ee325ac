"""Writes frames to files of other tools with python-can's writers, exact to the ns of our log.

What python-can's writers would lose, and the remedies:

candump  writes 6 decimals: the time is given as a Decimal, which writes all it has, 9 where 6 are too few.
ASC      counts from the first frame and writes 6 decimals: counted from 0, with 9 decimals where 6 are too few.
BLF      counts from the first frame, cuts off to whole ns: counted from 0, half a ns added.
MF4      counts from the present (its floats then tell 240 ns apart at best): written with asammdf, counted from 0.

candump has bus names; the others number the buses and carry the names in a comment.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime
from decimal import Decimal
from pathlib import Path
from typing import cast

import can
import numpy as np

from bench.mcap.time_span import NS
from bench.record.can_frame import Frame
from bench.record.exchange.formats import Format, from_log_id, names_comment

MICROSECOND = 1_000

# Simulated time has no date. This is the one of BLF and candump, which use Unix time.
_TIME_0 = datetime.fromtimestamp(0, UTC)


def write(kind: Format, path: Path, frames: Iterable[Frame], numbers: Mapping[str, int], *, decimals: int) -> None:
    """Write frames, in order, to a new file; except for MF4, in bounded memory.

    Args:
        kind: format of the file.
        path: the file.
        frames: the frames in the order of time, none later than `LONGEST_NS`.
        numbers: channel number of each bus, from 1.
        decimals: number of decimals of times in seconds in text formats: 6 or 9.

    Raises:
        OSError: the file cannot be written.
    """
    match kind:
        case Format.CANDUMP:
            _write_candump(path, frames, decimals)
        case Format.ASC:
            _write_asc(path, frames, numbers, decimals)
        case Format.BLF:
            _write_blf(path, frames, numbers)
        case Format.MF4:
            _write_mf4(path, list(frames), numbers)


def _message(frame: Frame, timestamp: float, channel: str | int) -> can.Message:
    can_id, extended = from_log_id(frame.can_id)
    return can.Message(
        timestamp=timestamp, arbitration_id=can_id, is_extended_id=extended, data=frame.data, channel=channel
    )


def _write_candump(path: Path, frames: Iterable[Frame], decimals: int) -> None:
    with can.CanutilsLogWriter(path) as writer:
        for frame in frames:
            # The writer only formats and compares, which a Decimal supports.
            time_s = cast("float", Decimal(frame.time_ns // 10 ** (9 - decimals)).scaleb(-decimals))
            writer.on_message_received(_message(frame, time_s, frame.bus))


class _AscWriter(can.ASCWriter):
    """Counts from 0, not from the first frame, and names the buses; its date is time 0 of the log, as in MF4."""

    def begin(self, decimals: int, comment: str) -> None:
        """Write the header."""
        self.FORMAT_EVENT = f"{{timestamp: {decimals + 3}.{decimals}f}} {{message}}\n"
        self.started, self.header_written = 0.0, True
        self.file.write(f"// {comment}\nBegin Triggerblock {self._format_header_datetime(_TIME_0)}\n")
        self.log_event("Start of measurement", 0.0)

    def _format_header_datetime(self, _now: datetime) -> str:
        return _TIME_0.strftime("%a %b %d %H:%M:%S.000 %Y")


def _write_asc(path: Path, frames: Iterable[Frame], numbers: Mapping[str, int], decimals: int) -> None:
    with _AscWriter(path) as writer:
        writer.begin(decimals, names_comment(numbers))
        for frame in frames:
            # The writer adds 1 to a channel's number.
            writer.on_message_received(_message(frame, frame.time_ns / NS, numbers[frame.bus] - 1))


def _write_blf(path: Path, frames: Iterable[Frame], numbers: Mapping[str, int]) -> None:
    with can.BLFWriter(path) as writer:
        writer.log_event(names_comment(numbers), 0.0)
        for frame in frames:
            writer.on_message_received(_message(frame, (frame.time_ns + 0.5) / NS, numbers[frame.bus] - 1))


def _write_mf4(path: Path, frames: Sequence[Frame], numbers: Mapping[str, int]) -> None:
    from asammdf import MDF, Signal, Source
    from can.io.mf4 import STD_DTYPE

    name = "CAN_DataFrame"
    samples = np.zeros(len(frames), STD_DTYPE)
    identifiers = [from_log_id(frame.can_id) for frame in frames]
    lengths = np.array([len(frame.data) for frame in frames], np.uint8)
    samples[f"{name}.BusChannel"] = [numbers[frame.bus] for frame in frames]
    samples[f"{name}.ID"] = [can_id for can_id, _ in identifiers]
    samples[f"{name}.IDE"] = [extended for _, extended in identifiers]
    samples[f"{name}.DLC"] = samples[f"{name}.DataLength"] = lengths
    padded = b"".join(frame.data.ljust(8, b"\0") for frame in frames)
    samples[f"{name}.DataBytes"][:, :8] = np.frombuffer(padded, np.uint8).reshape(-1, 8)
    times_s = np.array([frame.time_ns for frame in frames], np.int64) / NS
    source = Source(name, "", "", Source.SOURCE_BUS, Source.BUS_TYPE_CAN)
    with MDF(version="4.10") as mdf:
        mdf.header.start_time = _TIME_0
        mdf.header.comment = names_comment(numbers)
        mdf.append(Signal(samples, times_s, name=name, source=source))
        mdf.save(path, compression=2)
