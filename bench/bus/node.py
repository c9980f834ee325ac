"""What takes part on the buses: a node, and the loop that lets nodes of one process wait for frames."""

import gc
import selectors
from collections.abc import Sequence
from typing import Protocol

from bench.bus.base import Link
from bench.errors import RunFailed


class Node(Protocol):
    """A participant that does its work whenever its frames have come."""

    name: str

    @property
    def links(self) -> tuple[Link, ...]:
        """The links this node listens on."""

    @property
    def stopped(self) -> bool:
        """Whether the conductor has told this node to stop."""

    def poll(self) -> bool:
        """Take in what has arrived and step if that completes a cycle; whether anything had arrived."""


def serve(nodes: Sequence[Node], lifeline: int | None = None, silence_s: float | None = None) -> None:
    """Run `nodes` until all are stopped, blocking in the kernel while nothing arrives.

    Args:
        nodes: the nodes of this process.
        lifeline: file descriptor that becomes readable when the conductor is gone; ends the loop.
        silence_s: longest wall-clock time in s without a frame once the first has come; None for no limit.

    Raises:
        RunFailed: nothing was heard for `silence_s`.
    """
    with selectors.DefaultSelector() as selector:
        for node in nodes:
            for link in node.links:
                selector.register(link.fileno(), selectors.EVENT_READ, node)
        if lifeline is not None:
            selector.register(lifeline, selectors.EVENT_READ, None)
        # What there is now stays; no garbage collection need look at it in every cycle.
        gc.collect()
        gc.freeze()
        heard = False
        while not all(node.stopped for node in nodes):
            events = selector.select(silence_s if heard else None)
            if not events:
                names = ", ".join(node.name for node in nodes)
                raise RunFailed(f"{names} heard no frame for {silence_s:g} s; is the conductor still running?")
            heard = True
            for key, _ in events:
                if key.data is None:
                    return
                key.data.poll()
