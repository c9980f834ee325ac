"""Detects state changes of ECUs and actuators on the bus."""

from collections.abc import Mapping
from typing import NamedTuple

from bench.bus.codec import Codec, SignalBits
from bench.bus.network import process_of
from bench.bus.states import ActuatorState, EcuState
from bench.events import StateChange
from bench.names import PLANT

_STATES = {"PlannerStatus": "State", "TrackerStatus": "State", "ActuatorStatus": "ActuatorState"}
"""The messages with a state, and its signal."""

_CAUSE = "Cause"
_NORMAL: Mapping[str, tuple[int, ...]] = {
    "State": (EcuState.INIT, EcuState.RUN),
    "ActuatorState": (ActuatorState.INIT, ActuatorState.ACTIVE),
}
"""The normal values of each of these signals, the initial one first."""


class _Watched(NamedTuple):
    """The position of the state in a message, and the names of its values."""

    source: str
    state: SignalBits
    names: Mapping[int, str]
    causes: Mapping[int, str]


class StateWatch:
    """Compares each frame with a state with the one before.

    Attributes:
        watched: bus and identifier of these frames.
    """

    def __init__(self, codecs: Mapping[str, Codec]) -> None:
        """Watch the states in these buses' DBC files."""
        self._codecs = codecs
        self.watched: dict[tuple[str, int], _Watched] = {}
        for bus, codec in codecs.items():
            for name in _STATES.keys() & set(codec.names):
                self.watched[bus, codec.can_id(name)] = _watched(bus, name, codec)
        self._last: dict[tuple[str, int], int] = {}

    def change(self, bus: str, can_id: int, data: bytes) -> StateChange | None:
        """Return the state change in a frame, None if there is none."""
        place = self.watched[bus, can_id]
        if 8 * len(data) <= place.state.shift:
            return None
        state = int.from_bytes(data, "little") >> place.state.shift & place.state.mask
        before = self._last.get((bus, can_id), _NORMAL[place.state.signal][0])
        if state == before:
            return None
        self._last[bus, can_id] = state
        was, becomes = (place.names.get(value, str(value)).lower() for value in (before, state))
        cause = int(self._codecs[bus].decode(can_id, data)[1].get(_CAUSE, 0))
        level = "info" if state in _NORMAL[place.state.signal] else "warning"
        return StateChange(level, place.source, was, becomes, place.causes.get(cause, "") if cause else "")


def _watched(bus: str, name: str, codec: Codec) -> _Watched:
    message = codec.message(name)
    signals = {signal.name: signal for signal in message.signals}
    (state,) = (bits for bits in codec.bits(name) if bits.signal == _STATES[name])
    sender = process_of(bus, message.senders[0])
    source = f"{bus}.actuators" if sender == PLANT else sender
    causes = signals[_CAUSE].choices if _CAUSE in signals else None
    return _Watched(source, state, _texts(signals[state.signal].choices), _texts(causes))


def _texts(choices: Mapping[int, object] | None) -> dict[int, str]:
    return {int(value): str(text) for value, text in (choices or {}).items()}
