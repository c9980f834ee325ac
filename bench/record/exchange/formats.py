"""The exchange formats, and the conversion of identifiers, times and names between our log and theirs."""

from __future__ import annotations

import importlib
import re
import sys
from collections.abc import Mapping, Sequence
from enum import StrEnum
from pathlib import Path

import can.io.mf4

from bench.errors import BadInput

LONGEST_NS = 1 << 51
"""Longest time from a file's start, 26 days: up to here python-can's float seconds distinguish every ns."""

STANDARD_MAX, EXTENDED_MAX = 0x7FF, 0x1FFF_FFFF
"""Largest identifiers of 11 and of 29 bits."""

EXTENDED_FLAG = 0x8000_0000
"""Marks a 29-bit identifier in our log that would fit into 11 bits (Linux's CAN_EFF_FLAG); larger ones need no mark."""

BUS_NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
"""A bus name that all formats can carry and that is valid in a schema name."""

NAMES_TITLE = "platoon buses:"
"""Begins the comment with the names of the numbered channels: `platoon buses: 1=v2v 2=veh1;`."""
_NAMES = re.compile(rf"{NAMES_TITLE}((?: \d+=\w+)+);", re.ASCII)


class Format(StrEnum):
    """A format of frame logs."""

    CANDUMP = "candump"
    ASC = "asc"
    BLF = "blf"
    MF4 = "mf4"

    @property
    def suffix(self) -> str:
        """Suffixes of its files."""
        return ".log" if self is Format.CANDUMP else f".{self.value}"

    @classmethod
    def of(cls, path: Path, others: Sequence[str] = ()) -> Format:
        """Return the format by a file's suffix.

        Args:
            path: the file.
            others: other allowed suffixes, without the dot, for the message.

        Raises:
            BadInput: the suffix is unknown.
        """
        for each in cls:
            if path.suffix.lower() == each.suffix:
                return each
        known = ", ".join(
            [*(f"{each.suffix} ({each.value})" for each in cls), *(f".{each} ({each})" for each in others)]
        )
        raise BadInput(f"{path}: unknown suffix; allowed: {known}, or give --format")

    def check_available(self) -> None:
        """Load the library that a format needs.

        Raises:
            BadInput: MF4 without asammdf.
        """
        if self is not Format.MF4:
            return
        shut_out = sys.modules.get("asammdf", self) is None
        if shut_out:
            del sys.modules["asammdf"]
        try:
            importlib.import_module("asammdf")
        except ImportError as error:
            raise BadInput("MF4 files need the package asammdf; install it with: pip install asammdf") from error
        if shut_out:
            # It has been imported without asammdf, see `bench`.
            importlib.reload(can.io.mf4)


def to_log_id(can_id: int, *, extended: bool) -> int:
    """Return an identifier in our log's form."""
    return can_id | EXTENDED_FLAG if extended and can_id <= STANDARD_MAX else can_id


def from_log_id(log_id: int) -> tuple[int, bool]:
    """Return the identifier of our log's `log_id`, and whether it has 29 bits."""
    can_id = log_id & EXTENDED_MAX
    return can_id, log_id != can_id or can_id > STANDARD_MAX


def names_comment(numbers: Mapping[str, int]) -> str:
    """Return the comment with the channel number of each bus (name -> number)."""
    return " ".join([NAMES_TITLE, *(f"{number}={bus}" for bus, number in numbers.items())]) + ";"


def names_of(text: str) -> dict[str, str]:
    """Return the bus of each numbered channel if `text` has the comment of `names_comment`."""
    found = _NAMES.search(text)
    return dict(pair.split("=", 1) for pair in found[1].split()) if found else {}
