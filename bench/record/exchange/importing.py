"""Imports files of other tools into one of our logs: frames, and their signals decoded with a DBC."""

from __future__ import annotations

import re
import shlex
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

from bench.bus.codec import DBC_DIR, MAX_VEHICLES, Codec
from bench.errors import BadInput
from bench.files import check_new, written_aside
from bench.mcap.time_span import NS
from bench.names import V2V
from bench.record.can_frame import MOST_BUSES
from bench.record.exchange.formats import BUS_NAME, LONGEST_NS, Format
from bench.record.exchange.readers import Contents, Logged, read
from bench.record.writer import RunWriter

UNIX_FROM_S = 631_152_000
"""Times from here on (1990) are calendar times; BLF uses the same limit."""

_VEHICLE_BUS = re.compile(r"veh([1-9]\d*)")
_NUMBERED = re.compile(r"(.*?)(\d+)")


@dataclass(frozen=True)
class Imported:
    """The result of an import.

    Attributes:
        frames: bus -> number of frames.
        notes: data left out, and other notes on the log; a line each.
    """

    frames: dict[str, int]
    notes: tuple[str, ...]


def import_logs(
    files: Sequence[Path],
    target: Path,
    *,
    kind: Format | None = None,
    buses: Mapping[str, str] | None = None,
    dbc: Sequence[str] = (),
    command_line: Sequence[str] = (),
) -> Imported:
    """Write the frames of `files`, merged in the order of time, to the new log `target`.

    Times are those of the files. For calendar times (Unix time), the log counts from the whole second before the first
    frame, `origin_unix_s` in its metadata; the receive times stay calendar times.

    Args:
        files: the files to import.
        target: the log to create, named .mcap.
        kind: their format; from each file's name if not given.
        buses: channel in the files -> name of the bus. Else our own exports contain the names, a named channel keeps
            its name, and channel 1 becomes `can1`.
        dbc: `FILE` for all buses, `BUS=FILE` for one; else `v2v` and `veh<i>` have the bench's own.
        command_line: the command line, for the metadata.

    Raises:
        BadInput: a file is unreadable or invalid, a channel to be named is not in the files, a DBC is unusable, or the
            log cannot be written.
        RunFailed: the disk is full.
    """
    check_new(target, ".mcap")
    kinds = [kind or Format.of(file) for file in files]
    contents = [read(each, file) for each, file in zip(kinds, files, strict=True)]
    names = _bus_names(contents, buses or {})
    frames = sorted(
        (
            (frame, name[frame.channel])
            for content, name in zip(contents, names, strict=True)
            for frame in content.frames
        ),
        key=lambda pair: pair[0].time_ns,
    )
    origin_ns = _origin_ns(frames[0][0].time_ns, frames[-1][0].time_ns)
    seen = Counter((bus, frame.log_id) for frame, bus in frames)
    codecs = _codecs(sorted({bus for bus, _ in seen}, key=_bus_order), dbc)
    left_out = sum((content.left_out for content in contents), Counter[str]())
    sent = sum(content.sent for content in contents)
    metadata = {
        "source": ", ".join(file.name for file in files),
        "source_format": ", ".join(dict.fromkeys(kinds)),
        "source_channels": ", ".join(dict.fromkeys(f"{a}={b}" for name in names for a, b in name.items())),
        "command_line": shlex.join(command_line),
        "imported": datetime.now(UTC).isoformat(timespec="seconds"),
        "origin_unix_s": str(origin_ns // NS),
        **{f"left out: {what}": str(count) for what, count in left_out.items()},
        "version python-can": version("python-can"),
    }
    with written_aside(target, new=True) as path:
        _write(path, frames, origin_ns, codecs, metadata)
    return Imported(
        frames={bus: sum(count for (of, _), count in seen.items() if of == bus) for bus in codecs},
        notes=(
            *(note for content in contents for note in content.notes),
            *(f"left out: {count} {what}" for what, count in left_out.items()),
            *([f"not kept: that {sent} frames were marked as sent (Tx)"] if sent else []),
            *_undecoded(codecs, seen),
        ),
    )


def _write(
    path: Path,
    frames: Sequence[tuple[Logged, str]],
    origin_ns: int,
    codecs: Mapping[str, Codec],
    metadata: Mapping[str, str],
) -> None:
    numbers = [int(found[1]) for bus in codecs if (found := _VEHICLE_BUS.fullmatch(bus))]
    with RunWriter(
        path,
        codecs=codecs,
        truth_names=(),
        vehicles=max((number for number in numbers if number <= MAX_VEHICLES), default=0),
        metadata=metadata,
        attachments={},
    ) as writer:
        for frame, bus in frames:
            writer.frame(bus, frame.time_ns - origin_ns, frame.log_id, frame.data, frame.time_ns)
        writer.close({"status": "imported"})


def _bus_names(contents: Sequence[Contents], chosen: Mapping[str, str]) -> list[dict[str, str]]:
    """Return, for each file, the bus of each channel.

    Raises:
        BadInput: a given name is invalid, or its channel is in no file.
    """
    channels = [dict.fromkeys(frame.channel for frame in content.frames) for content in contents]
    found = list(dict.fromkeys(channel for each in channels for channel in each))
    if len(found) > MOST_BUSES:
        raise BadInput(f"the files have {len(found)} channels; a log may have at most {MOST_BUSES} CAN buses")
    for channel, bus in chosen.items():
        if channel not in found:
            raise BadInput(f"--bus {channel}={bus}: no frame of a channel {channel}; the files have {', '.join(found)}")
        if not BUS_NAME.fullmatch(bus):
            raise BadInput(
                f"--bus {channel}={bus}: a bus name is letters, digits and _, and does not begin with a digit"
            )
    return [
        {channel: chosen.get(channel) or content.names.get(channel) or _default_name(channel) for channel in each}
        for content, each in zip(contents, channels, strict=True)
    ]


def _default_name(channel: str) -> str:
    name = re.sub(r"\W", "_", channel, flags=re.ASCII)
    return f"can{name}" if name[0].isdigit() else name


def _bus_order(bus: str) -> tuple[bool, str, int]:
    """Order v2v, veh1, veh2, ... veh10, then the others, as in logs of runs."""
    found = _NUMBERED.fullmatch(bus)
    return bus != V2V and not _VEHICLE_BUS.fullmatch(bus), found[1] if found else bus, int(found[2]) if found else 0


def _origin_ns(first_ns: int, last_ns: int) -> int:
    """Return the time from which the log counts.

    Raises:
        BadInput: calendar times are mixed with others, or the times are too far apart.
    """
    unix_ns = UNIX_FROM_S * NS
    if first_ns < unix_ns <= last_ns:
        raise BadInput("some times are calendar times and some count from a start; import them into separate logs")
    origin_ns = first_ns // NS * NS if first_ns >= unix_ns else 0
    if last_ns - origin_ns > LONGEST_NS:
        raise BadInput(f"the frames span {(last_ns - origin_ns) / NS:.0f} s; a log may span {LONGEST_NS // NS} s")
    return origin_ns


def _codecs(buses: Sequence[str], dbc: Sequence[str]) -> dict[str, Codec]:
    """Return the codec of each bus, without messages if there is no DBC.

    Raises:
        BadInput: a DBC file is unusable, or is for a bus that does not exist.
    """
    for_all: Path | None = None
    for_one: dict[str, Path] = {}
    for given in dbc:
        bus, equals, file = given.partition("=")
        if not equals or Path(given).is_file():
            for_all = Path(given)
        elif bus in buses:
            for_one[bus] = Path(file)
        else:
            raise BadInput(f"--dbc {given}: there is no bus {bus}; allowed: {', '.join(buses)}")
    paths = {bus: for_one.get(bus) or for_all or _own_dbc(bus) for bus in buses}
    return {bus: Codec(path) if path else Codec.without_messages() for bus, path in paths.items()}


def _own_dbc(bus: str) -> Path | None:
    if bus == V2V:
        return DBC_DIR / "v2v.dbc"
    return DBC_DIR / "vehicle.dbc" if _VEHICLE_BUS.fullmatch(bus) else None


def _undecoded(codecs: Mapping[str, Codec], seen: Mapping[tuple[str, int], int]) -> list[str]:
    """Return notes on frames without decoded signals."""
    notes = []
    for bus, codec in codecs.items():
        if not codec.names:
            notes.append(f"{bus}: no DBC, so frames only; give --dbc {bus}=FILE")
            continue
        known = set(codec.can_ids)
        unknown = {log_id: count for (of, log_id), count in seen.items() if of == bus and log_id not in known}
        if unknown:
            notes.append(f"{bus}: {sum(unknown.values())} frames of {len(unknown)} identifiers are not in its DBC")
    return notes
