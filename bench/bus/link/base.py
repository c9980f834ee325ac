"""The base class of links: one end of one bus of classical CAN frames."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Sequence
from types import TracebackType

from bench.bus.frame import CanFrame
from bench.errors import RunFailed
from bench.events import Refusal

EXTENDED = 0x8000_0000
"""Set in 29-bit identifiers (Linux's CAN_EFF_FLAG), to distinguish them from 11-bit ones of the same number."""

MOST_FRAMES = 4096
"""Maximum number of frames that one `receive` returns, so that a babbling sender cannot block it for ever."""


class LinkError(RunFailed):
    """An open bus no longer sends or receives frames."""


class Link(ABC):
    """One end of one bus. Frames sent here are received at all other ends, not here.

    Attributes:
        name: the bus, `v2v` or `veh<i>`.
        ignored: number of frames received that are not classical data frames (remote, error, CAN FD, malformed).
        on_ignored: called with the kind and, if it has one, the identifier of each of them; None for nobody.
        times: arrival time of each frame of the newest `receive`, ns since 1970; None if the link does not provide it,
            or `keep_times` has not been called.
    """

    def __init__(self, name: str) -> None:
        """Name the link."""
        self.name = name
        self.ignored = 0
        self.on_ignored: Callable[[Refusal, int | None], None] | None = None
        self.times: list[int] | None = None

    @abstractmethod
    def send(self, can_id: int, data: bytes) -> None:
        """Send a frame of up to 8 bytes; an identifier of 29 bits has the bit `EXTENDED` set.

        Raises:
            LinkError: the bus does not accept it.
        """

    def send_all(self, frames: Sequence[CanFrame]) -> None:
        """Send frames in this order, with fewer calls of the system than `send` where the link can.

        Raises:
            LinkError: the bus does not accept one of them.
        """
        for can_id, data in frames:
            self.send(can_id, data)

    @abstractmethod
    def receive(self) -> list[CanFrame]:
        """Return the frames that have arrived, in order, without waiting for any.

        Identifiers of 29 bits have the bit `EXTENDED` set. A very full queue is returned in parts.

        Raises:
            LinkError: the bus has gone down.
        """

    def keep_times(self) -> None:  # noqa: B027 - links that cannot, need not
        """Keep `times` from now on, if the link can."""

    def select(self, can_ids: Collection[int]) -> None:  # noqa: B027 - links that cannot, need not
        """Receive only these identifiers from now on; a hint: others may still be returned."""

    def _ignore(self, why: Refusal, can_id: int | None = None) -> None:
        """Count a received frame that is not a classical data frame."""
        self.ignored += 1
        if self.on_ignored is not None:
            self.on_ignored(why, can_id)

    @abstractmethod
    def fileno(self) -> int:
        """Return the file descriptor that is readable while frames are waiting; -1 for `direct`, which has none."""

    @abstractmethod
    def frames_lost(self) -> int:
        """Return the number of frames lost because they arrived faster than they were received."""

    @abstractmethod
    def close(self) -> None:
        """Leave the bus; idempotent."""

    def __enter__(self) -> "Link":
        """Return the link itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Leave the bus."""
        self.close()

    def __repr__(self) -> str:
        """Return kind and bus."""
        return f"<{type(self).__name__} {self.name}>"
