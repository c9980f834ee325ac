"""Reads files of other tools with python-can's readers, with exact times.

python-can gives times as float seconds, which resolve today's times to 240 ns at best. So the times of text files are
read from the text, and those of binary files count from the file's start.
"""

from __future__ import annotations

import gc
import logging
import re
import struct
import sys
import zlib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from decimal import Decimal
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple, TextIO

import can
from can.io.blf import BLFParseError

from bench.errors import BadInput
from bench.mcap.time_span import NS
from bench.record.can_frame import MAX_DATA
from bench.record.exchange.formats import EXTENDED_MAX, STANDARD_MAX, Format, names_of, to_log_id

# The errors raised by python-can's readers, and the libraries below them, on invalid files.
_UNREADABLE = (
    ValueError, LookupError, TypeError, AttributeError, ArithmeticError, EOFError, MemoryError, RuntimeError,
    struct.error, zlib.error, BLFParseError,
)  # fmt: skip


class Logged(NamedTuple):
    """One data frame of a file: time in ns as in the file, channel, identifier in our log's form."""

    time_ns: int
    channel: str
    log_id: int
    data: bytes


@dataclass
class Contents:
    """The contents of a file.

    Attributes:
        frames: the frames that our log can hold, in the order of the file.
        names: channel -> bus, if the file contains them, as our own exports do.
        left_out: kind of other contents -> number.
        sent: number of frames that the logging tool sent itself (Tx).
        notes: notes on the file, a line each.
    """

    frames: list[Logged] = field(default_factory=list)
    names: dict[str, str] = field(default_factory=dict)
    left_out: Counter[str] = field(default_factory=Counter)
    sent: int = 0
    notes: list[str] = field(default_factory=list)

    def add(self, message: can.Message, time_ns: int, channel: str) -> None:
        """Add a message, or count it as left out.

        Raises:
            ValueError: it is not a CAN frame.
        """
        if message.is_error_frame:
            self.left_out["error frames"] += 1
        elif message.is_fd:
            self.left_out["CAN FD frames"] += 1
        elif message.is_remote_frame:
            self.left_out["remote frames"] += 1
        else:
            data, can_id = bytes(message.data), message.arbitration_id
            if len(data) != message.dlc or len(data) > MAX_DATA:
                raise ValueError(f"{len(data)} data bytes where its length is {message.dlc}, at most {MAX_DATA}")
            if can_id > (EXTENDED_MAX if message.is_extended_id else STANDARD_MAX):
                raise ValueError(f"identifier 0x{can_id:X} is too large")
            if time_ns < 0:
                raise ValueError("its time is negative")
            self.sent += not message.is_rx
            self.frames.append(Logged(time_ns, channel, to_log_id(can_id, extended=message.is_extended_id), data))


def read(kind: Format, path: Path) -> Contents:
    """Return the contents of a file.

    Raises:
        BadInput: the file is unreadable or invalid.
    """
    kind.check_available()
    if not path.is_file():
        raise BadInput(f"{path} is {'a directory' if path.is_dir() else 'not there'}; give a {kind} file")
    readers: dict[Format, Callable[[Path, Contents], None]] = {
        Format.CANDUMP: _read_candump,
        Format.ASC: _read_asc,
        Format.BLF: _read_blf,
        Format.MF4: _read_mf4,
    }
    contents = Contents()
    try:
        readers[kind](path, contents)
    except OSError as error:
        raise BadInput(f"{path} cannot be read: {error.strerror or error}") from error
    except _UNREADABLE as error:
        what = str(error) or type(error).__name__
        raise BadInput(f"{path} is not a whole {kind} file: {what}") from error
    if not contents.frames:
        others = ", ".join(f"{count} {what}" for what, count in contents.left_out.items())
        raise BadInput(f"{path} holds no {kind} frame of at most 8 bytes{f', only {others}' if others else ''}")
    return contents


LONGEST_LINE = 10_000
"""Characters of a line of a text file; one with a CAN FD frame has some 300."""


class _Lines:
    """A text file that remembers its last line, so that a reader's results and errors can be traced to it.

    Attributes:
        number, text: the last line.
    """

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self.number = 0
        self.text = ""

    def __iter__(self) -> Iterator[str]:
        return self

    def __next__(self) -> str:
        line = self._stream.readline(LONGEST_LINE + 1)
        if not line:
            raise StopIteration
        self.text = line
        self.number += 1
        if len(self.text) > LONGEST_LINE:
            raise ValueError(f"it has more than {LONGEST_LINE} characters")
        return self.text

    def close(self) -> None:
        """Close the file; python-can's readers do so at its end."""
        self._stream.close()


class _AscLines(_Lines):
    """Ends the header of an ASC file with the required line: without it, python-can's reader loses the first frame.

    Attributes:
        events: number of lines with a time: frames, statistics, states ...
    """

    events = 0
    _held: str | None = None
    _in_head = True

    def __next__(self) -> str:
        if self._held is not None:
            held, self._held = self._held, None
            return held
        line = super().__next__()
        if not line.lstrip()[:1].isdigit():
            return line
        self.events += "Start of measurement" not in line
        if self._in_head:
            self._in_head, self._held = False, line
            return "internal events logged\n"
        return line


def _ns(seconds: str) -> int:
    time = Decimal(seconds) * NS
    if time != int(time):
        raise ValueError(f"time {seconds}: at most 9 decimals (ns) are allowed")
    return int(time)


