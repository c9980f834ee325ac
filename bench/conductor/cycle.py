"""One cycle of a run: due frames, received frames, and the ECUs that keep the others waiting."""

import math
from collections.abc import Mapping, Sequence
from operator import itemgetter

import cython

from bench.bus.absence import BENCH_ABSENT, read_absence
from bench.bus.codec import Codec
from bench.bus.e2e import COUNTER_MODULUS, is_whole
from bench.bus.frame import BusFrame, CanFrame, RefusedFrame
from bench.bus.layout import Layout
from bench.bus.network import Transmission, transmissions
from bench.bus.sync import BENCH_SYNC
from bench.bus.topic import Topic
from bench.conductor.refusals import Refusals
from bench.events import Refusal
from bench.faults.plan import FaultPlan
from bench.names import CONDUCTOR

_new = tuple.__new__
_identifier = itemgetter(1)

Due = Mapping[str, Mapping[int, Transmission]]
"""The periodic frames of a run, by bus and identifier."""


def frames_due(codecs: Mapping[str, Codec], vehicles: int) -> dict[str, dict[int, Transmission]]:
    """Return the periodic messages of plant and ECUs by the DBC's cycle times, by bus and identifier."""
    return {
        bus: {
            each.can_id: each
            for each in transmissions(bus, codec, vehicles)
            if each.period and each.sender != CONDUCTOR
        }
        for bus, codec in codecs.items()
    }


