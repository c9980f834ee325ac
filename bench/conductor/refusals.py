"""The gate at the conductor's end of the buses: each received frame passes it once, and only whole ones are decoded.

Anybody can send anything on a bus. A frame that does not belong to the run is refused, counted and, the first of each
bus, identifier and reason, an event. It is also in the log, unless a bus brings more of them in a cycle than it could
carry. What is kept is bounded, whatever comes.
"""

from collections import Counter
from collections.abc import Callable, Mapping

from bench.bus.codec import Codec
from bench.bus.e2e import check
from bench.bus.frame import CanFrame
from bench.events import Event, FramesRefused, Refusal, StrayFrame

MOST_NAMED = 64
"""Number of identifiers of a bus that are told apart for each reason; the DBC files have fewer."""

MOST_LOGGED = 128
"""Number of refused frames of a bus that the log has for each cycle; at 500 kbit/s a bus carries at most 106."""

OTHERS = "others"


class Refusals:
    """Counts the frames that are refused, by bus, reason and identifier."""

    def __init__(self, codecs: Mapping[str, Codec]) -> None:
        """Begin with none."""
        self._forms = {
            bus: {codec.can_id(name): (codec.layout(name).length, codec.data_id(name)) for name in codec.names}
            for bus, codec in codecs.items()
        }
        self._counts: dict[str, dict[Refusal, Counter[int | None]]] = {bus: {} for bus in codecs}
        self._events: list[Event] = []
        self._logged = dict.fromkeys(codecs, 0)

    def flaw(self, bus: str, can_id: int, data: bytes) -> Refusal | None:
        """Return why a frame is not whole: identifier, length or CRC; None if it is."""
        form = self._forms[bus].get(can_id)
        if form is None:
            return Refusal.UNKNOWN
        length, data_id = form
        if len(data) != length:
            return Refusal.LENGTH
        return Refusal.DAMAGED if data_id and not check(data, data_id) else None

    def refuse(self, bus: str, frame: CanFrame, why: Refusal) -> bool:
        """Count a refused frame; return whether the log is to have it."""
        can_id, data = frame
        self._count(bus, can_id, why, len(data))
        self._logged[bus] += 1
        return self._logged[bus] <= MOST_LOGGED

    def without_data(self, bus: str) -> Callable[[Refusal, int | None], None]:
        """Return a function that counts what a link of this bus has received instead of data frames."""
        return lambda why, can_id: self._count(bus, can_id, why, None)

    def begin_cycle(self) -> None:
        """Let the log have refused frames of another cycle."""
        self._logged = dict.fromkeys(self._logged, 0)

    def news(self) -> list[Event]:
        """Return the events since the last call."""
        events, self._events = self._events, []
        return events

    @property
    def totals(self) -> list[FramesRefused]:
        """What was refused on each bus that had any, as the events at the end of a run."""
        return [
            FramesRefused(
                bus,
                {why.value: found.total() for why, found in reasons.items()},
                {
                    why.value: {_named(can_id): count for can_id, count in found.items()}
                    for why, found in reasons.items()
                },
            )
            for bus, reasons in self._counts.items()
            if reasons
        ]

    def _count(self, bus: str, can_id: int | None, why: Refusal, length: int | None) -> None:
        found = self._counts[bus].setdefault(why, Counter())
        if can_id not in found:
            if len(found) >= MOST_NAMED:
                can_id = None
            if can_id not in found:
                self._events.append(StrayFrame(bus, can_id, why.value, length))
        found[can_id] += 1


def _named(can_id: int | None) -> str:
    return OTHERS if can_id is None else f"0x{can_id:03X}"
