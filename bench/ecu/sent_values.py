"""Watches what an ECU sends: values that are not numbers, and values outside the DBC's range.

A message with a value that is not a number (NaN or infinite) is not sent in that cycle: a receiver of a command that is
missing holds, then goes to its safe state, while any number in its place would be obeyed. A finite value outside its
signal's range is sent as the end of the range. Both are reported.
"""

from collections.abc import Callable, Mapping
from math import isfinite
from typing import Any

import cython

from bench.bus.codec import Codec
from bench.bus.topic import Outgoing
from bench.events import Clipped, EcuNote, NotANumber, NumberAgain

Note = Callable[[EcuNote], None]
"""Takes what there is to report."""


class _Range:
    """A signal and its range."""

    def __init__(self, signal: str, low: float, high: float) -> None:
        self.signal = signal
        self.low = low
        self.high = high


class _Message:
    """A message: each signal with its range, whether others act on it, and whether it has wall-clock times."""

    def __init__(self, ranges: tuple[_Range, ...], *, command: bool, wall_clock: bool) -> None:
        self.ranges = ranges
        self.command = command
        self.wall_clock = wall_clock


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
        self._messages: dict[str, dict[str, _Message]] = {bus: {} for bus in codecs}
        self._since: dict[tuple[str, str, str], int] = {}
        self._clipped: set[tuple[str, str, str]] = set()

    def are_numbers(self, sent: Outgoing, cycle: cython.longlong) -> cython.bint:
        """Return whether all values of a message are numbers; report where that changes, and what will be clipped.

        A message that does not exist is left to the one who sends it.
        """
        known: dict[str, _Message] | None = self._messages.get(sent.bus)
        message: _Message | None = None if known is None else known.get(sent.message)
        if message is None:
            message = self._message(sent)
        given = sent.values
        values: dict[str, Any] = given if type(given) is dict else dict(given)
        good = True
        value: cython.double
        signal: _Range
        for signal in message.ranges:
            number = values.get(signal.signal)
            if number is None:
                continue
            value = number
            if not signal.low <= value <= signal.high:
                good = self._is_number(sent, message, signal, value, cycle) and good
            elif self._since:
                self._recovers((sent.bus, sent.message, signal.signal), cycle)
        return good

    def _is_number(
        self, sent: Outgoing, message: _Message, signal: _Range, value: cython.double, cycle: cython.longlong
    ) -> cython.bint:
        """Return whether a value outside its signal's range is a number, and report it."""
        place = (sent.bus, sent.message, signal.signal)
        if not isfinite(value):
            self._fails(place, cycle, str(value), command=message.command)
            return False
        self._recovers(place, cycle)
        if not message.wall_clock:
            self._clips(place, cycle, value, signal.low if value < signal.low else signal.high)
        return True

    def _message(self, sent: Outgoing) -> _Message:
        codec = self._codecs.get(sent.bus)
        if codec is None or sent.message not in codec.names:
            return _Message((), command=False, wall_clock=False)
        ranges = tuple(_Range(*each) for each in codec.ranges(sent.message))
        wall_clock = codec.is_wall_clock(codec.can_id(sent.message))
        found = _Message(ranges, command=codec.data_id(sent.message) != 0, wall_clock=wall_clock)
        self._messages[sent.bus][sent.message] = found
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
