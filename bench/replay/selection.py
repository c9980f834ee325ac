"""Selects the frames of a log to send: of some buses only, or without those of one participant."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from bench.bus.codec import Codec
from bench.bus.network import process_of
from bench.errors import BadInput
from bench.record.reader import Run


@dataclass(frozen=True)
class Selection:
    """What goes out.

    Attributes:
        buses: the buses, in the order of the log.
        left_out: bus -> identifiers excluded there.
    """

    buses: tuple[str, ...]
    left_out: Mapping[str, frozenset[int]]

    @classmethod
    def of(cls, run: Run, only: Sequence[str] = (), without: Sequence[str] = ()) -> Selection:
        """Choose from a log.

        Args:
            run: the log.
            only: the buses; all where none is named.
            without: participants whose frames are excluded, so that real ones can send them: veh2.tracker, plant. The
                log's message metadata and attached DBC files tell which frames these are.

        Raises:
            BadInput: there is no such bus or participant, or no frame remains.
        """
        for bus in only:
            if bus not in run.buses:
                raise BadInput(f"--only {bus}: {run.path} has the buses {', '.join(run.buses) or '(none)'}")
        buses = tuple(bus for bus in run.buses if not only or bus in only)
        if not buses:
            raise BadInput(f"{run.path} holds no frames")
        sent = {bus: _sent_by(run, bus, run.codec(bus)) for bus in run.buses} if without else {}
        known = sorted({sender for senders in sent.values() for sender in senders})
        for name in without:
            if name not in known:
                raise BadInput(f"--without {name}: {run.path} tells of the senders {', '.join(known) or '(none)'}")
        left_out = {bus: _ids(senders[name] for name in without if name in senders) for bus, senders in sent.items()}
        return cls(buses, left_out)

    def has(self, bus: str, can_id: int) -> bool:
        """Return whether a frame of this identifier on this bus is sent."""
        return bus in self.buses and can_id not in self.left_out.get(bus, ())


def _ids(parts: Iterable[set[int]]) -> frozenset[int]:
    return frozenset(can_id for part in parts for can_id in part)


def _sent_by(run: Run, bus: str, attached: Codec | None) -> dict[str, set[int]]:
    """Return the identifiers that each participant sends on `bus`, of those that were recorded there."""
    found: dict[str, set[int]] = {}
    for message in run.messages(bus):
        nodes = run.log.channel(f"/signals/{bus}/{message}").metadata.get("sender", "")
        for node in filter(None, nodes.split(", ")):
            found.setdefault(process_of(bus, node), set()).add(run.can_id(bus, message))
    # A message of which no frame had the right length was not decoded.
    for described in map(attached.message, attached.names) if attached else ():
        for participant in (process_of(bus, node) for node in described.senders):
            if participant in found:
                found[participant].add(described.frame_id)
    return found
