"""Runs an ECU on its buses: collects a cycle's inputs, steps, sends."""

import warnings
from collections.abc import Mapping, Sequence

from bench.bus.base import Link
from bench.bus.codec import Codec
from bench.bus.inbox import Inbox
from bench.bus.topic import CYCLE_MS, Outgoing, Topic
from bench.ecu.base import Ecu
from bench.errors import BadInput


class EcuNode:
    """An ECU as a node on its buses."""

    def __init__(
        self,
        name: str,
        ecu: Ecu,
        links: Mapping[str, Link],
        codecs: Mapping[str, Codec],
        diagnostics: Sequence[Topic] = (),
    ) -> None:
        """Put `ecu` on `links` (by bus name); in messages to a person it is `name`.

        Those of `diagnostics` that a step does not return go out with their start values, so that a small ECU need not
        send what drives nothing.

        Raises:
            BadInput: an input does not exist on these buses or has no alive counter.
        """
        self.name = name
        self._ecu = ecu
        self._links = dict(links)
        self._diagnostics = {
            (topic.bus, topic.message): Outgoing(topic.bus, topic.message, {}) for topic in diagnostics
        }
        self._codecs = codecs
        self._start_values: dict[tuple[str, str], dict[str, float]] = {}
        try:
            self._inbox = Inbox(links, codecs, ecu.inputs)
        except BadInput as error:
            raise BadInput(f"{name}: {error}") from None

    @property
    def links(self) -> tuple[Link, ...]:
        """The links this ECU listens on."""
        return tuple(self._links.values())

    @property
    def stopped(self) -> bool:
        """Whether the conductor has told this ECU to stop."""
        return self._inbox.stopped

    def poll(self) -> bool:
        """Take in what has arrived and step for each cycle that this completes; whether anything had arrived.

        Raises:
            BadInput: the ECU sends on a bus it is not on.
            EncodeError: the ECU sends a message that the bus's DBC does not have.
        """
        arrived = self._inbox.drain()
        while self._inbox.complete and not self._inbox.stopped:
            cycle = self._inbox.cycle
            inputs = self._inbox.take()
            not_numbers = self._not_numbers()
            owed = dict(self._diagnostics)
            for outgoing in self._ecu.step(cycle, cycle * CYCLE_MS / 1000, inputs, self._inbox.health):
                owed.pop((outgoing.bus, outgoing.message), None)
                self._send(outgoing, cycle)
            for outgoing in owed.values():
                self._send(outgoing, cycle)
            if self._not_numbers() > not_numbers:
                warnings.warn(f"{self.name}: in cycle {cycle} it sent NaN, replaced by start values", stacklevel=2)
        return arrived

    def _send(self, outgoing: Outgoing, cycle: int) -> None:
        bus = outgoing.bus
        if bus not in self._links:
            raise BadInput(f"{self.name} sends {outgoing.message} on bus {bus}; it is on {', '.join(self._links)}")
        start = self._start_values.get((bus, outgoing.message))
        if start is None:
            start = self._codecs[bus].start_values(outgoing.message)
            self._start_values[bus, outgoing.message] = start
        can_id, data = self._codecs[bus].encode(outgoing.message, {**start, **outgoing.values}, cycle)
        self._links[bus].send(can_id, data)

    def _not_numbers(self) -> int:
        return sum(self._codecs[bus].not_numbers for bus in self._links)
