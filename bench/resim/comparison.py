"""Compares what an ECU sends with what the log recorded: first bytes, then signals."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import zip_longest

from bench.bus.codec import DecodeError
from bench.bus.e2e import CRC_SIGNAL
from bench.bus.frame import BusFrame
from bench.bus.topic import Signals, Topic
from bench.cycle import time_of
from bench.record.compare import SignalDifference
from bench.resim.recording import EcuLog
from bench.resim.rerun import Step
from bench.resim.tolerance import Tolerance


@dataclass(frozen=True)
class Pair:
    """A recorded frame and the corresponding one sent now; None if missing.

    Attributes:
        rank: number of earlier frames of this identifier in the cycle.
    """

    bus: str
    can_id: int
    rank: int
    logged: bytes | None
    sent: bytes | None


@dataclass(frozen=True)
class First:
    """The first difference, and the inputs of that step.

    Attributes:
        cycle: in which it occurs.
        pair: the frames.
        inputs: inputs of the ECU's step in this cycle, None for a missing one; None if it did no step.
    """

    cycle: int
    pair: Pair
    inputs: Mapping[Topic, Signals | None] | None


@dataclass
class _Signal:
    """How a signal differs so far."""

    first: int
    count: int = 0
    largest: float = 0.0


@dataclass
class Comparison:
    """Compares cycle after cycle.

    Attributes:
        log: the ECU's recorded inputs and outputs.
        tolerance: allowed difference of frames.
        frames: number of recorded frames compared.
        cycles: how many cycles.
        waited: number of cycles in which the ECU sent something then but did no step now.
        differing: frames whose bytes differ, or that only one side has.
        beyond: those of them that differ by more than the tolerance.
        first: the first of those.
        changes: all that differ, by cycle.
    """

    log: EcuLog
    tolerance: Tolerance
    frames: int = 0
    cycles: int = 0
    waited: int = 0
    differing: int = 0
    beyond: int = 0
    first: First | None = None
    changes: dict[int, list[Pair]] = field(default_factory=dict)
    _signals: dict[tuple[str, str, str], _Signal] = field(default_factory=dict)
    _alone: dict[tuple[str, str, bool], _Signal] = field(default_factory=dict)

    def add(self, step: Step, inputs: Mapping[Topic, Signals | None] | None) -> None:
        """Compare a cycle.

        Args:
            step: its frames.
            inputs: the ECU's inputs; None if it did no step.
        """
        self.cycles += 1
        self.waited += bool(step.logged) and inputs is None
        pairs = self._pairs(step.logged, step.sent)
        self.frames += sum(pair.logged is not None for pair in pairs)
        different = [pair for pair in pairs if pair.logged != pair.sent]
        if not different:
            return
        self.differing += len(different)
        self.changes[step.cycle] = different
        for pair in different:
            if self._note(step.cycle, pair):
                self.beyond += 1
                if self.first is None:
                    self.first = First(step.cycle, pair, inputs)

    @property
    def signals(self) -> tuple[SignalDifference, ...]:
        """The signals that differ, in the order of when they begin to; within the tolerance or not."""
        found = [
            SignalDifference(bus, message, signal, _seconds(each.first), each.count, each.largest, self._unit(*key))
            for key, each in self._signals.items()
            for bus, message, signal in [key]
        ]
        return tuple(sorted(found, key=lambda each: each.first_s))

    @property
    def alone(self) -> tuple[str, ...]:
        """Frames that only one side has, in words, by message."""
        return tuple(
            f"{bus} {message}: from {_seconds(each.first):.3f} s, {_frames(each.count, logged=logged)}"
            for (bus, message, logged), each in self._alone.items()
        )

    def name(self, bus: str, can_id: int) -> str:
        """Return the name of a message, its identifier where the DBC does not have it."""
        return self.log.codecs[bus].name_of(can_id) or f"0x{can_id:03X}"

    def decoded(self, bus: str, can_id: int, data: bytes) -> dict[str, float]:
        """Return the signals of a frame; none if it does not match the DBC."""
        try:
            return self.log.codecs[bus].decode(can_id, data)[1]
        except DecodeError:
            return {}

    def _pairs(self, logged: Sequence[BusFrame], sent: Sequence[BusFrame]) -> list[Pair]:
        sides = [self._by_identifier(frames) for frames in (logged, sent)]
        return [
            Pair(bus, can_id, rank, a, b)
            for bus, can_id, about in dict.fromkeys([*sides[0], *sides[1]])
            for rank, (a, b) in enumerate(zip_longest(*(side.get((bus, can_id, about), []) for side in sides)))
        ]

    def _by_identifier(self, frames: Sequence[BusFrame]) -> dict[tuple[str, int, int], list[bytes]]:
        """Sort frames by bus, identifier and, of announcements, the identifier that they announce as absent."""
        found: dict[tuple[str, int, int], list[bytes]] = {}
        for frame in frames:
            bus, can_id, data = frame
            if not self.log.codecs[bus].is_wall_clock(can_id):
                about = self.log.absent(frame)
                found.setdefault((bus, can_id, -1 if about is None else about), []).append(data)
        return found

    def _note(self, cycle: int, pair: Pair) -> bool:
        """Note how a pair differs; return whether it exceeds the tolerance."""
        codec, message = self.log.codecs[pair.bus], self.name(pair.bus, pair.can_id)
        if pair.logged is None or pair.sent is None:
            each = self._alone.setdefault((pair.bus, message, pair.sent is None), _Signal(cycle))
            each.count += 1
            return True
        a, b = (self.decoded(pair.bus, pair.can_id, data) for data in (pair.logged, pair.sent))
        if not a or not b:
            return True
        different = [signal for signal in a if a[signal] != b[signal] and signal != CRC_SIGNAL]
        # Otherwise the difference is in unused bits, or in a CRC that does not match the rest.
        beyond = self.tolerance.exact or not different
        for signal in different:
            each = self._signals.setdefault((pair.bus, message, signal), _Signal(cycle))
            each.count += 1
            each.largest = max(each.largest, abs(a[signal] - b[signal]))
            beyond |= not self.tolerance.allows(codec, message, signal, a[signal], b[signal])
        return beyond

    def _unit(self, bus: str, message: str, signal: str) -> str:
        known = self.log.codecs[bus].message(message).signals
        return next((each.unit or "" for each in known if each.name == signal), "")


def _frames(count: int, *, logged: bool) -> str:
    frames, verb = ("frame", "is") if count == 1 else ("frames", "are")
    told = f"of the log {verb} not sent" if logged else f"{verb} sent that the log does not have"
    return f"{count} {frames} {told}"


def _seconds(cycle: int) -> float:
    return time_of(cycle)