def _read_lines(
    path: Path,
    contents: Contents,
    lines: _Lines,
    reader: Callable[[Any], Iterable[can.Message]],
    take: Callable[[can.Message, str], None],
) -> None:
    """Read a text file and pass each message with its line to `take`."""
    try:
        for message in reader(lines):
            take(message, lines.text)
    except _UNREADABLE as error:
        raise ValueError(f"line {lines.number}: {error}: {lines.text.strip()[:80]!r}") from error
    if lines.text and not lines.text.endswith("\n"):
        contents.notes.append(f"{path} ends within a line: it may be truncated")


# Bytes at the beginning of a file in which comments are searched for.
_HEAD = 4096

_CANDUMP_LINE = re.compile(r"\((\d+\.\d+)\)\s+(\S+)\s+([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})#(\S*)(\s+[RTrt])?\s*")
_CLASSIC_DATA = re.compile(r"([0-9A-Fa-f]{2})*")
_ERROR_FLAG = 0x2000_0000


def _read_candump(path: Path, contents: Contents) -> None:
    def take(message: can.Message, line: str) -> None:
        found = _CANDUMP_LINE.fullmatch(line)
        if found is None:
            raise ValueError("not a line as candump -L writes it")
        # python-can supports one kind of error frame; candump logs all of them.
        message.is_error_frame |= bool(int(found[3], 16) & _ERROR_FLAG)
        classic = not (message.is_error_frame or message.is_fd or message.is_remote_frame)
        if classic and not _CLASSIC_DATA.fullmatch(found[4]):
            raise ValueError("its data is not whole bytes in hexadecimal")
        contents.add(message, _ns(found[1]), found[2])

    with path.open(encoding="utf-8", errors="replace") as stream:
        _read_lines(path, contents, _Lines(stream), can.CanutilsLogReader, take)


def _read_asc(path: Path, contents: Contents) -> None:
    def take(message: can.Message, line: str) -> None:
        contents.add(message, _ns(line.split(None, 1)[0]), _channel(message, 1))

    with path.open(encoding="cp1252", errors="replace") as stream:
        head = stream.read(_HEAD)
        contents.names = names_of(head)
        if re.search(r"^base\s+\w+\s+timestamps\s+relative", head, re.IGNORECASE | re.MULTILINE):
            raise ValueError("its times count from the line before; save it with `timestamps absolute`")
        stream.seek(0)
        lines = _AscLines(stream)
        _read_lines(path, contents, lines, can.ASCReader, take)
    # python-can skips lines that it does not recognise.
    if others := lines.events - len(contents.frames) - contents.left_out.total():
        contents.left_out["other events"] = others


class _BlfReader(can.BLFReader):
    """Also reads the comment with the names of the buses, the first object of the first container."""

    names: dict[str, str] | None = None

    def _parse_container(self, data: bytes) -> Iterator[can.Message]:
        if self.names is None:
            self.names = names_of(data[:_HEAD].decode("latin-1"))
        yield from super()._parse_container(data)


def _read_blf(path: Path, contents: Contents) -> None:
    with _BlfReader(path) as reader:
        size = path.stat().st_size
        if reader.file_size > size:
            raise ValueError(f"it has {size} of its {reader.file_size} bytes")
        if reader.file_size < size:
            contents.notes.append(f"{path} was not closed by its writer: it may be truncated")
        start_ns = round(reader.start_timestamp * 1000) * (NS // 1000)
        reader.start_timestamp = 0.0
        for message in reader:
            contents.add(message, start_ns + round(message.timestamp * NS), _channel(message, 1))
        contents.names = reader.names or {}


class _Mf4Reader(can.MF4Reader):
    """Counts from the start of the measurement, and provides that start."""

    def __init__(self, stream: BinaryIO) -> None:
        super().__init__(stream)
        header = self._mdf.header
        self.comment = str(header.comment)
        # `abs_time` is exact, but may be local time; the difference is whole seconds.
        to_utc_s = round(header.start_time.timestamp() - header.abs_time / NS)
        self.start_ns = int(header.abs_time) + to_utc_s * NS
        self._start_timestamp = 0.0


def _read_mf4(path: Path, contents: Contents) -> None:
    with _quiet_asammdf():
        failure = _try_mf4(path, contents)
    if failure:
        raise ValueError(failure)


def _try_mf4(path: Path, contents: Contents) -> str:
    """Read an MF4 file; return its problem, empty if none."""
    try:
        with path.open("rb") as stream, _Mf4Reader(stream) as reader:
            contents.names = names_of(reader.comment)
            for message in reader:
                contents.add(message, reader.start_ns + round(message.timestamp * NS), _channel(message, 0))
    except Exception as error:  # noqa: BLE001  asammdf's errors and those of its decompressors have no other base
        return str(error) or type(error).__name__
    return ""


@contextmanager
def _quiet_asammdf() -> Iterator[None]:
    """Keep asammdf from printing tracebacks: it logs its errors, and fails to delete files that it could not open."""
    log, hook = logging.getLogger("asammdf"), sys.unraisablehook
    level = log.level
    log.setLevel(logging.CRITICAL + 1)
    sys.unraisablehook = lambda _unraisable: None
    try:
        yield
        gc.collect()
    finally:
        log.setLevel(level)
        sys.unraisablehook = hook


def _channel(message: can.Message, first: int) -> str:
    """Return a message's channel number in the file; python-can counts from a number lower by `first`."""
    return str(message.channel + first) if isinstance(message.channel, int) else "0"
