"""What every link to a bus is: one end of one bus of classical CAN frames."""

from abc import ABC, abstractmethod
from collections.abc import Collection
from types import TracebackType

from bench.bus.frame import CanFrame
from bench.errors import RunFailed

EXTENDED = 0x8000_0000
"""Set in identifiers of 29 bits (Linux's CAN_EFF_FLAG), so none is taken for the 11-bit one of its number."""

MOST_FRAMES = 4096
"""Frames that one `receive` returns at most, so that a babbling sender cannot keep it for ever."""


class LinkError(RunFailed):
    """A bus that was open does not take or give frames any more."""


class Link(ABC):
    """One end of one bus. What is sent here is received at all other ends, not here.

    Attributes:
        name: the bus, `v2v` or `veh<i>`.
        ignored: what was received and is no classical CAN frame with data (remote, error, CAN FD, malformed),
            so
            far.
        times: when each frame of the newest `receive` came, ns since 1970; None where the link does not tell, or has
            not been asked to with `keep_times`.
    """

    def __init__(self, name: str) -> None:
        """Name the link."""
        self.name = name
        self.ignored = 0
        self.times: list[int] | None = None

    @abstractmethod
    def send(self, can_id: int, data: bytes) -> None:
        """Send a frame of up to 8 bytes; an identifier of 29 bits has the bit `EXTENDED` set.

        Raises:
            LinkError: the bus does not take it.
        """

    @abstractmethod
    def receive(self) -> list[CanFrame]:
        """Return the frames that have arrived, in order, without waiting for any.

        Identifiers of 29 bits have the bit `EXTENDED` set. A very full queue is returned in parts.

        Raises:
            LinkError: the bus has gone down.
        """

    def keep_times(self) -> None:  # noqa: B027 - links that cannot, need not
        """Keep `times` from now on, where the link can."""

    def select(self, can_ids: Collection[int]) -> None:  # noqa: B027 - links that cannot, need not
        """Receive only these identifiers from now on, where that saves work: others may come all the same."""

    @abstractmethod
    def fileno(self) -> int:
        """Return the file descriptor that is readable while frames wait; -1 for `direct`, which has none."""

    @abstractmethod
    def frames_lost(self) -> int:
        """Return the frames lost here so far, as they came faster than they were received."""

    @abstractmethod
    def close(self) -> None:
        """Leave the bus; harmless when done before."""

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
