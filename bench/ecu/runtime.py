"""Runs an ECU on its buses: collects a cycle's inputs, steps, sends."""

import time
import warnings
from collections.abc import Callable, Mapping, Sequence

import cython

from bench.bus.codec import Codec
from bench.bus.inbox import Inbox
from bench.bus.link.base import Link
from bench.bus.node import REST_S
from bench.bus.outbox import Outbox
from bench.bus.topic import Topic
from bench.cycle import time_of
from bench.ecu.base import Ecu
from bench.ecu.sent_values import Note, SentValues
from bench.errors import BadInput
from bench.events import EcuNote
from bench.faults.plan import FaultPlan

INPUT_WAIT_S = 0.005
"""In real time, default of `input_wait_s`: time in s after BenchSync for which an ECU waits for its inputs."""


class _Due:
    """A message that an ECU sends by the DBC.

    Attributes:
        topic: bus and name.
        can_id: its identifier.
        period: period in cycles.
        protected: whether it is protected.
        asked: the newest cycle in which the ECU returned it; -1 before the first.
        sent: the newest cycle in which it was also sent.
        reported: whether it has been reported that the ECU does not send it.
    """

    def __init__(self, topic: Topic, codec: Codec) -> None:
        """Describe it as its bus's DBC has it."""
        self.topic = topic
        self.can_id = codec.can_id(topic.message)
        self.period = codec.period(topic.message)
        self.protected = codec.is_protected(self.can_id)
        self.asked = -1
        self.sent = -1
        self.reported = False


class EcuNode:
    """An ECU as a node on its buses.

    Attributes:
        name: name in messages to people.
        input_wait_s: in real time, how long after BenchSync it waits for its inputs (s).
    """

    def __init__(
        self,
        name: str,
        ecu: Ecu,
        links: Mapping[str, Link],
        codecs: Mapping[str, Codec],
        sends: Sequence[Topic] = (),
        plan: FaultPlan | None = None,
        clock: Callable[[], float] = time.monotonic,
        note: Note | None = None,
    ) -> None:
        """Connect `ecu` to `links` (by bus name).

        Args:
            name: name in messages to people.
            ecu: the controller.
            links: its links to its buses.
            codecs: codec of every bus.
            sends: messages it sends according to the DBC. What a step does not return is not sent; in lockstep it is
                announced as absent when it is due. An ECU may leave out diagnostics, but receivers miss protected ones.
            plan: the faults of the run.
            clock: time (s) for the wait for inputs.
            note: takes what is wrong with the values that the ECU sends; if not given, they are Python warnings.

        Raises:
            BadInput: an input does not exist on these buses or has no alive counter.
        """
        self.name = name
        self._ecu = ecu
        self._links = dict(links)
        self._due = [_Due(topic, codecs[topic.bus]) for topic in sends]
        self._due_by_name: dict[str, dict[str, _Due]] = {topic.bus: {} for topic in sends}
        due: _Due
        for due in self._due:
            self._due_by_name[due.topic.bus][due.topic.message] = due
        self._codecs = codecs
        self.input_wait_s = float(getattr(ecu, "input_wait_s", INPUT_WAIT_S))
        self._clock = clock
        plan = plan or FaultPlan()
        try:
            self._inbox = Inbox(links, codecs, ecu.inputs, name=name, own=sends, plan=plan, clock=clock)
        except BadInput as error:
            raise BadInput(f"{name}: {error}") from None
        self._outbox = Outbox(name, links, codecs, plan)
        self._sent_values = SentValues(name, {bus: codecs[bus] for bus in links}, note or _warn)

    @property
    def links(self) -> tuple[Link, ...]:
        """The links this ECU listens on."""
        return tuple(self._links.values())

    @property
    def begun(self) -> bool:
        """Whether a BenchSync has arrived that begins or continues a run for certain."""
        return self._inbox.settled or self._inbox.stopped

    @property
    def opened(self) -> int:
        """The newest cycle that the conductor has opened; -1 before the first."""
        return self._inbox.opened

    @property
    def stopped(self) -> bool:
        """Whether the conductor has told this ECU to stop."""
        return self._inbox.stopped

    @property
    def wake_at(self) -> float | None:
        """When to poll again even if nothing arrives (time.monotonic, s); None for never."""
        inbox = self._inbox
        if not inbox.realtime or not inbox.settled or inbox.cycle > inbox.opened:
            return None
        return inbox.opened_at + self.input_wait_s

    @property
    def rest_until(self) -> float:
        """In real time, when to poll again after a step: until then an ECU only waits for the next BenchSync."""
        inbox = self._inbox
        return inbox.opened_at + REST_S if inbox.realtime and inbox.cycle > inbox.opened else 0.0

    @property
    def awaited(self) -> Link | None:
        """See `bench.bus.node.Node`."""
        return self._inbox.awaited

    def poll(self) -> bool:
        """Receive frames, step for each completed cycle, and return whether anything had arrived.

        In real time, a step also runs when the wait for its inputs has timed out, and past cycles are skipped.

        Raises:
            BadInput: the ECU sends on a bus to which it is not connected.
            EncodeError: the ECU sends a message that is not in the DBC of the bus.
        """
        inbox = self._inbox
        arrived = inbox.drain()
        while not inbox.stopped:
            inbox.catch_up()
            if inbox.excused:
                inbox.skip()
            elif inbox.complete or self._waited():
                self._step()
            else:
                break
        return arrived

    def _waited(self) -> bool:
        wake_at = self.wake_at
        return wake_at is not None and self._clock() >= wake_at

    def _step(self) -> None:
        inbox, outbox, sent_values, due_by_name = self._inbox, self._outbox, self._sent_values, self._due_by_name
        cycle, lockstep = inbox.cycle, not inbox.realtime
        inputs = inbox.take()
        for each in self._ecu.step(cycle, time_of(cycle), inputs, inbox.health):
            by_name: dict[str, _Due] | None = due_by_name.get(each.bus)
            due: _Due | None = None if by_name is None else by_name.get(each.message)
            if due is not None:
                due.asked = cycle
            if sent_values.are_numbers(each, cycle):
                outbox.put(each.bus, each.message, each.values)
                if due is not None:
                    due.sent = cycle
        outbox.send(cycle, lockstep=lockstep)
        self._announce_absent(cycle, lockstep)

    def _announce_absent(self, cycle: cython.longlong, lockstep: bool) -> None:
        """Report the due messages that were not sent, and warn of those that the ECU did not even return."""
        due: _Due
        for due in self._due:
            if due.sent == cycle or cycle % due.period:
                continue
            if lockstep:
                # The others would wait for it.
                self._outbox.absent(due.topic.bus, due.can_id, cycle)
            if due.protected and due.asked != cycle and not due.reported:
                due.reported = True
                warnings.warn(f"{self.name}: in cycle {cycle} it does not send {due.topic.message}", stacklevel=2)

    @property
    def not_numbers(self) -> int:
        """Number of values that the ECU has sent and that are not numbers; their messages were not sent."""
        return self._sent_values.not_numbers


def _warn(note: EcuNote) -> None:
    warnings.warn(f"{note.source}: in cycle {note.cycle} {note.text}", stacklevel=2)
