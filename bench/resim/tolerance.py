"""The allowed difference of a signal from the log: none by default."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from bench.bus.codec import Codec
from bench.bus.e2e import COUNTER_SIGNAL, CRC_SIGNAL
from bench.errors import BadInput

_FLOAT_STEP = 2.0**-23
"""Relative difference of two 32-bit floats next to each other."""


@dataclass(frozen=True)
class Tolerance:
    """The allowed difference of two frames of one message.

    Attributes:
        steps: allowed difference of any signal, in steps of its resolution (its scale in the DBC; of a float, that of
            its size). States and counters must be equal.
        signals: by message and signal the allowed difference in the signal's unit, which takes precedence over `steps`.
    """

    steps: float = 0.0
    signals: Mapping[tuple[str, str], float] = field(default_factory=dict)

    @property
    def exact(self) -> bool:
        """Whether no difference is allowed."""
        return not self.steps and not self.signals

    def allows(self, codec: Codec, message: str, signal: str, a: float, b: float) -> bool:
        """Return whether two values of a signal are close enough."""
        if a == b or (a != a and b != b):
            return True
        if self.exact:
            return False
        if signal == CRC_SIGNAL:
            # It follows from the rest of the frame, so it may differ if that may.
            return True
        if _must_be_equal(codec, message, signal):
            return False
        given = self.signals.get((message, signal))
        if given is not None:
            return abs(a - b) <= given
        known = codec.message(message).get_signal_by_name(signal)
        step = _FLOAT_STEP * max(abs(a), abs(b)) if known.is_float else abs(float(known.scale))
        # Half a step more would be the next whole number of them.
        return abs(a - b) <= (self.steps + 1e-6) * step


def parse(texts: Sequence[str], messages: Mapping[str, Codec]) -> Tolerance:
    """Return the tolerance that was typed: STEPS for all signals, or MESSAGE.SIGNAL=VALUE.

    Args:
        texts: as given by the user.
        messages: the messages that may be named, each with its bus's codec.

    Raises:
        BadInput: no such message or signal, one that must be equal, or no number from 0.
    """
    steps, signals = 0.0, {}
    for text in texts:
        place, equals, value = text.rpartition("=")
        try:
            number = float(value)
        except ValueError:
            number = -1.0
        if not 0.0 <= number < float("inf"):
            raise BadInput(f"--tolerance {text}: give a number from 0 on, or MESSAGE.SIGNAL=NUMBER")
        if equals:
            signals[_signal(text, place, messages)] = number
        else:
            steps = number
    return Tolerance(steps, signals)


def _must_be_equal(codec: Codec, message: str, signal: str) -> bool:
    """Whether a signal must be equal: a state, or an E2E counter or CRC."""
    return bool(codec.message(message).get_signal_by_name(signal).choices) or signal in (COUNTER_SIGNAL, CRC_SIGNAL)


def _signal(text: str, place: str, messages: Mapping[str, Codec]) -> tuple[str, str]:
    message, _, signal = place.partition(".")
    if message not in messages:
        raise BadInput(f"--tolerance {text}: these ECUs send no {message!r}, but {', '.join(messages)}")
    known = [each.name for each in messages[message].message(message).signals]
    if signal not in known:
        signals = [each for each in known if not _must_be_equal(messages[message], message, each)]
        raise BadInput(f"--tolerance {text}: {message} has no signal {signal!r}; it has {', '.join(signals)}")
    if _must_be_equal(messages[message], message, signal):
        raise BadInput(
            f"--tolerance {text}: {signal} must be the same, as it is a state (has a value table), alive counter or "
            "CRC; a tolerance applies to measured or calculated signals"
        )
    return message, signal
