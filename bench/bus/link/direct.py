"""Buses inside one process: for campaigns and tests, with the same frames as on any other bus.

python-can's `virtual` does the same, but copies every message for every receiver, which costs twenty times more.
"""

from collections import deque

from bench.bus.frame import CanFrame
from bench.bus.link.base import MOST_FRAMES, Link


class Hub:
    """All buses of one bench in this process; each bench has its own hub."""

    def __init__(self) -> None:
        """Create a hub without links."""
        self.queues: dict[str, list[deque[CanFrame]]] = {}


class DirectLink(Link):
    """One end of a bus of a hub. It never loses frames and has no file descriptor to wait on: poll it."""

    def __init__(self, name: str, hub: Hub) -> None:
        """Join the bus `name` of `hub`."""
        super().__init__(name)
        self._queue: deque[CanFrame] = deque()
        self._queues = hub.queues.setdefault(name, [])
        self._queues.append(self._queue)

    def send(self, can_id: int, data: bytes) -> None:
        """See `Link`."""
        frame = CanFrame(can_id, bytes(data))
        for queue in self._queues:
            if queue is not self._queue:
                queue.append(frame)

    def receive(self) -> list[CanFrame]:
        """See `Link`."""
        return [self._queue.popleft() for _ in range(min(len(self._queue), MOST_FRAMES))]

    def fileno(self) -> int:
        """Return -1: there is no file descriptor."""
        return -1

    def frames_lost(self) -> int:
        """Return 0."""
        return 0

    def close(self) -> None:
        """See `Link`."""
        self._queues[:] = [queue for queue in self._queues if queue is not self._queue]
