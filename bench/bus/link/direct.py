"""Buses inside one process: for campaigns and tests, with the same frames as on any other bus.

python-can's `virtual` does the same, but copies every message for every receiver, which costs twenty times more.
"""

from collections import deque
from collections.abc import Collection, Sequence

from bench.bus.frame import CanFrame
from bench.bus.link.base import MOST_FRAMES, Link


class _End:
    """One end of a bus.

    Attributes:
        frames: the frames that wait there.
        selected: the identifiers that it wants; None if all.
    """

    def __init__(self) -> None:
        self.frames: deque[CanFrame] = deque()
        self.selected: frozenset[int] | None = None


class Hub:
    """All buses of one bench in this process; each bench has its own hub."""

    def __init__(self) -> None:
        """Create a hub without links."""
        self.ends: dict[str, list[_End]] = {}


class DirectLink(Link):
    """One end of a bus of a hub. It never loses frames and has no file descriptor to wait on: poll it."""

    def __init__(self, name: str, hub: Hub) -> None:
        """Join the bus `name` of `hub`."""
        super().__init__(name)
        self._end = _End()
        self._ends = hub.ends.setdefault(name, [])
        self._ends.append(self._end)

    def send(self, can_id: int, data: bytes | bytearray) -> None:
        """See `Link`."""
        self.send_all([CanFrame(can_id, bytes(data))])

    def send_all(self, frames: Sequence[CanFrame]) -> None:
        """See `Link`."""
        for end in self._ends:
            if end is self._end:
                continue
            if end.selected is None:
                end.frames.extend(frames)
            else:
                end.frames.extend([frame for frame in frames if frame[0] in end.selected])

    def receive(self) -> list[CanFrame]:
        """See `Link`."""
        waiting = self._end.frames
        if len(waiting) <= MOST_FRAMES:
            frames = list(waiting)
            waiting.clear()
            return frames
        return [waiting.popleft() for _ in range(MOST_FRAMES)]

    def select(self, can_ids: Collection[int]) -> None:
        """See `Link`."""
        self._end.selected = frozenset(can_ids)

    def fileno(self) -> int:
        """Return -1: there is no file descriptor."""
        return -1

    def frames_lost(self) -> int:
        """Return 0."""
        return 0

    def close(self) -> None:
        """See `Link`."""
        self._ends[:] = [end for end in self._ends if end is not self._end]
