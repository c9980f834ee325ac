"""The crew of a run in one process: the same nodes, polled in turn."""

from collections.abc import Callable, Mapping

from bench.bus.link.base import Link
from bench.bus.node import Node
from bench.bus.topic import Topic
from bench.conductor.crew import Ended, Listener
from bench.conductor.interrupts import Interrupts
from bench.conductor.patience import Say
from bench.errors import BenchError, EcuError

Inputs = tuple[Topic, ...]
Maker = Callable[[str], tuple[Node, Inputs]]
"""Creates a node by its name, and returns its inputs."""


class DirectCrew:
    """Nodes that live in the conductor's process."""

    def __init__(
        self,
        plant: list[Node],
        ecus: list[str],
        make: Maker,
        links: Mapping[str, Link],
        listener: Listener,
        interrupts: Interrupts,
    ) -> None:
        """Create the nodes of the ECUs; nodes are polled in the order given.

        Args:
            plant: the plant's nodes.
            ecus: names of the ECUs.
            make: creates an ECU's node, again after a crash.
            links: the conductor's links, whose frames are passed to `listener`.
            listener: receives frames, truth rows and output.
            interrupts: signals that end the waiting.
        """
        self._plant = plant
        self._make = make
        self._inputs: dict[str, Inputs] = {}
        self._ecus: dict[str, Node | None] = dict.fromkeys(ecus)
        self._paused: set[str] = set()
        for name in ecus:
            self.restart(name)
        self._links = links
        self._listener = listener
        self._interrupts = interrupts

    @property
    def inputs(self) -> Mapping[str, Inputs]:
        """See `Crew`."""
        return self._inputs

    @property
    def pids(self) -> Mapping[str, int]:
        """See `Crew`."""
        return {}

    def wait_ready(self, timeout_s: float, say: Say | None = None) -> None:  # noqa: ARG002 - nodes in this process are ready at once
        """See `Crew`."""
        self._interrupts.check()

    def attend(self, timeout_s: float) -> bool:  # noqa: ARG002 - a silent node stays silent
        """See `Crew`."""
        self._interrupts.check()
        progress = False
        for node in self._plant:
            progress |= self._poll(node)
        for name, ecu in self._ecus.items():
            if ecu is not None and name not in self._paused:
                progress |= self._poll(ecu)
        for bus, link in self._links.items():
            frames = link.receive()
            if frames:
                progress = True
                self._listener.frames(bus, frames)
        return progress

    def kill(self, name: str) -> None:
        """See `Crew`."""
        node = self._ecus[name]
        for link in node.links if node else ():
            link.close()
        self._ecus[name] = None
        self._paused.discard(name)

    def restart(self, name: str) -> None:
        """See `Crew`."""
        self._ecus[name], self._inputs[name] = self._make(name)

    def pause(self, name: str) -> None:
        """See `Crew`."""
        self._paused.add(name)

    def resume(self, name: str) -> None:
        """See `Crew`."""
        self._paused.discard(name)

    def excuse(self, name: str) -> None:
        """See `Crew`."""
        self.kill(name)

    def stop(self, grace_s: float) -> list[str]:  # noqa: ARG002 - nothing runs between polls
        """See `Crew`."""
        return []

    def _poll(self, node: Node) -> bool:
        try:
            return node.poll()
        except EcuError as error:
            raise Ended(str(error), [node.name]) from error
        except BenchError:
            raise
        except Exception as error:
            raise Ended(f"{node.name} failed: {type(error).__name__}: {error}", [node.name]) from error
