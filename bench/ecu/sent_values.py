"""Watches what an ECU sends: values that are not numbers, and values outside the DBC's range.

A message with a value that is not a number (NaN or infinite) is not sent in that cycle: a receiver of a command that is
missing holds, then goes to its safe state, while any number in its place would be obeyed. A finite value outside its
signal's range is sent as the end of the range. Both are reported.
"""

from collections.abc import Callable, Mapping
from math import isfinite
from typing import NamedTuple

import cython

from bench.bus.codec import Codec
from bench.bus.topic import Outgoing
from bench.events import Clipped, EcuNote, NotANumber, NumberAgain

Note = Callable[[EcuNote], None]
"""Takes what there is to report."""


class _Message(NamedTuple):
    """A message: each signal with its range, whether others act on it, and whether it has wall-clock times."""

    ranges: tuple[tuple[str, float, float], ...]
    command: bool
    wall_clock: bool


class SentValues:
    """The values that one ECU sends, cycle by cycle.

    Attributes:
        not_numbers: number of values so far that are not numbers.
    """

    def __init__(self, name: str, codecs: Mapping[str, Codec], note: Note) -> None:
        """Watch the ECU `name` on the buses of `codecs`, and report to `note`."""
        self.not_numbers = 0
        self._name = name
        self._codecs = codecs
        self._note = note
        self._messages: dict[tuple[str, str], _Message] = {}
        self._since: dict[tuple[str, str, str], int] = {}
        self._clipped: set[tuple[str, str, str]] = set()

    def are_numbers(self, sent: Outgoing, cycle: int) -> bool:
        """Return whether all values of a message are numbers; report where that changes, and what will be clipped.

        A message that does not exist is left to the one who sends it.
        """
        message = self._messages.get((sent.bus, sent.message)) or self._message(sent)
        values, good = sent.values, True
        low: cython.double
        high: cython.double
        value: cython.double
        for signal, low, high in message.ranges:
            given = values.get(signal)
            if given is None:
                continue
            value = given
            if low <= value <= high:
                if self._since:
                    self._recovers((sent.bus, sent.message, signal), cycle)
                continue
            place = (sent.bus, sent.message, signal)
            if isfinite(value):
                self._recovers(place, cycle)
                if not message.wall_clock:
                    self._clips(place, cycle, value, low if value < low else high)
            else:
                good = False
                self._fails(place, cycle, str(value), command=message.command)
        return good

    def _message(self, sent: Outgoing) -> _Message:
        codec = self._codecs.get(sent.bus)
        if codec is None or sent.message not in codec.names:
            return _Message((), command=False, wall_clock=False)
        wall_clock = codec.is_wall_clock(codec.can_id(sent.message))
        found = _Message(codec.ranges(sent.message), codec.data_id(sent.message) != 0, wall_clock)
        self._messages[sent.bus, sent.message] = found
        return found

    def _fails(self, place: tuple[str, str, str], cycle: int, value: str, *, command: bool) -> None:
        self.not_numbers += 1
        if place not in self._since:
            self._since[place] = cycle
            self._note(NotANumber(self._name, cycle, place[1], place[2], value, command))

    def _recovers(self, place: tuple[str, str, str], cycle: int) -> None:
        since = self._since.pop(place, None)
        if since is not None:
            self._note(NumberAgain(self._name, cycle, place[1], place[2], cycle - since))

    def _clips(self, place: tuple[str, str, str], cycle: int, value: float, sent: float) -> None:
        if place not in self._clipped:
            self._clipped.add(place)
            self._note(Clipped(self._name, cycle, place[1], place[2], value, sent))
