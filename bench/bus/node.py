"""A node on the buses, and the loop in which the nodes of one process wait for frames."""

import gc
import math
import select
import time
from collections.abc import Iterable, Sequence
from typing import Protocol

from bench.bus.link.base import Link
from bench.errors import RunFailed

REST_S = 0.0095
"""Time after a BenchSync for which a node that has finished its cycle may sleep."""

LOOK_S = 0.02
"""Longest wall-clock time in s to wait for one link alone: a stranger's flood on another must not fill its queue."""

READ_UP_S = 1.0
"""Longest wall-clock time in s for which a node reads what came before it is ready."""


class Node(Protocol):
    """A participant that steps as soon as its frames have arrived."""

    name: str

    @property
    def links(self) -> tuple[Link, ...]:
        """The links this node listens on."""

    @property
    def opened(self) -> int:
        """The newest cycle that the conductor has opened; -1 before the first."""

    @property
    def stopped(self) -> bool:
        """Whether the conductor has told this node to stop."""

    @property
    def wake_at(self) -> float | None:
        """When to poll again even without frames (time.monotonic, s); None for never."""

    @property
    def rest_until(self) -> float:
        """Until when the node can ignore arriving frames (time.monotonic, s); past or 0 if it cannot.

        Being woken by each frame of other nodes, only to ignore it, would cost more than its work.
        """

    @property
    def awaited(self) -> Link | None:
        """The link without whose frames the node has nothing to do; None if frames on any of its links matter."""

    def poll(self) -> bool:
        """Read all frames that have arrived, step if a cycle is complete; return whether there were any."""


def serve(nodes: Sequence[Node], lifeline: int | None = None, silence_s: float | None = None) -> None:
    """Run `nodes` until all are stopped, blocking in the kernel while nothing arrives.

    Args:
        nodes: the nodes of this process.
        lifeline: file descriptor that becomes readable when the conductor ends; ends the loop.
        silence_s: longest wall-clock time in s without a new cycle once the first has begun, whatever else is on the
            buses; None for no limit.

    Raises:
        RunFailed: no cycle began for `silence_s`.
    """
    pollers: dict[Link | None, select.poll] = {None: _poller([link for node in nodes for link in node.links], lifeline)}
    # These objects live until the end; garbage collection can skip them.
    gc.collect()
    gc.freeze()
    newest, silent_at = -1, math.inf
    while not all(node.stopped for node in nodes):
        _rest(nodes)
        wake_at = min((node.wake_at for node in nodes if node.wake_at is not None), default=math.inf)
        awaited = _awaited(nodes)
        if awaited not in pollers:
            pollers[awaited] = _poller([awaited] if awaited else [], lifeline)
        until = min(wake_at, silent_at, math.inf if awaited is None else time.monotonic() + LOOK_S)
        timeout_ms = None if until == math.inf else max(0.0, until - time.monotonic()) * 1000
        if any(descriptor == lifeline for descriptor, _ in pollers[awaited].poll(timeout_ms)):
            return
        for node in nodes:
            node.poll()
        if silence_s is None:
            continue
        if (opened := max(node.opened for node in nodes)) > newest:
            newest, silent_at = opened, time.monotonic() + silence_s
        elif time.monotonic() >= silent_at:
            names = ", ".join(node.name for node in nodes)
            raise RunFailed(f"{names} heard of no new cycle for {silence_s:g} s; is the conductor still running?")


def _poller(links: Iterable[Link], lifeline: int | None) -> select.poll:
    poller = select.poll()
    for link in links:
        poller.register(link.fileno(), select.POLLIN)
    if lifeline is not None:
        poller.register(lifeline, select.POLLIN)
    return poller


def _awaited(nodes: Sequence[Node]) -> Link | None:
    """Return the link on which the node furthest behind waits.

    One link only: in virtual time all frames of a cycle arrive, so those on the other links can be read together when
    this one wakes the process, instead of one by one.
    """
    return min(reversed(nodes), key=lambda node: node.opened).awaited


def read_up(nodes: Sequence[Node]) -> None:
    """Let nodes read what came while their process started, so that their queues have room for the run."""
    end = time.monotonic() + READ_UP_S
    heard = True
    while heard and time.monotonic() < end:
        heard = max([node.poll() for node in nodes])


def _rest(nodes: Sequence[Node]) -> None:
    """Sleep while no node of this process needs to be woken by frames."""
    rest_s = min(node.rest_until for node in nodes) - time.monotonic()
    if rest_s > 0.0:
        time.sleep(rest_s)
