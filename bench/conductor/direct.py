"""The crew of a run in one process: the same nodes, polled in turn."""

from collections.abc import Mapping, Sequence

from bench.bus.base import Link
from bench.bus.node import Node
from bench.bus.topic import Topic
from bench.conductor.crew import Ended, Listener
from bench.conductor.interrupts import Interrupts
from bench.errors import BenchError


class DirectCrew:
    """Nodes that live in the conductor's process."""

    def __init__(
        self,
        nodes: Sequence[Node],
        inputs: Mapping[str, Sequence[Topic]],
        links: Mapping[str, Link],
        listener: Listener,
        interrupts: Interrupts,
    ) -> None:
        """Take the nodes, in the order they are polled in.

        Args:
            nodes: plant and ECUs.
            inputs: what each of them takes, by its name.
            links: the conductor's links, whose frames go to `listener`.
            listener: takes what comes.
            interrupts: ends the waiting.
        """
        self._inputs = inputs
        self._nodes = nodes
        self._links = links
        self._listener = listener
        self._interrupts = interrupts

    @property
    def inputs(self) -> Mapping[str, Sequence[Topic]]:
        """See `Crew`."""
        return self._inputs

    def wait_ready(self, timeout_s: float) -> None:  # noqa: ARG002 - nodes in this process are ready at once
        """See `Crew`."""
        self._interrupts.check()

    def attend(self, timeout_s: float) -> bool:  # noqa: ARG002 - whoever is silent here stays so
        """See `Crew`."""
        self._interrupts.check()
        progress = False
        for node in self._nodes:
            progress |= self._poll(node)
        for bus, link in self._links.items():
            frames = link.receive()
            if frames:
                progress = True
                self._listener.frames(bus, frames)
        return progress

    def stop(self, grace_s: float) -> list[str]:  # noqa: ARG002 - nothing runs between polls
        """See `Crew`."""
        return []

    def _poll(self, node: Node) -> bool:
        try:
            return node.poll()
        except BenchError:
            raise
        except Exception as error:
            raise Ended(f"{node.name} failed: {type(error).__name__}: {error}") from error
