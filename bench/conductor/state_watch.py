"""Detects changes of state and cause on the bus, and where a vehicle brakes hard or feels more than is comfortable."""

from collections.abc import Iterator, Mapping
from typing import NamedTuple

from bench.bus.codec import Codec, SignalBits
from bench.bus.network import process_of
from bench.bus.states import ActuatorState, Cause, EcuState
from bench.control.outcome import Limit
from bench.events import CauseChange, HardBraking, StateChange, Uncomfortable
from bench.names import ACTUATORS, PLANT

_STATES = {"PlannerStatus": "State", "TrackerStatus": "State", "ActuatorStatus": "ActuatorState"}
"""The messages with a state, and its signal."""

Change = StateChange | CauseChange | HardBraking | Uncomfortable

_TOLD: Mapping[Limit, type[HardBraking] | type[Uncomfortable]] = {
    Limit.HARD_BRAKING: HardBraking,
    Limit.COMFORT: Uncomfortable,
}
"""The limits of a planner that have an event when they begin and end."""

_CAUSE = "Cause"
_LIMIT = "Limit"
_NORMAL: Mapping[str, tuple[int, ...]] = {
    "State": (EcuState.INIT, EcuState.RUN),
    "ActuatorState": (ActuatorState.INIT, ActuatorState.ACTIVE),
}
"""The normal values of each of these signals, the initial one first."""


class _Field(NamedTuple):
    """A signal's bits in a message, and the names of its values."""

    bits: SignalBits
    names: Mapping[int, str]

    def value(self, number: int) -> int:
        """Return its value in a frame as one little-endian number."""
        return number >> self.bits.shift & self.bits.mask

    def name(self, value: int) -> str:
        """Return the name of a value."""
        return self.names.get(value, str(value))


class _Watched(NamedTuple):
    """A message with a state: source, length in bytes, bits of all these, state, an ECU's cause, a planner's limit."""

    source: str
    length: int
    mask: int
    state: _Field
    cause: _Field | None
    limit: _Field | None


class StateWatch:
    """Compares each frame with a state with the one before.

    Attributes:
        watched: bus and identifier of these frames.
    """

    def __init__(self, codecs: Mapping[str, Codec]) -> None:
        """Watch the states in these buses' DBC files."""
        self.watched: dict[tuple[str, int], _Watched] = {}
        for bus, codec in codecs.items():
            for name in _STATES.keys() & set(codec.names):
                self.watched[bus, codec.can_id(name)] = _watched(bus, name, codec)
        self._bits: dict[tuple[str, int], int] = {}
        self._last: dict[tuple[str, int], tuple[int, int]] = {}
        self._limits: dict[tuple[str, int], int] = {}

    def is_changed(self, bus: str, can_id: int, data: bytes) -> bool:
        """Return whether a frame of one of `watched` differs from the one before in what is watched."""
        place = self.watched.get((bus, can_id))
        if place is None or len(data) != place.length:
            return False
        return int.from_bytes(data, "little") & place.mask != self._bits.get((bus, can_id))

    def changes(self, bus: str, can_id: int, data: bytes) -> Iterator[Change]:
        """Yield what changes with a frame of one of `watched`; nothing if its length is wrong."""
        if not self.is_changed(bus, can_id, data):
            return
        place = self.watched[bus, can_id]
        number = self._bits[bus, can_id] = int.from_bytes(data, "little") & place.mask
        change = self._state_change(bus, can_id, number)
        if change is not None:
            yield change
        if place.limit is None:
            return
        limit = place.limit.value(number)
        before = self._limits.get((bus, can_id), Limit.NONE)
        self._limits[bus, can_id] = limit
        for value, event in _TOLD.items():
            if (limit == value) != (before == value):
                yield event("info", place.source, limit == value)

    def _state_change(self, bus: str, can_id: int, number: int) -> StateChange | CauseChange | None:
        place = self.watched[bus, can_id]
        state = place.state.value(number)
        cause = place.cause.value(number) if place.cause else Cause.NONE
        normal = _NORMAL[place.state.bits.signal]
        before, cause_before = self._last.get((bus, can_id), (normal[0], Cause.NONE))
        if (state, cause) == (before, cause_before):
            return None
        self._last[bus, can_id] = state, cause
        was, becomes = (place.state.name(value).lower() for value in (before, state))
        causes = [place.cause.name(value) if place.cause and value else "" for value in (cause, cause_before)]
        if state == before:
            level = "warning" if cause and state != normal[0] else "info"
            return CauseChange(level, place.source, becomes, *causes)
        level = "info" if state in normal else "warning"
        return StateChange(level, place.source, was, becomes, *causes)


def _watched(bus: str, name: str, codec: Codec) -> _Watched:
    message = codec.described(name)
    fields = {bits.signal: _Field(bits, message.signal(bits.signal).texts) for bits in codec.bits(name)}
    sender = process_of(bus, message.senders[0])
    source = f"{bus}.{ACTUATORS}" if sender == PLANT else sender
    state, cause, limit = fields[_STATES[name]], fields.get(_CAUSE), fields.get(_LIMIT)
    mask = sum(each.bits.mask << each.bits.shift for each in (state, cause, limit) if each)
    return _Watched(source, message.length, mask, state, cause, limit)
