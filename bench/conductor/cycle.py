"""One cycle of a run: due frames, received frames, and the ECUs that keep the others waiting."""

from collections.abc import Iterator, Mapping, Sequence

from bench.bus.codec import Codec
from bench.bus.e2e import COUNTER_MODULUS, check
from bench.bus.frame import BusFrame, CanFrame
from bench.bus.network import Transmission, transmissions
from bench.bus.outbox import BENCH_ABSENT
from bench.bus.topic import Topic
from bench.faults.plan import FaultPlan
from bench.names import CONDUCTOR

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
        frames: the frames received, by bus.
        strays: unexpected or duplicate frames since `begin`.
        spoiled: due frames received only with a wrong CRC so far, by bus and identifier.
    """

    def __init__(self, due: Due, codecs: Mapping[str, Codec], plan: FaultPlan | None = None) -> None:
        """Begin before the first cycle."""
        self._due = due
        self._codecs = codecs
        self._plan = plan or FaultPlan()
        self._absent_id = {bus: codecs[bus].can_id(BENCH_ABSENT) for bus in due}
        self._data_ids = {
            (bus, can_id): codecs[bus].data_id(each.message)
            for bus, every in due.items()
            for can_id, each in every.items()
        }
        self._missing: dict[str, dict[int, Transmission]] = {}
        self._extra: dict[tuple[str, int], int] = {}
        self._count = 0
        self.number = -1
        self._counter = 0
        self.frames: dict[str, list[CanFrame]] = {bus: [] for bus in due}
        self.strays: list[tuple[str, int]] = []
        self.spoiled: set[tuple[str, int]] = set()

    def begin(self, number: int) -> None:
        """Start to collect the cycle `number`."""
        self.number = number
        self._counter = number % COUNTER_MODULUS
        self._missing = {
            bus: {can_id: each for can_id, each in due.items() if number % each.period == 0}
            for bus, due in self._due.items()
        }
        self._count = sum(len(due) for due in self._missing.values())
        self._extra = self._extra_frames()
        self._count += sum(self._extra.values())
        self.frames = {bus: [] for bus in self._due}
        self.strays = []
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

    def take(self, bus: str, frames: Sequence[CanFrame]) -> None:
        """Add frames received on `bus`."""
        self.frames[bus].extend(frames)
        missing, absent_id = self._missing[bus], self._absent_id[bus]
        for can_id, data in frames:
            due = missing.get(can_id)
            if due is None:
                if can_id == absent_id:
                    self._take_absence(bus, data)
                elif self._extra.get((bus, can_id)):
                    self._extra[bus, can_id] -= 1
                    self._count -= 1
                else:
                    self.strays.append((bus, can_id))
            elif due.protected and data[1:2] and data[1] & 0x0F != self._counter:
                self.strays.append((bus, can_id))
            elif due.protected and not check(data, self._data_ids[bus, can_id]):
                self.spoiled.add((bus, can_id))
            else:
                self.spoiled.discard((bus, can_id))
                del missing[can_id]
                self._count -= 1

    def _take_absence(self, bus: str, data: bytes) -> None:
        """Stop waiting for a frame if this announces its absence."""
        codec = self._codecs[bus]
        if len(data) != 8 or not check(data, codec.data_id(BENCH_ABSENT)):
            return
        values = codec.decode(self._absent_id[bus], data)[1]
        if values["Cycle"] == self.number:
            self.give_up(bus, int(values["Identifier"]))

    def give_up(self, bus: str, can_id: int) -> None:
        """Stop waiting for a frame of this cycle."""
        self.spoiled.discard((bus, can_id))
        if self._missing[bus].pop(can_id, None) is not None:
            self._count -= 1
        self._count -= self._extra.pop((bus, can_id), 0)

    def ordered(self) -> Iterator[BusFrame]:
        """Return the frames in the order of the log: by bus, then by identifier, whatever order they arrived in."""
        for bus, frames in self.frames.items():
            absent_id = self._absent_id[bus]
            # Several nodes announce absences; frames of any other identifier have one sender and keep its order.
            for can_id, data in sorted(
                frames, key=lambda frame: (frame.can_id, frame.data[2:] if frame.can_id == absent_id else b"")
            ):
                yield BusFrame(bus, can_id, data)

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
