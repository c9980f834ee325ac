"""Sends a log's frames on buses, each at its time.

Every frame has an absolute deadline, the start plus its time in the log, so a late frame delays no other and
nothing drifts. Between deadlines the process sleeps if there is time.
"""

from __future__ import annotations

import errno
import time
from collections.abc import Iterable, Mapping
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from itertools import chain

from bench.bus.link.base import Link, LinkError
from bench.bus.link.interface import InterfaceLink
from bench.conductor.linux import real_time, wait_until
from bench.replay.ahead import read_ahead
from bench.replay.lateness import Lateness
from bench.replay.order import Timed

START_NS = 50_000_000
"""From reading the first frame to sending it: reading is ahead by then."""

PATIENCE_S = 1.0
"""How long to wait for a full send queue, once, before frames are counted as failed."""

_PRIORITY = 80
_EMPTY_NS = 500_000_000


@dataclass
class Played:
    """What went out.

    Attributes:
        sent: bus -> frames sent.
        failed: bus -> frames that the bus did not accept.
        reason: why it did not accept the first of them.
        lateness: of the frames sent, against their deadlines; without any at full speed, which has none.
        duration_s: from the first frame to the last, wall clock.
        interrupted: whether Ctrl-C ended it.
    """

    sent: dict[str, int] = field(default_factory=dict)
    failed: dict[str, int] = field(default_factory=dict)
    reason: str = ""
    lateness: Lateness = field(default_factory=Lateness)
    duration_s: float = 0.0
    interrupted: bool = False

    @property
    def sent_frames(self) -> int:
        """Number of frames sent, over all buses."""
        return sum(self.sent.values())


def play(frames: Iterable[Timed], links: Mapping[str, Link], speed: float) -> Played:
    """Send frames until there are no more, or until Ctrl-C.

    Args:
        frames: in the order they are due.
        links: where each bus is; nothing that comes from there is read.
        speed: log time over wall-clock time; infinite for as fast as the buses accept them.
    """
    played = Played(sent=dict.fromkeys(links, 0))
    outlets = {bus: _Outlet(link) for bus, link in links.items()}
    paced = speed != float("inf")
    with ExitStack() as stack:
        ahead = stack.enter_context(read_ahead(frames))
        # After that, as the process that reads is not to have it.
        if paced:
            stack.enter_context(real_time(_PRIORITY))
        try:
            _play(ahead, outlets, speed if paced else None, played)
        except KeyboardInterrupt:
            played.interrupted = True
    return played


def _play(frames: Iterable[Timed], outlets: Mapping[str, _Outlet], speed: float | None, played: Played) -> None:
    frames = iter(frames)
    first = next(frames, None)
    if first is None:
        return
    start = emptied = time.monotonic_ns() + START_NS
    late = played.lateness
    for frame in chain([first], frames):
        deadline = start
        if speed is not None:
            deadline += int((frame.due_ns - first.due_ns) / speed)
            wait_until(deadline)
        reason = outlets[frame.bus].send(frame.can_id, frame.data)
        now = time.monotonic_ns()
        if reason:
            played.failed[frame.bus] = played.failed.get(frame.bus, 0) + 1
            played.reason = played.reason or reason
        else:
            played.sent[frame.bus] += 1
            if speed is not None:
                late.add(now - deadline)
        played.duration_s = max(0, now - start) / 1e9
        if now - emptied > _EMPTY_NS:
            emptied = now
            for outlet in outlets.values():
                outlet.throw_away()


class _Outlet:
    """One bus; it waits for a full send queue, as real CAN interfaces have under load."""

    def __init__(self, link: Link) -> None:
        link.select([])
        self._link = link
        self._patience_s = PATIENCE_S

    def send(self, can_id: int, data: bytes) -> str:
        """Send a frame; return why the bus does not accept it, empty if it does."""
        end = time.monotonic() + self._patience_s
        while True:
            try:
                self._link.send(can_id, data)
            except LinkError as error:
                if _is_full(error) and time.monotonic() < end:
                    time.sleep(0.0005)
                    continue
                self._patience_s = 0.0
                return str(error)
            self._patience_s = PATIENCE_S
            return ""

    def throw_away(self) -> None:
        """Discard received frames that python-can would queue without limit; the kernel limits a socket's."""
        if isinstance(self._link, InterfaceLink):
            # If anything is wrong with the bus, sending reports it.
            with suppress(LinkError):
                self._link.receive()


def _is_full(error: LinkError) -> bool:
    return isinstance(error.__cause__, OSError) and error.__cause__.errno in (errno.ENOBUFS, errno.EAGAIN)
