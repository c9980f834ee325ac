"""What a DBC file says of its messages, as plain values that a file of text can hold."""

import json
from typing import Any, NamedTuple


class SignalDescription(NamedTuple):
    """A signal of a message.

    Attributes:
        name: its name.
        start_bit, length: its first bit and number of bits, in Intel byte order.
        is_signed, is_float: what its bits are: two's complement, or an IEEE 754 float of 32 bits.
        scale, offset: value = raw * scale + offset.
        low, high: its range.
        start: its start value.
        most_change_per_s: maximum rate of change, in its unit per second; 0 if absent.
        choices: its value table: numbers and their names.
        unit, comment: empty if absent.
    """

    name: str
    start_bit: int
    length: int
    is_signed: bool
    is_float: bool
    scale: float
    offset: float
    low: float
    high: float
    start: float
    most_change_per_s: float
    choices: tuple[tuple[int, str], ...]
    unit: str
    comment: str

    @property
    def texts(self) -> dict[int, str]:
        """The names in its value table."""
        return dict(self.choices)


class MessageDescription(NamedTuple):
    """A message of a bus.

    Attributes:
        name: its name.
        can_id: its identifier, without a mark of the extended ones.
        is_extended: whether the identifier has 29 bits.
        length: number of bytes of its frames.
        senders: its sending nodes.
        receivers: the nodes that receive at least one of its signals.
        cycle_time_ms: 0 if it has none.
        timeout_ms: time without a valid frame after which it is lost; 0 if absent.
        data_id: its E2E data identifier, 0 for an unprotected message.
        is_wall_clock: whether it holds wall-clock times.
        comment: empty if absent.
        signals: in the DBC's order.
    """

    name: str
    can_id: int
    is_extended: bool
    length: int
    senders: tuple[str, ...]
    receivers: tuple[str, ...]
    cycle_time_ms: float
    timeout_ms: float
    data_id: int
    is_wall_clock: bool
    comment: str
    signals: tuple[SignalDescription, ...]

    def signal(self, name: str) -> SignalDescription:
        """Return the signal of this name.

        Raises:
            KeyError: the message has none.
        """
        return {each.name: each for each in self.signals}[name]


class BusDescription(NamedTuple):
    """All that a DBC file says.

    Attributes:
        bit_rate: in bit/s; 0 if absent.
        messages: sorted by identifier.
    """

    bit_rate: int
    messages: tuple[MessageDescription, ...]


def as_json(bus: BusDescription) -> bytes:
    """Return the text of a description; `from_json` reads it."""
    return json.dumps(bus, separators=(",", ":")).encode("ascii")


def from_json(text: bytes) -> BusDescription:
    """Return the description that `as_json` has written as this text."""
    bit_rate, messages = json.loads(text)
    return BusDescription(bit_rate, tuple(map(_message, messages)))


def _message(values: list[Any]) -> MessageDescription:
    message = MessageDescription(*values)
    return message._replace(
        senders=tuple(message.senders),
        receivers=tuple(message.receivers),
        signals=tuple(_signal(each) for each in values[-1]),
    )


def _signal(values: list[Any]) -> SignalDescription:
    signal = SignalDescription(*values)
    return signal._replace(choices=tuple((number, text) for number, text in signal.choices))
