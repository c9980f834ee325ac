"""Runs an ECU on its buses: collects a cycle's inputs, steps, sends."""

from collections.abc import Mapping

from bench.bus.base import Link
from bench.bus.codec import Codec
from bench.bus.inbox import Inbox
from bench.bus.topic import CYCLE_MS
from bench.ecu.base import Ecu
from bench.errors import BadInput


class EcuNode:
    """An ECU as a node on its buses."""

    def __init__(self, name: str, ecu: Ecu, links: Mapping[str, Link], codecs: Mapping[str, Codec]) -> None:
        """Put `ecu` on `links` (by bus name); in messages to a person it is `name`.

        Raises:
            BadInput: an input does not exist on these buses or has no alive counter.
        """
        self.name = name
        self._ecu = ecu
        self._links = dict(links)
        self._codecs = codecs
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
            BadInput: the ECU sends on a bus it is not on, or a message that its DBC does not have.
        """
        arrived = self._inbox.drain()
        while self._inbox.complete and not self._inbox.stopped:
            cycle = self._inbox.cycle
            inputs = self._inbox.take()
            for outgoing in self._ecu.step(cycle, cycle * CYCLE_MS / 1000, inputs, self._inbox.health):
                if outgoing.bus not in self._links:
                    raise BadInput(f"{self.name} sends {outgoing.message} on bus {outgoing.bus}, which it is not on")
                can_id, data = self._codecs[outgoing.bus].encode(outgoing.message, outgoing.values, cycle)
                self._links[outgoing.bus].send(can_id, data)
        return arrived