class CycleFrames:
    """Collects the frames of each cycle in turn.

    Attributes:
        number: the cycle being collected.
        frames: the frames received, by bus; also refused ones.
        due: of these the ones that were due.
        spoiled: due frames received only with a wrong CRC so far, by bus and identifier.
    """

    def __init__(
        self, due: Due, codecs: Mapping[str, Codec], plan: FaultPlan | None = None, refusals: Refusals | None = None
    ) -> None:
        """Begin before the first cycle; `refusals` judges and counts the frames that are not due."""
        self._due = due
        self._codecs = codecs
        self._plan = plan or FaultPlan()
        self._refusals = refusals or Refusals(codecs)
        self._sync_id = {bus: codecs[bus].can_id(BENCH_SYNC) for bus in due}
        self._absent_id = {bus: codecs[bus].can_id(BENCH_ABSENT) for bus in due}
        self._layouts = {
            bus: {can_id: codecs[bus].layout(each.message) for can_id, each in every.items()}
            for bus, every in due.items()
        }
        # What is due repeats itself after so many cycles.
        self._repeats = math.lcm(*(each.period for every in due.values() for each in every.values()))
        self._due_in: dict[int, dict[str, dict[int, Transmission]]] = {}
        self._missing: dict[str, dict[int, Transmission]] = {}
        self._extra: dict[tuple[str, int], int] = {}
        self._count = 0
        self.number = -1
        self._counter = 0
        self.frames: dict[str, list[BusFrame]] = {bus: [] for bus in due}
        self.due: list[BusFrame] = []
        self.spoiled: set[tuple[str, int]] = set()
        # The buses with other frames than the due ones.
        self._others: set[str] = set()

    def begin(self, number: int) -> None:
        """Start to collect the cycle `number`."""
        self.number = number
        self._counter = number % COUNTER_MODULUS
        place = number % self._repeats
        if place not in self._due_in:
            self._due_in[place] = {
                bus: {can_id: each for can_id, each in due.items() if number % each.period == 0}
                for bus, due in self._due.items()
            }
        self._missing = {bus: due.copy() for bus, due in self._due_in[place].items()}
        self._count = sum(len(due) for due in self._missing.values())
        self._extra = self._extra_frames()
        self._count += sum(self._extra.values())
        self.frames = {bus: [] for bus in self._due}
        self.due = []
        self._others = set()
        self._refusals.begin_cycle()
        self.spoiled = set()

    def _extra_frames(self) -> dict[tuple[str, int], int]:
        """Number of frames that faults add to the due one."""
        if not self._plan.at(self.number):
            return {}
        extra = {
            (bus, can_id): self._plan.extra(bus, due.message, can_id, self.number)
            for bus, missing in self._missing.items()
            for can_id, due in missing.items()
        }
        return {key: count for key, count in extra.items() if count}

    @property
    def complete(self) -> bool:
        """Whether all due frames have arrived."""
        return self._count == 0

    @property
    def awaited(self) -> str | None:
        """The last of the buses on which frames are missing; None if none are."""
        return next((bus for bus in reversed(self._missing) if self._missing[bus]), None)

    def take(self, bus: str, frames: Sequence[CanFrame]) -> bool:
        """Take frames received on `bus`; return whether the cycle waited for any of them.

        Of several valid frames the first is the due one.
        """
        missing: dict[int, Transmission] = self._missing[bus]
        kept: list[BusFrame] = self.frames[bus]
        layouts: dict[int, Layout] = self._layouts[bus]
        taken, waited = len(self.due), False
        for frame in frames:
            can_id, data = frame
            is_missing = can_id in missing
            if is_missing and self._is_due(layouts[can_id], data):
                if self.spoiled:
                    self.spoiled.discard((bus, can_id))
                del missing[can_id]
                self._count -= 1
                due = _new(BusFrame, (bus, can_id, data))
                self.due.append(due)
                kept.append(due)
            else:
                waited |= self._take_other(bus, frame, is_missing)
        return waited or len(self.due) > taken

    def _is_due(self, layout: Layout, data: bytes) -> cython.bint:
        """Return whether this is the whole frame of the cycle."""
        if len(data) != layout.length:
            return False
        return not layout.data_id or (data[1] & 0x0F == self._counter and is_whole(data, layout.crc_of_id))

    def _take_other(self, bus: str, frame: CanFrame, is_missing: cython.bint) -> cython.bint:
        """Take a frame that is not the due one; return whether the cycle waited for it."""
        can_id, data = frame
        self._others.add(bus)
        why = self._refusals.flaw(bus, can_id, data)
        if why is None and self._waits_for(bus, can_id, data):
            self.frames[bus].append(BusFrame(bus, can_id, data))
            return True
        if why is Refusal.DAMAGED and is_missing:
            self.spoiled.add((bus, can_id))
        if why is None:
            # No other node sends BenchSync in virtual time.
            why = Refusal.IMPLAUSIBLE if can_id == self._sync_id[bus] else Refusal.NOT_DUE
        if self._refusals.refuse(bus, frame, why):
            self.frames[bus].append(RefusedFrame(bus, can_id, data))
        return False

    def _waits_for(self, bus: str, can_id: cython.longlong, data: bytes) -> cython.bint:
        """Return whether the cycle waits for this frame that no DBC file makes due, and take it."""
        if can_id == self._absent_id[bus]:
            absence = read_absence(self._codecs[bus].layout(BENCH_ABSENT), data)
            return absence is not None and absence.cycle == self.number and self.give_up(bus, absence.can_id)
        if self._extra.get((bus, can_id)):
            self._extra[bus, can_id] -= 1
            self._count -= 1
            return True
        return False

    def give_up(self, bus: str, can_id: int) -> bool:
        """Stop waiting for a frame of this cycle; return whether it was awaited."""
        self.spoiled.discard((bus, can_id))
        given_up = int(self._missing[bus].pop(can_id, None) is not None) + self._extra.pop((bus, can_id), 0)
        self._count -= given_up
        return given_up > 0

    @property
    def hopeless(self) -> list[tuple[str, int]]:
        """The spoiled frames whose senders have sent all else, so that no valid ones will follow."""
        others = {due.sender for due in self.missing() if (due.bus, due.can_id) not in self.spoiled}
        return sorted(each for each in self.spoiled if self._due[each[0]][each[1]].sender not in others)

    def ordered(self) -> list[BusFrame]:
        """Return the frames in the order of the log: by bus, then by identifier, whatever order they arrived in."""
        found: list[BusFrame] = []
        for bus, frames in self.frames.items():
            if bus in self._others:
                absent_id = self._absent_id[bus]
                # Several nodes announce absences; frames of any other identifier have one sender and keep its order.
                frames = sorted(frames, key=lambda frame: frame.data[2:] if frame.can_id == absent_id else b"")
            found += sorted(frames, key=_identifier)
        return found

    def missing(self) -> list[Transmission]:
        """The missing frames."""
        return [due for missing in self._missing.values() for due in missing.values()]

    def guilty(self, inputs: Mapping[str, Sequence[Topic]]) -> list[str]:
        """The ECUs that keep the cycle waiting: they have received all inputs but have not sent.

        Args:
            inputs: the inputs of each process, by its name.
        """
        missing = self.missing()
        not_come = {due.topic for due in missing}
        senders = list(dict.fromkeys(due.sender for due in missing))
        return [name for name in senders if not _waits(inputs.get(name, ()), not_come)] or senders

    def silent(self, guilty: Sequence[str]) -> str:
        """Return a message about the frames that the `guilty` have not sent."""
        missing = self.missing()
        return "; ".join(_silence(name, [due for due in missing if due.sender == name]) for name in guilty)


def _waits(inputs: Sequence[Topic], not_come: set[Topic]) -> bool:
    return any(topic in not_come and not topic.delay for topic in inputs)


def _silence(name: str, missing: Sequence[Transmission]) -> str:
    first = missing[0]
    more = f" and {len(missing) - 1} more" if len(missing) > 1 else ""
    return f"{name} sends no {first.message} (0x{first.can_id:03X} on {first.bus}){more}"
